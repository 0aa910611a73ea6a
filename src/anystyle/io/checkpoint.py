"""Weights on disk: safetensors files that say what they hold, loaded strictly."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from anystyle.documents import fit, parse_json, regular
from anystyle.errors import one_line
from anystyle.io.atomic import atomic_path

FORMAT = "anystyle/1"


@dataclass(frozen=True)
class Header:
    """What a weights file says of itself.

    Args:
        part: What it holds: ``backbone``, ``style_encoder``, ``branch`` or a network of ``perception``.
        config: The configuration that builds the module the weights fit.
        base: For each part the weights were trained on top of, the SHA-256 of its file.
        provenance: Who made it: command, commit, seed, steps, data.
        omitted: Children of the module that are not in the file: their values are those of the weights in ``base``,
            which the module has when it is made.
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
    """Write a module's state and its header; whole or not at all.

    Args:
        path: A ``.safetensors`` file.
        module: What to save.
        header: What the file says of itself.
        half: Store floating-point tensors as fp16, half the size; they are loaded as what the module holds.
    """
    state: dict[str, Tensor] = {}
    for key, tensor in module.state_dict().items():
        if header.omits(key):
            continue
        kept = tensor.detach().cpu().contiguous()
        state[key] = kept.half() if half and kept.is_floating_point() else kept.clone()
    metadata = {
        "format": FORMAT,
        "part": header.part,
        "config": json.dumps(header.config, sort_keys=True),
        "base": json.dumps(header.base, sort_keys=True),
        "provenance": json.dumps(header.provenance, sort_keys=True),
        "omitted": json.dumps(header.omitted),
    }
    save_tensors(path, state, metadata)


def save_tensors(path: str | Path, state: Mapping[str, Tensor], metadata: Mapping[str, str]) -> None:
    """Write a ``.safetensors`` file, whole or not at all; the same content gives the same bytes."""
    with atomic_path(path, sync=True) as temporary:
        try:
            save_file(dict(state), temporary, metadata=dict(metadata))
        except SafetensorError as error:  # its only way to say that the disk is full
            raise OSError(f"{path} cannot be written ({one_line(error)})") from None
        _sort_metadata(Path(temporary))


def _sort_metadata(path: Path) -> None:
    # The library writes these entries in an order that differs from process to process.
    with path.open("r+b") as file:
        length = int.from_bytes(file.read(8), "little")
        header = json.loads(file.read(length))
        header["__metadata__"] = dict(sorted(header["__metadata__"].items()))
        written = json.dumps(header, separators=(",", ":"), ensure_ascii=False).encode()
        assert len(written) <= length
        file.seek(8)
        file.write(written.ljust(length))


def read_header(path: str | Path) -> Header:
    """What a weights file says of itself.

    Raises:
        ValueError: It is truncated, damaged, not one of ours, or its configuration is not plain.
    """
    with _open(path) as file:
        metadata = file.metadata() or {}
    if metadata.get("format") != FORMAT:
        raise ValueError(f"{path} is a safetensors file without an anystyle header; convert it with `anystyle weights`")
    if any("${" in text for text in metadata.values()):
        # Resolved when it was written; what is not was put there to be resolved here.
        raise ValueError(f"the header of {path} holds an interpolation; a file's configuration is taken as it is")
    plain: dict[str, Any] = {name: metadata[name] for name in ("part",) if name in metadata}
    for name in ("config", "base", "provenance", "omitted"):
        if name in metadata:
            plain[name] = parse_json(metadata[name], Any, source=f"{name} in the header of {path}")
    return fit(plain, Header, source=f"the header of {path}", what="header of weights")


def has_header(path: str | Path) -> bool:
    """Whether a file is one of ours; other files hold weights under the names that their publishers gave them.

    Raises:
        ValueError: It is a truncated ``.safetensors`` file, or there is none.
    """
    if Path(path).suffix != ".safetensors":
        return False
    with _open(path) as file:
        return (file.metadata() or {}).get("format") == FORMAT


def load_part(path: str | Path, module: nn.Module, part: str) -> Header:
    """Load weights into a module, strictly.

    Raises:
        ValueError: The file is truncated, holds another part, or its tensors are not the module's; up to five of the
            missing, unexpected and misshapen keys are named.
    """
    header = read_header(path)
    if header.part != part:
        raise ValueError(f"{path} holds the weights of a {header.part}, but those of a {part} are needed")
    with _open(path) as file:
        state = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118  (no mapping)
    kept = {key: tensor for key, tensor in module.state_dict().items() if header.omits(key)}
    load_strictly(module, kept | state, source=str(path))
    return header


def load_strictly(module: nn.Module, state: Mapping[str, Tensor], *, source: str) -> None:
    """Copy tensors into a module whose keys and shapes are exactly theirs.

    Raises:
        ValueError: They differ; the message names up to five of each kind of difference.
    """
    unlike = differences(module.state_dict(), state)
    if unlike:
        raise ValueError(f"{source} does not fit this {type(module).__name__}: {unlike}")
    fill(module, state)


def differences(expected: Mapping[str, Tensor], state: Mapping[str, Tensor]) -> str:
    """How the names and shapes of tensors differ from those expected, up to five of each kind; empty if they do not."""
    missing = [key for key in expected if key not in state]
    unexpected = [key for key in state if key not in expected]
    misshapen = [
        f"{key} is {list(state[key].shape)}, not {list(tensor.shape)}"
        for key, tensor in expected.items()
        if key in state and state[key].shape != tensor.shape
    ]
    return "; ".join(
        f"{len(keys)} {kind} ({', '.join(keys[:5])}{', …' if len(keys) > 5 else ''})"
        for kind, keys in (("missing", missing), ("unexpected", unexpected), ("misshapen", misshapen))
        if keys
    )


def fill(module: nn.Module, state: Mapping[str, Tensor]) -> None:
    """Give a module the values of all of its state dict or of a part, keys and shapes as there, in its own types.

    A module on the meta device has no memory to copy into: it takes the tensors themselves, cast where its types
    differ. Pages of a file that tensors are mapped from are the system's to reclaim.
    """
    current = module.state_dict()
    on_meta = any(tensor.is_meta for tensor in current.values())
    if on_meta:
        state = {key: tensor.to(current[key].dtype) for key, tensor in state.items()}
    module.load_state_dict(current | dict(state), assign=on_meta)


def sha256(path: str | Path) -> str:
    """The SHA-256 of a file, in hexadecimal."""
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _open(path: str | Path) -> Any:
    regular(path, most=None, what="weights file")
    try:
        return safe_open(path, framework="pt")
    except (SafetensorError, OSError) as error:
        raise ValueError(f"{path} is truncated or no safetensors file ({one_line(error)})") from None
