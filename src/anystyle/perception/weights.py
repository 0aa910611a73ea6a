"""Where the weights of frozen networks lie: names to files, where each comes from, where it is looked for.

Nothing is ever downloaded, and a network is never replaced by another in silence.
"""

import hashlib
import os
import pickle
import zipfile
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor

FOLDERS = "ANYSTYLE_WEIGHTS"
"""The environment variable that names folders of weights, separated as in ``PATH``."""


@dataclass(frozen=True)
class WeightsFile:
    """One file of weights.

    Args:
        file: Its name.
        purpose: What needs it.
        license: Under which terms it may be used.
        source: Where it comes from, in words that can be looked up.
        sha256: Of its content, in hexadecimal; as many leading digits as its publisher states, ``None`` if none.
        bundled: Whether it comes with this package.
    """

    file: str
    purpose: str
    license: str
    source: str
    sha256: str | None = None
    bundled: bool = False


def _ours(name: str, purpose: str, experiment: str) -> WeightsFile:
    return WeightsFile(
        file=f"{name}.safetensors",
        purpose=purpose,
        license="Apache-2.0",
        source=f"bundled; made by `anystyle train experiment={experiment}`",
        bundled=True,
    )


FILES: dict[str, WeightsFile] = {
    "vgg19": WeightsFile(
        file="vgg19-dcbb9e9d.pth",
        purpose="style and content losses of the paper; CFSD",
        license="BSD-3-Clause (torchvision); trained on ImageNet",
        source="https://download.pytorch.org/models/vgg19-dcbb9e9d.pth",
        sha256="dcbb9e9d",
    ),
    "texture": _ours("tiny_texture", "style losses of the tiny recipes", "tiny_perceptual"),
    "tiny_style_encoder": _ours("tiny_style_encoder", "style_encoder=tiny", "tiny_embedding"),
    "tiny_backbone": _ours("tiny_backbone", "model=tiny", "tiny_reconstruction"),
    "tiny_head": _ours("tiny_head", "model=tiny, placement=head", "tiny_style"),
}


def folders() -> tuple[Path, ...]:
    """The folders that are looked in, in order: those of ``ANYSTYLE_WEIGHTS``, then the package's own."""
    named = [Path(folder).expanduser() for folder in os.environ.get(FOLDERS, "").split(os.pathsep) if folder]
    return (*named, Path(__file__).parents[1] / "assets")


def find(name: str, path: str | Path | None = None) -> Path:
    """The file that holds the weights called ``name``.

    Args:
        name: A key of :data:`FILES`.
        path: Where it lies, if not in one of :func:`folders`.

    Raises:
        FileNotFoundError: It is nowhere; the message says where to get it and where to put it.
    """
    entry = FILES[name]
    places = [Path(path).expanduser()] if path is not None else [folder / entry.file for folder in folders()]
    for place in places:
        if place.is_file():
            return place
    raise FileNotFoundError(
        f"the weights {name!r} are missing: get {entry.file} from {entry.source} ({entry.license}) and put it into a "
        f"folder that {FOLDERS} names; looked for {', '.join(map(str, places))}"
    )


def read(path: str | Path) -> dict[str, Tensor]:
    """The tensors of a ``.safetensors`` file or of a PyTorch file; nothing in it is executed.

    Raises:
        ValueError: It is truncated, or of another kind.
    """
    path = Path(path)
    try:
        if path.suffix == ".safetensors":
            return load_file(path)
        # Mapped where the format allows, so that a classifier that makes up most of a file is never read.
        state = torch.load(path, map_location="cpu", weights_only=True, mmap=zipfile.is_zipfile(path))
    except pickle.UnpicklingError:
        raise ValueError(f"{path} is damaged or holds more than tensors; get it again, or convert it") from None
    except (SafetensorError, OSError, RuntimeError, EOFError, ValueError, KeyError) as error:
        reason = (str(error).strip() or type(error).__name__).splitlines()[0]
        raise ValueError(f"{path} is truncated or no file of weights ({reason}); get it again") from None
    if not isinstance(state, dict) or not all(isinstance(value, Tensor) for value in state.values()):
        raise ValueError(f"{path} holds no plain state dict; save `module.state_dict()` alone")
    return state


def verified(name: str, path: str | Path) -> bool | None:
    """Whether a file's content is what its publisher states; ``None`` where nothing is stated."""
    stated = FILES[name].sha256
    if stated is None:
        return None
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest().startswith(stated)
