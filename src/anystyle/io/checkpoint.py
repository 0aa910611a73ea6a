"""Weights on disk: safetensors files with a header that describes them, loaded strictly."""

import errno
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from anystyle.errors import UserError, one_line
from anystyle.io.atomic import atomic_path
from anystyle.io.documents import fit, parse_json, parsing, regular

FORMAT = "anystyle/1"
SCALES = ":scales"
"""What the key of the scales of a tensor in 8 bits ends with, after the tensor's own."""


@dataclass(frozen=True)
class Header:
    """The header of a weights file.

    Args:
        part: What it holds: ``backbone``, ``style_encoder``, ``branch`` or a network of ``vision``.
        config: The configuration that builds the module the weights fit.
        base: For each part the weights were trained on top of, the SHA-256 of its file.
        provenance: Who made it: command, commit, seed, steps, data.
        omitted: Children of the module that are not in the file: they keep the values of the weights in ``base``, which
            the module has at initialisation.
    """

    part: str
    config: dict[str, Any] = field(default_factory=dict)
    base: dict[str, str] = field(default_factory=dict)
    provenance: dict[str, Any] = field(default_factory=dict)
    omitted: tuple[str, ...] = ()

    def omits(self, key: str) -> bool:
        """Whether a tensor of the module's state is not in the file."""
        return key.partition(".")[0] in self.omitted


def save_part(path: str | Path, module: nn.Module, header: Header, *, half: bool = False) -> None:
    """Write a module's state and its header; with ``half`` floating-point tensors are stored as fp16."""
    state: dict[str, Tensor] = {}
    for key, tensor in module.state_dict().items():
        if not header.omits(key):
            kept = tensor.detach().cpu().contiguous()
            state[key] = kept.half() if half and kept.is_floating_point() else kept.clone()
    fields = {name: json.dumps(value, sort_keys=True) for name, value in vars(header).items() if name != "part"}
    save_tensors(path, state, {"format": FORMAT, "part": header.part, **fields})


def save_tensors(path: str | Path, state: Mapping[str, Tensor], metadata: Mapping[str, str]) -> None:
    """Write a ``.safetensors`` file, whole or not at all; the same content gives the same bytes."""
    with atomic_path(path, sync=True) as temporary:
        try:
            save_file(dict(state), temporary, metadata=dict(metadata))
        except SafetensorError as error:  # such as a full disk
            raise OSError(errno.EIO, f"cannot be written ({one_line(error)})", str(path)) from None
        # The library writes the metadata in an order that differs from process to process.
        with temporary.open("r+b") as file:
            length = int.from_bytes(file.read(8), "little")
            header = json.loads(file.read(length))
            header["__metadata__"] = dict(sorted(header["__metadata__"].items()))
            file.seek(8)
            file.write(json.dumps(header, separators=(",", ":"), ensure_ascii=False).encode().ljust(length))


def read_header(path: str | Path) -> Header:
    """Read the header of a weights file."""
    metadata = _metadata(path)
    if metadata.get("format") != FORMAT:
        raise UserError(f"{path} is not a safetensors file that anystyle wrote")
    if any("${" in text for text in metadata.values()):
        # Configurations are resolved before they are written; an interpolation would be resolved on this machine.
        raise UserError(f"the header of {path} holds an interpolation; a file's configuration must be resolved")
    source = f"the header of {path}"
    fields = {
        name: text if name == "part" else parse_json(text, Any, source=f"{name} in {source}")
        for name, text in metadata.items()
        if name in Header.__annotations__
    }
    return fit(fields, Header, source=source, what="header of weights")


def has_header(path: str | Path) -> bool:
    """Whether anystyle wrote a file; others hold weights under the names that their publishers gave them."""
    return Path(path).suffix == ".safetensors" and _metadata(path).get("format") == FORMAT


def load_part(path: str | Path, module: nn.Module, part: str) -> Header:
    """Load weights into a module, strictly; an error names up to five missing, unexpected and misshapen keys."""
    header = read_header(path)
    if header.part != part:
        raise UserError(f"{path} holds the weights of a {header.part}, but those of a {part} are needed")
    with _open(path) as file:
        stored = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118  (no mapping)
    state = dequantized(stored, source=str(path))
    kept = {key: tensor for key, tensor in module.state_dict().items() if header.omits(key)}
    load_strictly(module, kept | state, source=str(path))
    return header


def dequantized(stored: Mapping[str, Tensor], *, source: str) -> dict[str, Tensor]:
    """Tensors as they are computed with, of those in a file of weights.

    A tensor (rows, ...) stored as int8 ``KEY`` is multiplied by ``KEY:scales``, one a row; others stay as they are.
    """
    state = {key: tensor for key, tensor in stored.items() if not key.endswith(SCALES)}
    quantized = [key for key, tensor in state.items() if tensor.dtype == torch.int8]
    for key in quantized:
        scales = stored.get(key + SCALES)
        if scales is None or scales.shape != state[key].shape[:1]:
            raise UserError(f"{source}: {key} is in 8 bits and needs {key}{SCALES}, one number for each of its rows")
        state[key] = (state[key].flatten(1) * scales[:, None]).view(state[key].shape)
    if unused := sorted(stored.keys() - state.keys() - {key + SCALES for key in quantized}):
        raise UserError(f"{source}: {unused[0]} belongs to no tensor in 8 bits")
    return state


def load_strictly(module: nn.Module, state: Mapping[str, Tensor], *, source: str) -> None:
    """Copy tensors into a module whose keys and shapes are exactly theirs."""
    if unlike := differences(module.state_dict(), state):
        raise UserError(f"{source} does not fit this {type(module).__name__}: {unlike}")
    fill(module, state)


def differences(expected: Mapping[str, Tensor], state: Mapping[str, Tensor]) -> str:
    """How names, shapes and types of tensors differ from those expected, up to five each; empty if they agree."""
    shapes = {key: (list(state[key].shape), list(tensor.shape)) for key, tensor in expected.items() if key in state}
    found = {
        "missing": [key for key in expected if key not in state],
        "unexpected": [key for key in state if key not in expected],
        "misshapen": [f"{key} is {ours}, not {theirs}" for key, (ours, theirs) in shapes.items() if ours != theirs],
        "integer": [key for key in shapes if state[key].is_floating_point() < expected[key].is_floating_point()],
    }
    listed = {kind: ", ".join([*keys[:5], *["…"] * (len(keys) > 5)]) for kind, keys in found.items()}
    return "; ".join(f"{len(found[kind])} {kind} ({text})" for kind, text in listed.items() if text)


def fill(module: nn.Module, state: Mapping[str, Tensor]) -> None:
    """Copy values of a state dict or of a part of it; a module on the meta device takes the tensors themselves."""
    current = module.state_dict()
    on_meta = any(tensor.is_meta for tensor in current.values())
    if on_meta:
        state = {key: tensor.to(current[key].dtype) for key, tensor in state.items()}
    module.load_state_dict(current | dict(state), assign=on_meta)


def sha256(path: str | Path) -> str:
    """The SHA-256 of a file, in hexadecimal."""
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _metadata(path: str | Path) -> dict[str, str]:
    with _open(path) as file:
        return file.metadata() or {}


def _open(path: str | Path) -> Any:
    regular(path, most=None, what="weights file")
    with parsing(path, "safetensors file; get it again"):
        return safe_open(path, framework="pt")
