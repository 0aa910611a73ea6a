"""Distances of photographs from themselves, distorted, by each network that may replace LPIPS, and what each costs.

``python -m tests.benchmarks.distances`` prints a table over the 46 photographs of the benchmark's track ``open``, of
which it takes the middle square, reduced to 224 pixels. Another photograph is one of the next capture.
"""

import io
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import torch
from kornia.filters import gaussian_blur2d
from PIL import Image, ImageOps
from torch import Tensor

import anystyle_benchmark
from anystyle.data.images import to_tensor
from anystyle.evaluation.tables import Table
from anystyle.io.sheet import to_pil
from anystyle.vision import lpips

SIDE = 224
CAPTURES = Path(anystyle_benchmark.__file__).with_name("tracks") / "open" / "photographs"


def photographs(most: int | None = None) -> list[Tensor]:
    """Up to ``most`` photographs of each capture, each capture (M, 3, 225, 225): a pixel is left for a shift."""
    size = (SIDE + 1, SIDE + 1)
    return [
        torch.stack([to_tensor(ImageOps.fit(Image.open(path), size)) for path in sorted(folder.glob("*.jpg"))[:most]])
        for folder in sorted(CAPTURES.iterdir())
    ]


def pairs(captures: list[Tensor]) -> Iterator[tuple[str, Tensor, Tensor]]:
    """Names of distortions, distorted photographs and photographs, each (N, 3, 224, 224) in [0, 1]."""
    whole = torch.cat(captures)
    given = whole[..., :-1, :-1]
    yield "moved by a pixel", whole[..., :-1, 1:], given
    for sigma in (1, 3):
        kernel = (8 * sigma + 1, 8 * sigma + 1)
        blurred = gaussian_blur2d(whole, kernel, (float(sigma), float(sigma)))
        yield f"blurred, σ {sigma}", blurred[..., :-1, :-1], given
    for quality in (60, 8):
        yield f"JPEG {quality}", torch.stack([_jpeg(image, quality) for image in given]), given
    noise = torch.randn(given.shape, generator=torch.Generator().manual_seed(0))
    yield "noise, σ 25 of 255", (given + 25 / 255 * noise).clamp(0, 1), given
    following = [captures[number - len(captures) + 1] for number in range(len(captures))]
    others = [other[torch.arange(len(one)) % len(other)] for one, other in zip(captures, following, strict=True)]
    yield "another photograph", torch.cat(others)[..., :-1, :-1], given


@torch.no_grad()
def distances(captures: list[Tensor], network: lpips.Lpips) -> dict[str, float]:
    """The mean distance for each of :func:`pairs`."""
    return {
        name: float(torch.cat([network(*pair) for pair in zip(preds.split(8), target.split(8), strict=True)]).mean())
        for name, preds, target in pairs(captures)
    }


def _jpeg(image: Tensor, quality: int) -> Tensor:
    file = io.BytesIO()
    to_pil(image).save(file, "JPEG", quality=quality)
    return to_tensor(Image.open(file))


def main() -> None:
    """Print the table, with milliseconds of CPU time for an image."""
    torch.set_num_threads(1)
    captures = photographs()
    networks = {
        "texture": lpips.load("alex", "stand_in"),
        "st_lpips, alex": lpips.load("alex"),
        "vgg": lpips.load("vgg"),
    }
    columns: dict[str, dict[str, float]] = {}
    for title, network in networks.items():
        columns[title] = distances(captures, network)
        images, start = torch.cat(captures[:1])[:8], time.process_time()
        with torch.no_grad():
            network.describe(images)
        columns[title]["ms an image"] = 1e3 * (time.process_time() - start) / len(images)
    rows = [(name, *(f"{column[name]:.3f}" for column in columns.values())) for name in columns["texture"]]
    sys.stdout.write(Table(("", *columns), tuple(rows)).markdown())


if __name__ == "__main__":
    main()
