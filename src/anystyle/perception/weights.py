"""Where the weights of frozen networks lie: names to files, where each comes from, where it is looked for.

A network is never replaced by another in silence, and nothing is downloaded unless ``anystyle weights download`` is
run. The table is :data:`FILES`; a plugin adds rows of its own in a ``weights.toml`` beside its module, and files of
theirs in a folder ``assets``.
"""

import hashlib
import importlib.util
import os
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from anystyle import paths
from anystyle.errors import did_you_mean
from anystyle.perception.reading import read
from anystyle.registry.catalog import catalog
from anystyle.registry.peek import folder

FOLDERS = "ANYSTYLE_WEIGHTS"
"""The environment variable that names folders of weights, separated as in ``PATH``."""
TABLE = "weights.toml"
"""A plugin's rows, beside its module; files of theirs that are bundled lie in ``assets`` there."""


@dataclass(frozen=True)
class WeightsFile:
    """One file of weights.

    Args:
        file: Its name.
        purpose: What needs it.
        license: Under which terms it may be used.
        source: Where it comes from, in words that can be looked up.
        sha256: Of its content, in hexadecimal; as many leading digits as its publisher states, ``None`` if none.
        bundled: Whether it comes with this package, or with the plugin that names it.
        size: Bytes that its tensors take, or of the whole file where a publisher states it; ``None`` if unknown.
        hub: Where the Hugging Face hub has it, as ``owner/repository/path``.
        package: An installed package that it travels with, as ``package/path``.
        layout: What its tensors are called: a key of :data:`anystyle.perception.layouts.LAYOUTS`, or the plugin's
            backbone.
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


def _ours(name: str, purpose: str, experiment: str) -> WeightsFile:
    return WeightsFile(
        file=f"{name}.safetensors",
        purpose=purpose,
        license="Apache-2.0",
        source=f"bundled; made by `anystyle train experiment={experiment}`",
        bundled=True,
        layout="anystyle",
    )


_TORCHVISION = "BSD-3-Clause (torchvision); trained on ImageNet"

FILES: dict[str, WeightsFile] = {
    "longclip_b32": WeightsFile(
        file="longclip-B-32.pt",
        purpose="style_encoder=long_clip, which the published style branches were trained with",
        license="Apache-2.0",
        source="https://huggingface.co/BeichenZhang/LongCLIP-B-32",
        size=605_967_364,
        hub="BeichenZhang/LongCLIP-B-32/longclip-B-32.pt",
        layout="clip",
    ),
    "clip_b32": WeightsFile(
        file="open_clip_model.safetensors",
        purpose="style_encoder=clip; OpenAI's CLIP ViT-B/32 in OpenCLIP's file",
        license="MIT (OpenAI CLIP)",
        source="https://huggingface.co/timm/vit_base_patch32_clip_224.openai",
        size=605_109_252,
        hub="timm/vit_base_patch32_clip_224.openai/open_clip_model.safetensors",
        layout="clip",
    ),
    "clip_vocabulary": WeightsFile(
        file="bpe_simple_vocab_16e6.txt.gz",
        purpose="texts of style_encoder=long_clip and style_encoder=clip",
        license="MIT (OpenAI CLIP)",
        source="the open_clip_torch package (`pip install --no-deps open_clip_torch`)",
        sha256="924691ac288e54409236115652ad4aa250f48203de50a9e4722a6ecd48d6804a",
        size=1_356_917,
        package="open_clip/bpe_simple_vocab_16e6.txt.gz",
    ),
    "vgg19": WeightsFile(
        file="vgg19-dcbb9e9d.pth",
        purpose="style and content losses of the paper; CFSD",
        license=_TORCHVISION,
        source="https://download.pytorch.org/models/vgg19-dcbb9e9d.pth",
        sha256="dcbb9e9d",
        size=574_673_361,
        layout="vgg19",
    ),
    "alexnet": WeightsFile(
        file="alexnet-owt-7be5be79.pth",
        purpose="LPIPS of art_fid, lpips and lpips_gray",
        license=_TORCHVISION,
        source="https://download.pytorch.org/models/alexnet-owt-7be5be79.pth",
        sha256="7be5be79",
    ),
    "vgg16": WeightsFile(
        file="vgg16-397923af.pth",
        purpose="LPIPS of warp_consistency",
        license=_TORCHVISION,
        source="https://download.pytorch.org/models/vgg16-397923af.pth",
        sha256="397923af",
    ),
    "lpips_alex": WeightsFile(
        file="alex.pth",
        purpose="the linear heads of LPIPS over alexnet",
        license="BSD-2-Clause (Zhang et al. 2018)",
        source="the torchmetrics package",
        package="torchmetrics/functional/image/lpips_models/alex.pth",
    ),
    "lpips_vgg": WeightsFile(
        file="vgg.pth",
        purpose="the linear heads of LPIPS over vgg16",
        license="BSD-2-Clause (Zhang et al. 2018)",
        source="the torchmetrics package",
        package="torchmetrics/functional/image/lpips_models/vgg.pth",
    ),
    "art_inception": WeightsFile(
        file="art_inception.pth",
        purpose="FID of art_fid; kid",
        license="MIT (ArtFID, Wright and Ommer 2022); trained on WikiArt",
        source="https://huggingface.co/matthias-wright/art_inception/resolve/main/art_inception.pth",
        hub="matthias-wright/art_inception/art_inception.pth",
    ),
    "art_score": WeightsFile(
        file="loss@listMLE_model@resnet50_denseLayer@True_batch_size@16_lr@0.0001_dropout@0.5_E_8.pth",
        purpose="art_score",
        license="as the ArtScore repository states (Chen et al. 2024)",
        source="https://github.com/jchen175/ArtScore",
    ),
    "raft_things": WeightsFile(
        file="raft-things.pth",
        purpose="correspondence=raft, which warp_consistency uses",
        license="BSD-3-Clause (RAFT, Teed and Deng 2020)",
        source="https://github.com/princeton-vl/RAFT (download_models.sh)",
    ),
    "raft_large": WeightsFile(
        file="raft_large_C_T_V2-1bb1363a.pth",
        purpose="correspondence=raft with checkpoint=raft_large",
        license="BSD-3-Clause (torchvision)",
        source="https://download.pytorch.org/models/raft_large_C_T_V2-1bb1363a.pth",
        sha256="1bb1363a",
    ),
    "texture": _ours("tiny_texture", "style losses of the tiny recipes", "tiny_perceptual"),
    "tiny_style_encoder": _ours("tiny_style_encoder", "style_encoder=tiny", "tiny_embedding"),
    "tiny_judge": _ours("tiny_judge", "judge of protocol=tiny_heldout", "tiny_judge"),
    "tiny_backbone": _ours("tiny_backbone", "model=tiny", "tiny_reconstruction"),
    "tiny_head": _ours("tiny_head", "model=tiny, placement=head", "tiny_style"),
    "tiny_full": _ours("tiny_full", "model=tiny_full, placement=full", "tiny_style_full"),
}


def files() -> dict[str, WeightsFile]:
    """Every row by name: those of :data:`FILES`, then those of plugins.

    Raises:
        ValueError: A plugin's ``weights.toml`` cannot be read, or names what is there already.
    """
    known = dict(FILES)
    for place in _plugins():
        for name, entry in _rows(place / TABLE).items():
            if known.setdefault(name, entry) != entry:
                raise ValueError(f"{place / TABLE} names {name!r}, which another row is called; rename it")
    return known


def _plugins() -> list[Path]:
    return sorted({place for row in catalog() if (place := folder(row)) is not None})


@cache
def _rows(path: Path) -> dict[str, WeightsFile]:
    if not path.is_file():
        return {}
    try:
        return {name: WeightsFile(**row) for name, row in tomllib.loads(path.read_text(encoding="utf-8")).items()}
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path} is no table of weights ({error}); see anystyle.perception.weights") from None


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
    """The folders that are looked in, in order: those of ``ANYSTYLE_WEIGHTS``, then the package's own."""
    named = [Path(folder).expanduser() for folder in os.environ.get(FOLDERS, "").split(os.pathsep) if folder]
    return (*named, paths.ASSETS)


def places(name: str) -> Iterator[Path]:
    """Where a file is looked for, in order: named folders, ours, the plugin's, another package, the hub's cache."""
    entry = row(name)
    for place in folders():
        yield place / entry.file
    if entry.bundled:
        yield from (place / "assets" / entry.file for place in _plugins() if name in _rows(place / TABLE))
    if entry.package is not None:
        package, _, inside = entry.package.partition("/")
        spec = importlib.util.find_spec(package)
        if spec is not None and spec.submodule_search_locations:
            yield Path(next(iter(spec.submodule_search_locations))) / inside
    if entry.hub is not None and (cached := _in_hub_cache(entry.hub)) is not None:
        yield cached


def find(name: str, path: str | Path | None = None) -> Path:
    """The file that holds the weights called ``name``.

    Args:
        name: A key of :func:`files`.
        path: Where it lies, if not in one of :func:`places`.

    Raises:
        FileNotFoundError: It is nowhere; the message says where to get it and where to put it.
    """
    looked = [Path(path).expanduser()] if path is not None else list(places(name))
    for place in looked:
        if place.is_file():
            return place
    raise FileNotFoundError(missing(name, looked))


def missing(name: str, looked: list[Path]) -> str:
    """One line for a file that is nowhere: which, from where, and where to put it."""
    entry = row(name)
    by_hub = f" (`anystyle weights download {name}` does)" if entry.hub else ""
    shown = ", ".join(map(str, looked)) + (", the Hugging Face cache" if entry.hub and _has_hub() else "")
    return (
        f"the weights {name!r} are missing: get {entry.file} from {entry.source}{by_hub} ({entry.license}) and put it "
        f"into a folder that {FOLDERS} names; looked for {shown}"
    )


def download(name: str) -> Path:
    """Fetch a file from the Hugging Face hub into its cache; an interrupted download goes on where it stopped.

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
    """Whether a file's content is what its publisher states; ``None`` where nothing is stated."""
    stated = row(name).sha256
    if stated is None:
        return None
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest().startswith(stated)


__all__ = [
    "FILES",
    "FOLDERS",
    "TABLE",
    "WeightsFile",
    "download",
    "files",
    "find",
    "folders",
    "missing",
    "places",
    "read",
    "row",
    "verified",
]
