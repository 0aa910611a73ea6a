"""The published networks, filled by the goldens' rule and written as their published files."""

import atexit
import functools
import shutil
import tempfile
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from anystyle.testing.oracle import fill_named, smooth_image
from anystyle.vision import art_score, inception, networks, weights
from anystyle_metrics.optical_flow import network
from tests.support.oracle import golden

CONV_RULES = [["\\.weight$", {"scale": 1.4142135623730951}]]
ALIASES = tuple(
    f"cnet.layer{stage}.0.norm3.{leaf}"
    for stage in (2, 3)
    for leaf in ("weight", "bias", "running_mean", "running_var", "num_batches_tracked")
)


@functools.cache
def filled_folder() -> Path:
    """A folder of all published files, to be named in ``ANYSTYLE_WEIGHTS``."""
    folder = Path(tempfile.mkdtemp(prefix="filled-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    records = golden("golden_metrics")
    for name in ("vgg19", "vgg16", "alexnet"):
        _write(folder, name, fill_named(networks.NETWORKS[name]().state_dict(), CONV_RULES))
    rules = records["artfid_end_to_end"]["inception_rules"]
    _write(folder, "art_inception", fill_named(inception.ArtInception().state_dict(), rules))
    _write(folder, "art_score", fill_named(art_score.ArtScoreNet().state_dict()))
    flow = fill_named(network.RaftNetwork().state_dict(), records["consistency"]["raft_rules"])
    _write(folder, "raft_things", {f"module.{key}": tensor for key, tensor in flow.items()})
    return folder


def _write(folder: Path, name: str, state: dict[str, Tensor]) -> None:
    torch.save(state, folder / weights.row(name).file)


def eight_bit_pictures(seed: int, height: int, width: int, power: float) -> Tensor:
    """``gen(seed, height, width, power)`` of the goldens, as whole numbers of 0 to 255."""
    image = smooth_image(seed, [1, 3, *[7 * -(-side // 7) for side in (height, width)]])[0].numpy()
    values = np.floor(255.0 * image.astype(np.float32) ** power + 0.5).astype(np.uint8)
    return torch.from_numpy(values[:, :height, :width].astype(np.float32))


def six_pairs() -> list[tuple[Tensor, Tensor, Tensor]]:
    """Content, stylized and style images ``3 H W`` in [0, 1] of the end-to-end golden."""
    record = golden("golden_metrics")["artfid_end_to_end"]["images"]
    found, base = [], record["b"]
    for k, (size, other) in enumerate(zip(record["content_sizes_hw"], record["style_sizes_hw"], strict=True)):
        content = eight_bit_pictures(base + 100 + 4 * k, *size, 1)
        style = eight_bit_pictures(base + 200 + 4 * k, *other, 1.6 if k % 2 == 0 else 0.7)
        second = eight_bit_pictures(base + 300 + 4 * k, *size, 1.3)
        found.append((content / 255, (0.5 * content + 0.5 * second).floor() / 255, style / 255))
    return found


def nine_frames() -> Tensor:
    """The frames ``9 3 128 160`` in [0, 1] of the consistency golden."""
    big = smooth_image(4401, [1, 3, 182, 210])[0].numpy()
    frames = []
    for k in range(9):
        noise = smooth_image(4410 + 2 * k, [1, 3, 133, 161])[0, :, :128, :160].numpy()
        mixed = 0.85 * big[:, 3 * k : 3 * k + 128, 4 * k : 4 * k + 160] + 0.15 * noise
        frames.append(np.floor(255 * mixed + 0.5))
    return torch.from_numpy(np.stack(frames).astype(np.float32)) / 255
