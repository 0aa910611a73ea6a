"""The tensors in a file of weights, which is data: nothing in it is run."""

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load_file
from torch import Tensor

from anystyle.errors import UserError
from anystyle.io.arrays import check_tensors
from anystyle.io.checkpoint import dequantized
from anystyle.io.documents import parsing, regular

IGNORED = (
    "omegaconf.", "typing.", "collections.", "lightning.", "pytorch_lightning.", "src.", "pathlib.",
    "argparse.Namespace", "datetime.", "functools.partial", "numpy.",
    *(f"builtins.{name}" for name in ["dict", "list", "tuple", "int", "float", "str"]),
)  # fmt: skip
"""What the names of objects begin with that :class:`_Ignored` replaces, beside tensors in a training checkpoint."""


class _Ignored:
    """Replaces an object that a checkpoint holds beside its tensors; unpickling it has no effect."""

    def __new__(cls, *_: object) -> "_Ignored":
        return super().__new__(cls)

    def _nothing(self, *_: object) -> None:
        pass

    __init__ = __setstate__ = __setitem__ = _nothing


def read(path: str | Path) -> dict[str, Tensor]:
    """The tensors of a ``.safetensors`` file, of a PyTorch file or of a training checkpoint (``state_dict`` in it).

    They are mapped where the format allows, so that an optimiser's state beside them is never read.
    """
    path = regular(path, most=None, what="file of weights")
    with parsing(path, "file of weights, or truncated; get it again"):
        state = load_file(path) if path.suffix == ".safetensors" else _torch_file(path)
    for name in ("state_dict", "model_state_dict"):
        if isinstance(state, Mapping) and isinstance(state.get(name), Mapping):
            state = state[name]
    if not isinstance(state, Mapping) or not all(
        isinstance(key, str) and isinstance(value, Tensor) for key, value in state.items()
    ):
        raise UserError(f"{path} holds no plain state dict; save `module.state_dict()` alone")
    with parsing(path, "file of weights"):
        check_tensors(state.values())
    return dequantized(state, source=str(path))


def _torch_file(path: Path) -> Any:
    mapped = zipfile.is_zipfile(path)
    known: list[str] = []
    if mapped:
        with zipfile.ZipFile(path) as archive:
            if any(name.split("/")[1:2] == ["constants.pkl"] for name in archive.namelist()):
                raise UserError(f"{path} is a TorchScript program; get the state dict, as .safetensors or .pt")
        known = torch.serialization.get_unsafe_globals_in_checkpoint(path)
    if foreign := ", ".join(sorted(name for name in known if not name.startswith(IGNORED))):
        raise UserError(f"{path} holds code or objects of other programs ({foreign}); get only the state dict")
    ignored: list[Any] = [(_Ignored, name) for name in known]
    with torch.serialization.safe_globals(ignored):
        return torch.load(path, map_location="cpu", weights_only=True, mmap=mapped)
