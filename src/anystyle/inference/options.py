"""Options of a stylization, resolved and checked: what flows down from the configuration or from a caller."""

from collections.abc import Collection
from dataclasses import dataclass, field


@dataclass(frozen=True)
class ViewOptions:
    """How photographs are read, and how many are encoded together.

    Args:
        short_side: Shorter side of the views in pixels; ``None`` is the size that the backbone's weights were made for.
        resize: Whether photographs are brought to one size; otherwise they are taken pixel by pixel as they are.
        take: Of more photographs, so many are taken, evenly spaced.
        max_views: More views than this are encoded in groups that overlap; ``None`` takes all in one pass.
        overlap: Views that neighbouring groups share; ``None`` is a quarter of a group.
    """

    short_side: int | None = None
    resize: bool = True
    take: int = 48
    max_views: int | None = None
    overlap: int | None = None

    def __post_init__(self) -> None:
        _between("views.short_side", self.short_side, 1, 1 << 16)
        _between("views.take", self.take, 1, 1 << 20)
        _between("views.max_views", self.max_views, 1, 1 << 20)
        _between("views.overlap", self.overlap, 1, 1 << 20)
        if self.short_side is not None and not self.resize:
            raise ValueError(f"views.short_side={self.short_side} with views.resize=false; give one of them")


@dataclass(frozen=True)
class PoseOptions:
    """Where the cameras of photographs come from.

    Args:
        use: ``predicted``: from the backbone. ``known``: those stored beside the photographs. ``target``: predicted,
            and the scene is rendered from the stored ones. ``sfm``: found by structure from motion. ``auto``: found
            like that where it can be done, predicted elsewhere.
        folder: Where they lie, if not in the photographs' folder or the one above.
    """

    use: str = "predicted"
    folder: str | None = None

    def __post_init__(self) -> None:
        _expect("poses", self.use, ("predicted", "target", "known", "sfm", "auto"))


@dataclass(frozen=True)
class ExportOptions:
    """Which files a result has besides its scene.

    Args:
        colmap: ``binary`` or ``text`` writes a COLMAP model, ``none`` does not.
        up: Axes of the scene's files: ``opencv``, ``y`` or ``z`` up; ``None`` is what readers of each format expect,
            which for PLY is OpenCV's. Everything else stays in OpenCV's.
        formats: Further files of the scene: ``glb, spz, sog, splat, html``.
    """

    colmap: str = "none"
    up: str | None = None
    formats: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        _expect("export.colmap", self.colmap, ("none", "binary", "text"))
        _expect("export.up", str(self.up), ("None", "opencv", "y", "z"))
        for name in self.formats:
            _expect("export.formats", name, ("ply", "glb", "spz", "sog", "splat", "html"))


@dataclass(frozen=True)
class SplatOptions:
    """From where a scene that is given as Gaussians is seen.

    Args:
        cameras: From how many views at most.
        folder: Where cameras are stored, if not beside the file or one folder above: COLMAP or ``transforms.json``.
        up: Axes of the file: ``opencv``, which 3DGS has, ``y`` or ``z`` up. Results are in OpenCV's.
    """

    cameras: int = 24
    folder: str | None = None
    up: str = "opencv"

    def __post_init__(self) -> None:
        _expect("splat.up", self.up, ("opencv", "y", "z"))
        if self.cameras < 1:
            raise ValueError(f"splat.cameras={self.cameras}; give at least 1")


@dataclass(frozen=True)
class VideoOptions:
    """A flight through the cameras.

    Args:
        frames: How many frames.
        fps: Frames a second.
        scale: Size of a frame relative to the input views.
    """

    frames: int = 90
    fps: int = 30
    scale: float = 1.0

    def __post_init__(self) -> None:
        _between("video.frames", self.frames, 1, 100_000)
        _between("video.fps", self.fps, 1, 1000)
        _between("video.scale", self.scale, 0.01, 8)


def _expect(option: str, value: str, choices: Collection[str]) -> None:
    if value not in choices:
        raise ValueError(f"{option}={value}; choose one of {', '.join(choices)}")


def _between(option: str, value: int | float | None, low: int | float, high: int | float) -> None:
    if value is not None and not low <= value <= high:
        raise ValueError(f"{option}={value}; give a number from {low} to {high}")
