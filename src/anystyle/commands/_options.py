"""The options of a command that belong to no plugin, each of its type, before any work begins."""

from typing import Annotated, Any, Literal, TypeVar

import msgspec
from omegaconf import DictConfig, OmegaConf

from anystyle.documents import fit
from anystyle.inference.options import ExportOptions, SplatOptions, VideoOptions, ViewOptions

T = TypeVar("T", bound=msgspec.Struct)
Seed = Annotated[int, msgspec.Meta(ge=0, le=(1 << 63) - 1)]
Index = Annotated[int, msgspec.Meta(ge=0)]


class Branch(msgspec.Struct):
    """What the style branch styles."""

    styled: list[str]
    sh_degree: Annotated[int, msgspec.Meta(ge=0, le=4)]
    one_view: bool = False


class Shared(msgspec.Struct, kw_only=True):
    """What every root has from ``conf/stylizer.yaml``."""

    seed: Seed
    precision: Literal["fp32", "bf16", "reference"]
    branch: Branch
    fit_colors: Index | bool | str
    keep_harmonics: bool
    weights: dict[str, str | None]


class Stylize(Shared, kw_only=True):
    """What ``conf/stylize.yaml`` adds."""

    views: ViewOptions
    splat: SplatOptions
    export: ExportOptions
    video: VideoOptions
    poses: str | None
    poses_from: str | None
    refine: bool
    scene: Index
    style: list[Index]


def checked(config: DictConfig, shape: type[T]) -> T:
    """The options of a command as one value.

    Raises:
        ValueError: One is of another type or out of its range; the message names it.
    """
    names = [field.name for field in msgspec.structs.fields(shape) if field.name in config]
    plain: Any = OmegaConf.to_container(OmegaConf.masked_copy(config, names), resolve=True, enum_to_str=True)
    return fit(plain, shape, source="the configuration", what="valid one")
