"""The options of ``anystyle stylize`` that do not belong to a plugin.

These dataclasses are the schema of the configuration, too: ``conf/stylize.yaml`` names them, and has no defaults of
its own.
"""

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

from anystyle.contracts import Injector
from anystyle.errors import UserError, did_you_mean
from anystyle.paths import expanded
from anystyle.ranges import AtLeastOne, Range
from anystyle.registry.build import choice
from anystyle.registry.catalog import catalog
from anystyle.registry.schema import check_fields

PATHS, MAX_FRAMES = ("smooth", "orbit"), 100_000
"""Of films."""


@dataclass(frozen=True)
class BranchOptions:
    """What the style branch predicts; :class:`anystyle.branch.StyleBranch` documents each option but the last two.

    Args:
        published: Whether it is the branch that the backbone was published with, which fixes all other options, in
            place of copies with injectors.
        injectors: Other injectors than ``injector``, by patterns of sites, such as ``{aggregator/*: film, head/direct:
            {lora: {rank: 4}}}``; where several patterns match a site, the last one's.
    """

    styled: list[str] = field(default_factory=lambda: ["rotation", "color"])
    sh_degree: Annotated[int, Range(ge=0, le=4)] = 0
    single_view: bool = False
    published: bool = False
    injectors: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_fields(self, "branch")
        if self.published and replace(self, published=False) != BranchOptions():
            raise UserError("branch.published=true fixes what a branch styles; set no other option of branch with it")
        for one in self.injectors.values():
            choice(Injector, one)


@dataclass(frozen=True)
class ViewOptions:
    """How photographs are read, and how many are encoded together.

    Args:
        short_side: Shorter side of the views in pixels; ``None`` is the size that the reconstruction is made for, and
            for a given scene the size that it was made at, or 384.
        resize: Whether photographs are brought to one size; otherwise they are taken pixel by pixel, and their sides
            must be multiples of the backbone's patch size.
        take: The most photographs that are read; of more, evenly spaced ones. ``None`` is the reconstruction's number,
            and 48 frames of a video.
        max_views: More views than this are encoded in overlapping groups; ``None`` encodes all in one pass.
        overlap: Views that neighbouring groups share; ``None`` is a quarter of a group.
        masks: A folder with an image named as each photograph, upright as this, white where it counts.
        masked: What is there where a mask is black. ``ignored``: something that is not part of the scene, such as
            passers-by; other photographs show what is behind. ``empty``: nothing, as where a photograph is transparent.
        panorama: Into how many views around the horizon, at least 4, photographs twice as wide as high are cut by
            poses=sfm; a further one looks up. ``None`` is 6 where they have the tag or the look of 360° photographs, 0
            cuts none.
    """

    short_side: Annotated[int, Range(ge=1, le=1 << 16)] | None = None
    resize: bool = True
    take: AtLeastOne | None = None
    max_views: AtLeastOne | None = None
    overlap: AtLeastOne | None = None
    masks: str | None = None
    masked: str = "ignored"
    panorama: Annotated[int, Range(ge=0, le=24)] | None = None

    def __post_init__(self) -> None:
        check_fields(self, "views")
        _expect("views.masked", self.masked, ("ignored", "empty"))
        if self.masks is not None and not expanded(self.masks).is_dir():
            raise UserError(f"views.masks={self.masks}: there is no folder of masks")
        if self.short_side is not None and not self.resize:
            raise UserError(f"views.short_side={self.short_side} with views.resize=false; give one of them")


@dataclass(frozen=True)
class PoseOptions:
    """Where the cameras of photographs come from.

    Args:
        use: ``predicted``: from the backbone. ``known``: stored beside the photographs by a program that a plugin
            of kind ``cameras`` reads. ``target``: predicted, and the scene is rendered from the stored ones. ``auto``:
            stored ones where most photographs have them, else estimated by a plugin of kind ``pose_estimator`` where
            that succeeds, else predicted; or such a plugin.
            ``None`` is ``known`` for a backbone with ``needs_cameras``, ``predicted`` for another stylizer in memory or
            one with ``trusted_cameras``, else ``auto``.
        folder: Holds stored cameras, or is their file, if not in the photographs' folder or the one above.
    """

    use: str | None = None
    folder: str | None = None

    def __post_init__(self) -> None:
        if self.use is not None:
            _expect("poses", self.use, ("predicted", "target", "known", "auto", *catalog().names("pose_estimator")))


@dataclass(frozen=True)
class ExportOptions:
    """Which files a result has besides its scene.

    Args:
        colmap: ``binary`` or ``text`` writes a COLMAP model, ``none`` does not.
        up: The axis that points up in the scene's files: ``x``, ``-x``, ``y``, ``-y`` (or ``opencv``), ``z`` or ``-z``;
            ``None`` is what readers of each format expect, which for PLY is ``opencv``.
        formats: Further files of the scene, by plugins of kind ``format``.
        renders: Whether the restyled views and a film are written; ``None`` is yes, but of a file of Gaussians only
            where an option of ``video`` is given.
    """

    colmap: str = "none"
    up: str | None = None
    formats: list[str] = field(default_factory=list)
    renders: bool | None = None

    def __post_init__(self) -> None:
        _expect("export.colmap", self.colmap, ("none", "binary", "text"))
        object.__setattr__(self, "up", named_axes("export.up", self.up))
        for name in self.formats:
            catalog().find("format", name)


@dataclass(frozen=True)
class SplatOptions:
    """How a scene that is given as Gaussians is read, and where it is seen from.

    Args:
        cameras: The most views.
        folder: Where cameras are stored, if not beside the file or one folder above.
        up: The axis that points up in the file: ``x``, ``-x``, ``y``, ``-y`` (or ``opencv``, which 3DGS has), ``z`` or
            ``-z``; ``None`` is what the file says, or else its format. Results are in OpenCV's axes.
        activated: Whether a file holds lengths and opacities in [0, 1] where its format has logarithms and logits.
        antialiased: Whether it was trained with antialiasing, by which opacities are lowered; ``None`` is what it says.
        max_gaussians: Merge it into at most so many Gaussians, where that shows least from its cameras.
    """

    cameras: Annotated[int, Range(ge=1, le=1 << 16)] = 24
    folder: str | None = None
    up: str | None = None
    activated: bool = False
    antialiased: bool | None = None
    max_gaussians: AtLeastOne | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "up", named_axes("splat.up", self.up))
        check_fields(self, "splat")


@dataclass(frozen=True)
class VideoOptions:
    """The film of a result.

    Args:
        path: ``smooth`` is through the cameras, ``orbit`` a circle around what they look at; or a file of a camera path
            that nerfstudio's viewer wrote.
        frames: How many frames; ``None`` is 72, or what a file's path lasts.
        fps: Frames per second.
        scale: Size of a frame relative to the input views.
        height: Height of a frame in pixels, instead of the scale.
        stills: How many frames are also written as JPEG into the folder ``stills``, evenly spaced.
        turns: Whole circles of ``orbit``, by default 1; less than 1 is a part, and below 0 is the other way.
        fade: Whether what no photograph shows from about there fades to the background, instead of smearing.
    """

    path: str = "smooth"
    frames: Annotated[int, Range(ge=1, le=MAX_FRAMES)] | None = None
    fps: Annotated[int, Range(ge=1, le=1000)] = 24
    scale: Annotated[float, Range(ge=0.01, le=8)] = 1.0
    height: Annotated[int, Range(ge=2, le=4320)] | None = None
    stills: Annotated[int, Range(ge=0, le=1000)] = 0
    turns: Annotated[float, Range(ge=-100, le=100)] | None = None
    fade: bool = True

    def __post_init__(self) -> None:
        check_fields(self, "video")
        if self.path not in PATHS and Path(self.path).suffix.lower() != ".json":
            near = did_you_mean(self.path, PATHS)
            raise UserError(f"video.path={self.path}; give {', '.join(PATHS)} or a .json file of a camera path.{near}")
        if self.turns is not None and self.path != "orbit":
            raise UserError(f"video.turns={self.turns:g} has no meaning with video.path={self.path}; leave it out")
        if self.turns == 0:
            raise UserError("video.turns=0; give turns of at most 100 either way, and not 0")


def named_axes(option: str, up: str | None) -> str | None:
    """One of :data:`anystyle.types.scene.AXES`, or ``None``, for what an option says."""
    _expect(option, str(up), ("None", "opencv", "x", "-x", "y", "-y", "z", "-z"))
    return "opencv" if up == "-y" else up


def _expect(option: str, value: str, choices: Collection[str]) -> None:
    if value not in choices:
        raise UserError(f"{option}={value}; choose one of {', '.join(choices)}")
