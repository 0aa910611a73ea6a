"""Reading files of weights as data: nothing in them is executed."""

import pickle
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file
from torch import Tensor

from anystyle.documents import regular

_IDLE = ("omegaconf.", "typing.", "collections.", "lightning.", "pytorch_lightning.", "src.")
"""Where a training checkpoint's configuration has its classes; one that does nothing replaces them, and plain types."""


_PLAIN = {"builtins.dict", "builtins.list", "builtins.tuple", "builtins.int", "builtins.float", "builtins.str"}


class _Idle:
    """Stands for an object that a checkpoint holds beside its tensors, and forgets whatever it is told."""

    def __new__(cls, *_: object) -> "_Idle":
        return super().__new__(cls)

    def __init__(self, *_: object) -> None:
        pass

    def __setstate__(self, _: object) -> None:
        pass

    def __setitem__(self, _: object, __: object) -> None:
        pass


def read(path: str | Path) -> dict[str, Tensor]:
    """The tensors of a ``.safetensors`` file, of a PyTorch file or of a training checkpoint (``state_dict`` in it).

    They are mapped where the format allows: what is never looked at, such as an optimiser's state, is never read.

    Raises:
        ValueError: It is truncated, or of another kind.
    """
    path = regular(path, most=None, what="file of weights")
    try:
        state = load_file(path) if path.suffix == ".safetensors" else _torch_file(path)
    except pickle.UnpicklingError:
        raise ValueError(f"{path} is damaged or holds more than tensors; get it again, or convert it") from None
    except MemoryError:
        raise
    except Exception as error:
        # Damaged archives and pickles raise nearly anything.
        reason = (str(error).strip() or type(error).__name__).splitlines()[0]
        raise ValueError(f"{path} is truncated or no file of weights ({reason}); get it again") from None
    if isinstance(state, Mapping) and isinstance(state.get("state_dict"), Mapping):
        state = state["state_dict"]
    if not isinstance(state, Mapping) or not all(isinstance(value, Tensor) for value in state.values()):
        raise ValueError(f"{path} holds no plain state dict; save `module.state_dict()` alone")
    return dict(state)


def metadata(path: str | Path) -> dict[str, str]:
    """What a ``.safetensors`` file says of itself; empty for others.

    Raises:
        ValueError: It is truncated.
    """
    path = Path(path)
    if path.suffix != ".safetensors":
        return {}
    try:
        with safe_open(path, framework="pt") as file:
            return file.metadata() or {}
    except (SafetensorError, OSError) as error:
        raise ValueError(f"{path} is truncated or no safetensors file ({error}); get it again") from None


def _torch_file(path: Path) -> Any:
    mapped = zipfile.is_zipfile(path)
    if mapped and _is_program(path):
        raise ValueError("it is a TorchScript program; get the state dict, as .safetensors or .pt")
    known = [] if not mapped else torch.serialization.get_unsafe_globals_in_checkpoint(path)
    idle: list[Any] = [(_Idle, name) for name in known if name.startswith(_IDLE) or name in _PLAIN]
    with torch.serialization.safe_globals(idle):
        return torch.load(path, map_location="cpu", weights_only=True, mmap=mapped)


def _is_program(path: Path) -> bool:
    with zipfile.ZipFile(path) as archive:
        return any(name.split("/")[1:2] == ["constants.pkl"] for name in archive.namelist())
