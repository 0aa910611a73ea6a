"""Files of weights by name: where each comes from, where it is searched, under what licence, and reading them.

A missing file raises, and nothing is downloaded unless ``anystyle weights download`` is run. The rows are those of
``weights.toml`` beside this module and beside the top-level module of each plugin package, whose bundled files are in
its folder ``assets``.
"""

import importlib.util
import logging
import os
import pickle
import re
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal

import torch
from safetensors.torch import load_file
from torch import Tensor

from anystyle import paths
from anystyle.errors import UserError, unknown
from anystyle.io.arrays import check_tensors
from anystyle.io.checkpoint import sha256
from anystyle.io.documents import read_toml, regular
from anystyle.paths import expanded
from anystyle.registry.packages import packages
from anystyle.types import Source

log = logging.getLogger(__name__)

FOLDERS = "ANYSTYLE_WEIGHTS"
"""The environment variable that names folders of weights, separated as in ``PATH``."""
TABLE = "weights.toml"
"""The file of a package's rows: one table for each, with the fields of :class:`WeightsFile`."""


class MissingWeights(UserError, FileNotFoundError):
    """A file of weights was not found; the message says where to get it and where to put it."""


@dataclass(frozen=True)
class WeightsFile:
    """One file of weights."""

    file: str
    purpose: str
    license: str
    source: str  # the publisher's address, or how it was made
    sha256: str | None = None  # in hexadecimal; as many leading digits as its publisher states
    bundled: bool = False  # comes with the package of this row
    size: int | None = None  # of the file in bytes, where its publisher states it
    tensors: int | None = None  # bytes of the tensors that the network has, computed; the file may hold more
    hub: str | None = None  # its path on the Hugging Face hub: owner/repository/path
    package: str | None = None  # an installed package that contains it: package/path

    def __post_init__(self) -> None:
        if self.hub is not None and not re.fullmatch(r"(?!.*(--|\.\.))\w[\w.-]*/\w[\w.-]*/[^/\0][^\0]*", self.hub):
            raise ValueError(f"hub is {self.hub!r}; expected owner/repository/path")
        if self.package is not None and not re.fullmatch(r"[A-Za-z_]\w*/[^\0]+", self.package):
            raise ValueError(f"package is {self.package!r}; expected package/path")


def files() -> dict[str, WeightsFile]:
    """Every row by name: those of the table beside this module, then those of plugins."""
    known = dict(_rows(Path(__file__).with_name(TABLE)))
    for package in packages():
        for name, entry in _rows(package / TABLE).items():
            if known.setdefault(name, entry) != entry:
                raise UserError(f"{package / TABLE} names {name!r}, the name of another row; rename it")
    return known


@cache
def _rows(path: Path) -> dict[str, WeightsFile]:
    return read_toml(path, dict[str, WeightsFile], what="table of weights") if path.is_file() else {}


def row(name: str) -> WeightsFile:
    """The row of a name."""
    known = files()
    if name not in known:
        raise UserError(unknown("file of weights", name, known))
    return known[name]


def folders() -> tuple[Path, ...]:
    """The folders that are searched, in order: those of ``ANYSTYLE_WEIGHTS``, then the package's own."""
    named = [expanded(folder) for folder in os.environ.get(FOLDERS, "").split(os.pathsep) if folder]
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
    if entry.hub is not None and has_hub():
        from huggingface_hub import try_to_load_from_cache  # pyright: ignore[reportMissingImports]

        owner, repository, path = entry.hub.split("/", 2)
        cached = try_to_load_from_cache(f"{owner}/{repository}", path)
        if isinstance(cached, str):
            yield Path(cached)


def find(name: str, path: str | Path | None = None) -> Path:
    """The file of the weights called ``name``: the given one, or one of :func:`candidates`, else `MissingWeights`."""
    searched = [expanded(path)] if path is not None else list(candidates(name))
    for candidate in searched:
        if candidate.is_file():
            return candidate
    entry = row(name)
    by_hub = f" (`anystyle weights download {name}` does)" if entry.hub else ""
    shown = ", ".join(map(str, searched)) + (", the Hugging Face cache" if entry.hub and has_hub() else "")
    raise MissingWeights(
        f"the weights {name!r} are missing: get {entry.file} from {entry.source}{by_hub} ({entry.license}) and put it "
        f"into a folder that {FOLDERS} names; looked for {shown}"
    )


def download(name: str) -> Path:
    """Fetch a file from the Hugging Face hub into its cache; an interrupted download is continued."""
    entry = row(name)
    put = f"put it as {entry.file} into a folder that {FOLDERS} names"
    if entry.hub is None:
        raise UserError(
            f"the Hugging Face hub does not have {name!r}: get it from {entry.source} ({entry.license}) and {put}"
        )
    try:
        from huggingface_hub import hf_hub_download  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise ImportError(f'downloading {name} needs huggingface_hub: pip install "anystyle[hub]"') from None
    owner, repository, path = entry.hub.split("/", 2)
    try:
        return Path(hf_hub_download(f"{owner}/{repository}", path))
    except OSError as error:
        reason = next(iter(str(error).strip().splitlines()), type(error).__name__)
        raise UserError(
            f"{entry.hub} cannot be fetched ({reason}); try again, or get it from {entry.source} elsewhere and {put}"
        ) from None


def has_hub() -> bool:
    """Whether ``huggingface_hub`` is installed."""
    return importlib.util.find_spec("huggingface_hub") is not None


def verified(name: str, path: str | Path) -> bool | None:
    """Whether a file has the checksum that its publisher states; ``None`` if none is stated."""
    stated = row(name).sha256
    return None if stated is None else sha256(path).startswith(stated)


def licenses(loaded: object) -> dict[str, dict[str, str]]:
    """For each part that was loaded from a ``file``: the file, its licence, and what that means for a result."""
    if not isinstance(loaded, Mapping):
        return {}
    terms = {entry.file: entry.license for entry in files().values()}
    named = {part: str(entry["file"]) for part, entry in loaded.items()}
    return {
        part: {"file": file, "license": terms.get(file, "not stated"), "means": license_meaning(terms.get(file))}
        for part, file in named.items()
    }


BINDING = "results may not be used commercially"


def license_meaning(license: str | None) -> str:
    """What a licence of weights means for a scene made with them, in a sentence; no legal advice."""
    if license is not None and any(word in license for word in ("NC", "non-commercial", "noncommercial", "research")):
        return BINDING
    if license is not None and license.startswith(("Apache", "MIT", "BSD", "CC0", "CC-BY-4.0")):
        return "results may be used freely; redistributed weights keep their notice"
    return "the terms are not known; ask the publisher of the weights before you share results"


def license_lines(terms: Mapping[str, Mapping[str, str]]) -> Iterator[str]:
    """A line for each part of :func:`licenses`, for a file's header or a caption."""
    for part, entry in terms.items():
        yield f"{part}: {entry['file']}, {entry['license']}: {entry['means']}"


def binding(lines: Iterable[str]) -> tuple[str, ...]:
    """Those of :func:`license_lines` whose licence binds results; others concern the weights alone."""
    return tuple(line for line in lines if line.endswith(BINDING))


Weights = Literal["auto", "published", "stand_in"]
"""``published`` requires published weights, ``stand_in`` takes a stand-in, ``auto`` does so where they are missing."""


def locate(network: str, choice: Weights) -> Path | None:
    """The published weights of a network; ``None`` where a stand-in is chosen or replaces missing ones."""
    if choice == "stand_in":
        return None
    try:
        return find(network)
    except MissingWeights as error:
        if choice == "published":
            raise
        log.warning("a stand-in replaces %s, its figures are not comparable: %s", network, error)
        return None


def published(network: str, file: Path) -> Source:
    """The source of a network that was read from a file."""
    status = file.stat()
    return Source(network=network, file=file.name, sha256=_digest(file, status.st_mtime_ns, status.st_size))


def bundled(network: str, stand_in: str) -> Source:
    """The source of a stand-in that rests on the bundled texture network."""
    return replace(published("texture", find("texture")), network=network, stand_in=stand_in)


def stand_ins(figures: Iterable[str], *sources: Source) -> dict[str, str]:
    """For each of the figures that rest on these networks, the stand-ins among them; empty where there is none."""
    names = ", ".join(dict.fromkeys(source.stand_in for source in sources if source.stand_in))
    return dict.fromkeys(figures, names) if names else {}


def checksums(*sources: Source) -> dict[str, str]:
    """The SHA-256 of every file that was read, by its name."""
    return {source.file: source.sha256 for source in sources if source.file}


@cache
def _digest(file: Path, changed: int, size: int) -> str:
    return sha256(file)


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
    try:
        state = load_file(path) if path.suffix == ".safetensors" else _torch_file(path)
    except (MemoryError, UserError):
        raise
    except pickle.UnpicklingError:
        raise UserError(f"{path} is damaged or holds more than tensors; get it again") from None
    except Exception as error:  # damaged archives and pickles raise nearly anything
        reason = (str(error).strip() or type(error).__name__).splitlines()[0]
        raise UserError(f"{path} is truncated or no file of weights ({reason}); get it again") from None
    for name in ("state_dict", "model_state_dict"):
        if isinstance(state, Mapping) and isinstance(state.get(name), Mapping):
            state = state[name]
    if not isinstance(state, Mapping) or not all(
        isinstance(key, str) and isinstance(value, Tensor) for key, value in state.items()
    ):
        raise UserError(f"{path} holds no plain state dict; save `module.state_dict()` alone")
    try:
        check_tensors(state.values())
    except UserError as error:
        raise UserError(f"{path}: {error}") from None
    return dict(state)


def _torch_file(path: Path) -> Any:
    mapped = zipfile.is_zipfile(path)
    known: list[str] = []
    if mapped:
        with zipfile.ZipFile(path) as archive:
            if any(name.split("/")[1:2] == ["constants.pkl"] for name in archive.namelist()):
                raise UserError(f"{path} is a TorchScript program; get the state dict, as .safetensors or .pt")
        known = torch.serialization.get_unsafe_globals_in_checkpoint(path)
    ignored: list[Any] = [(_Ignored, name) for name in known if name.startswith(IGNORED)]
    if foreign := sorted(set(known) - {name for _, name in ignored}):
        raise UserError(
            f"{path} holds code or objects of other programs ({', '.join(foreign)}); get the state dict alone"
        )
    with torch.serialization.safe_globals(ignored):
        return torch.load(path, map_location="cpu", weights_only=True, mmap=mapped)
