"""Files of weights by name: where each comes from and where it is searched.

A missing file raises, and nothing is downloaded unless ``anystyle weights download`` is run. The rows are those of
``weights.toml`` beside this module and beside the top-level module of each plugin package, whose bundled files are in
its folder ``assets``.
"""

import importlib.util
import os
import pickle
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file
from torch import Tensor

from anystyle import paths
from anystyle.documents import read_toml, regular
from anystyle.errors import did_you_mean
from anystyle.io.checkpoint import sha256
from anystyle.registry.packages import packages

FOLDERS = "ANYSTYLE_WEIGHTS"
"""The environment variable that names folders of weights, separated as in ``PATH``."""
TABLE = "weights.toml"
"""The file of a package's rows: one table for each, with the fields of :class:`WeightsFile`."""


@dataclass(frozen=True)
class WeightsFile:
    """One file of weights.

    Args:
        file: The file's name.
        purpose: What needs it.
        license: Its terms.
        source: The publisher's address, or how it was made.
        sha256: Of its content, in hexadecimal; as many leading digits as its publisher states, ``None`` if none.
        bundled: Whether it comes with the package of this row.
        size: Bytes of its tensors, or of the whole file where a publisher states it; ``None`` if unknown.
        hub: Its path on the Hugging Face hub, as ``owner/repository/path``.
        package: An installed package that contains it, as ``package/path``.
        layout: The names of its tensors: a key of :data:`anystyle.perception.state_dict_formats.LAYOUTS`, or the
            plugin's backbone.
    """

    file: str
    purpose: str
    license: str
    source: str
    sha256: str | None = None
    bundled: bool = False
    size: int | None = None
    hub: str | None = None
    package: str | None = None
    layout: str | None = None


def files() -> dict[str, WeightsFile]:
    """Every row by name: those of the table beside this module, then those of plugins.

    Raises:
        ValueError: A plugin's ``weights.toml`` cannot be read, or its row has the name of another.
    """
    known = dict(_rows(Path(__file__).with_name(TABLE)))
    for package in packages():
        for name, entry in _rows(package / TABLE).items():
            if known.setdefault(name, entry) != entry:
                raise ValueError(f"{package / TABLE} names {name!r}, which another row is called; rename it")
    return known


@cache
def _rows(path: Path) -> dict[str, WeightsFile]:
    if not path.is_file():
        return {}
    return read_toml(path, dict[str, WeightsFile], what="table of weights")


def row(name: str) -> WeightsFile:
    """The row of a name.

    Raises:
        ValueError: There is none.
    """
    known = files()
    if name not in known:
        raise ValueError(f"no weights are called {name!r}.{did_you_mean(name, known)} See: anystyle weights")
    return known[name]


def folders() -> tuple[Path, ...]:
    """The folders that are searched, in order: those of ``ANYSTYLE_WEIGHTS``, then the package's own."""
    named = [Path(folder).expanduser() for folder in os.environ.get(FOLDERS, "").split(os.pathsep) if folder]
    return (*named, paths.ASSETS)


def candidates(name: str) -> Iterator[Path]:
    """The paths at which a file is searched, in order: :func:`folders`, plugins, another package, the hub's cache."""
    entry = row(name)
    for folder in folders():
        yield folder / entry.file
    if entry.bundled:
        yield from (package / "assets" / entry.file for package in packages() if name in _rows(package / TABLE))
    if entry.package is not None:
        package, _, inside = entry.package.partition("/")
        spec = importlib.util.find_spec(package)
        if spec is not None and spec.submodule_search_locations:
            yield Path(next(iter(spec.submodule_search_locations))) / inside
    if entry.hub is not None and (cached := _in_hub_cache(entry.hub)) is not None:
        yield cached


def find(name: str, path: str | Path | None = None) -> Path:
    """The file of the weights called ``name``, a key of :func:`files`: the given one, or one of :func:`candidates`.

    Raises:
        FileNotFoundError: There is no such file; the message says where to get it and where to put it.
    """
    searched = [Path(path).expanduser()] if path is not None else list(candidates(name))
    for candidate in searched:
        if candidate.is_file():
            return candidate
    raise FileNotFoundError(missing(name, searched))


def missing(name: str, searched: list[Path]) -> str:
    """One line for a file that was not found: which it is, where to get it and where to put it."""
    entry = row(name)
    by_hub = f" (`anystyle weights download {name}` does)" if entry.hub else ""
    shown = ", ".join(map(str, searched)) + (", the Hugging Face cache" if entry.hub and _has_hub() else "")
    return (
        f"the weights {name!r} are missing: get {entry.file} from {entry.source}{by_hub} ({entry.license}) and put it "
        f"into a folder that {FOLDERS} names; looked for {shown}"
    )


def download(name: str) -> Path:
    """Fetch a file from the Hugging Face hub into its cache; an interrupted download is continued.

    Raises:
        ValueError: The hub does not have it.
        OSError: The hub cannot be reached, or refuses.
        ImportError: ``huggingface_hub`` is missing.
    """
    entry = row(name)
    if entry.hub is None:
        raise ValueError(
            f"the Hugging Face hub does not have {name!r}: get {entry.file} from {entry.source} ({entry.license}) and "
            f"put it into a folder that {FOLDERS} names"
        )
    try:
        from huggingface_hub import hf_hub_download  # pyright: ignore[reportMissingImports]
        from huggingface_hub.errors import HfHubHTTPError  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise ImportError(f'downloading {name} needs huggingface_hub: pip install "anystyle[hub]"') from None
    owner, repository, path = entry.hub.split("/", 2)
    try:
        return Path(hf_hub_download(f"{owner}/{repository}", path))
    except (OSError, HfHubHTTPError) as error:
        reason = next(iter(str(error).strip().splitlines()), type(error).__name__)
        raise OSError(
            f"{entry.hub} cannot be fetched ({reason}); try again, or get it from {entry.source} elsewhere and "
            f"put it as {entry.file} into a folder that {FOLDERS} names"
        ) from None


def _has_hub() -> bool:
    return importlib.util.find_spec("huggingface_hub") is not None


def _in_hub_cache(hub: str) -> Path | None:
    if not _has_hub():
        return None
    from huggingface_hub import try_to_load_from_cache  # pyright: ignore[reportMissingImports]

    owner, name, path = hub.split("/", 2)
    cached = try_to_load_from_cache(f"{owner}/{name}", path)
    return Path(cached) if isinstance(cached, str) else None


def verified(name: str, path: str | Path) -> bool | None:
    """Whether a file has the checksum that its publisher states; ``None`` if none is stated."""
    stated = row(name).sha256
    return None if stated is None else sha256(path).startswith(stated)


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
