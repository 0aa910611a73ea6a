"""What a stylization is asked for, as one value; what is stylized is decided once, as it is made."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path

from omegaconf import DictConfig

from anystyle.contracts import StyleSource
from anystyle.errors import UserError
from anystyle.paths import expanded, natural
from anystyle.pipeline.controls import Controls
from anystyle.pipeline.film import Film
from anystyle.pipeline.options import ExportOptions, PoseOptions, SplatOptions, VideoOptions, ViewOptions
from anystyle.pipeline.styles import StyleInput, check_styles
from anystyle.ranges import checked_seed
from anystyle.registry.build import build
from anystyle.registry.catalog import catalog
from anystyle.registry.compose import compose, options, override
from anystyle.types import Style, Views

OWN = ".safetensors"
"""The suffix of the Gaussians that ``anystyle stylize`` writes without any loss."""
CHECKPOINTS = (".pt", ".pth", ".ckpt")
PICTURE = "style.jpg"
"""The small picture of a style beside its result, where it is an image."""


@dataclass(frozen=True)
class Photographs:
    """Folders of photographs, files, patterns and videos."""

    paths: tuple[Path, ...]


@dataclass(frozen=True)
class SavedScene:
    """A file of Gaussians, or a folder of results."""

    path: Path


@dataclass(frozen=True)
class InMemory:
    """Views of one scene, in memory."""

    views: Views


Inputs = Photographs | SavedScene | InMemory
GivenInputs = str | Path | Sequence[str | Path] | Views
"""How Python names inputs: a folder, files, a pattern, a video or a saved scene; or views of one scene."""


def inputs_of(given: GivenInputs) -> Inputs | None:
    """What is given: one path may be a saved scene, others are photographs; ``None`` for no path."""
    if isinstance(given, Views):
        return InMemory(given)
    paths = tuple(map(Path, [given] if isinstance(given, (str, Path)) else given))
    if len(paths) == 1 and is_saved(paths[0]):
        return SavedScene(file_of(paths[0]))
    return Photographs(paths) if paths else None


def is_saved(path: Path) -> bool:
    """Whether this is a file or folder of Gaussians, or a folder that ``anystyle stylize`` wrote, and no capture."""
    if path.is_dir() and (path / "report.json").is_file() and any(path.glob("*.safetensors")):
        return True
    path = file_of(path)
    return scene_format(path) is not None or (path.suffix.lower() == OWN and not path.is_dir())


def file_of(path: Path) -> Path:
    """The file of a run's folder of 3DGS, ``point_cloud/iteration_N/point_cloud.ply`` of the largest N; else the path.

    Example:
        >>> file_of(Path("scene.ply"))
        PosixPath('scene.ply')

    Raises:
        UserError: It is a checkpoint of a trainer, or a folder of such.
    """
    held = [path] if path.is_file() else [*path.glob("[!.]*")]
    if held and all(each.suffix.lower() in CHECKPOINTS for each in held):
        raise UserError(
            f"{held[0]} is a checkpoint, and files of Gaussians are read: gsplat's trainer writes a PLY with "
            "--save_ply, nerfstudio's scene becomes one by ns-export gaussian-splat"
        )
    found = path.glob("point_cloud/iteration_*/point_cloud.ply") if path.is_dir() else ()
    return max(found, key=lambda file: natural(file.parent.name), default=path)


def scene_format(path: Path) -> str | None:
    """The plugin of kind ``format`` that reads a file as a scene of Gaussians, by its suffix, if one does."""
    suffix = path.suffix.lower()[1:]
    return suffix if suffix in catalog().names("format") and not path.is_dir() else None


@dataclass(frozen=True)
class Request:
    """What a stylization is asked for.

    The command line (:mod:`anystyle.pipeline.words`), :func:`anystyle.stylize`, the viewer and the app make one of
    these.

    Args:
        inputs: Photographs, a saved scene or views in memory; ``None`` for the configured ``scenes``.
        styles: Each gives a result; texts, image files, and what :func:`anystyle.stylize` takes.
        controls: How each style is applied; each combination of a style and controls gives a result.
        overrides: In Hydra's grammar, such as ``model=tiny``, ``views.take=12`` and ``video.path=orbit``.
        composed: The configuration with these overrides, where Hydra has composed it already.

    Example:
        >>> Request(inputs_of("photos/"), ("blue ink",), overrides=("views.take=12",)).views.take
        12
    """

    inputs: Inputs | None = None
    styles: tuple[StyleInput, ...] = ()
    controls: tuple[Controls, ...] = (Controls(),)
    overrides: tuple[str, ...] = ()
    composed: DictConfig | None = field(default=None, repr=False, compare=False)

    @classmethod
    def of(
        cls, inputs: GivenInputs, styles: Sequence[StyleInput], controls: Sequence[Controls], **given: object
    ) -> "Request":
        """The request of Python values; ``given`` are groups with a choice, a dataclass of options, or a mapping."""
        words = tuple(word for key, value in given.items() for word in _overrides_of(key, value))
        return cls(inputs_of(inputs), tuple(styles), tuple(controls), words)

    @cached_property
    def config(self) -> DictConfig:
        """The composed configuration, with what a training has learnt where ``run`` names one."""
        config = compose("stylize", self.overrides) if self.composed is None else self.composed
        if config.run is None:
            return config
        from anystyle.pipeline.trained import configured, trained_run

        return configured(config, trained_run(expanded(config.run)))

    @property
    def views(self) -> ViewOptions:
        """How photographs are read, and how many are encoded together."""
        return options(self.config, "views")

    @property
    def poses(self) -> PoseOptions:
        """Where the cameras of photographs come from."""
        return PoseOptions(self.config.poses, self.config.poses_from)

    @property
    def splat(self) -> SplatOptions:
        """How a scene that is given as Gaussians is read, and where it is seen from."""
        return options(self.config, "splat")

    @property
    def export(self) -> ExportOptions:
        """Which files a result has."""
        return options(self.config, "export")

    @property
    def video(self) -> VideoOptions:
        """What the film of a result is like."""
        return options(self.config, "video")

    @property
    def seed(self) -> int:
        """The seed of random numbers."""
        return checked_seed(self.config.seed)

    @cached_property
    def all_styles(self) -> tuple[StyleInput, ...]:
        """The styles, then those that the configuration chooses of ``styles``."""
        chosen: list[StyleInput] = []
        for index in self.config.style:
            image = build(StyleSource, self.config.styles).read(index).image
            if image is None:
                raise UserError(f"style={index} has no image")
            chosen.append(Style(image=image, names=(f"style {index}",)))
        return (*self.styles, *chosen)

    def check(self) -> None:
        """Refuse what makes no sense or is not there, before networks are loaded."""
        if not self.all_styles or not self.controls:
            raise UserError('no style is given; add --text "..." or --image FILE, and at least one control or none')
        self.check_inputs()
        check_styles(self.all_styles)
        for key in ("views", "splat", "export"):
            options(self.config, key)
        Film(self.video)
        checked_seed(self.config.seed)

    def check_inputs(self) -> None:
        """Refuse inputs that are not there, which takes no time, before networks are loaded, which takes long."""
        if self.inputs is None and self.config.get("scenes") is None:
            raise UserError("no photographs are given; name a folder, files or a video")
        match self.inputs:
            case SavedScene(path) if not path.exists():
                raise UserError(
                    f"there is no file {path}; name photographs, a video, a file of Gaussians or a saved folder"
                )
            case Photographs(paths):
                from anystyle.data.folder import files_of

                for path in paths:
                    files_of(path)
        folder = self.poses.folder
        if folder is not None and not Path(folder).exists():
            raise UserError(f"poses_from={folder} does not exist; name the folder or file that holds the cameras")


def _overrides_of(key: str, value: object) -> list[str]:
    """A group's choice, a dataclass of options or a mapping, as overrides of what is not a default."""
    match value:
        case None:
            return []
        case PoseOptions(use=use, folder=folder):
            return [*_overrides_of("poses", use), *_overrides_of("poses_from", folder)]
        case ViewOptions() | SplatOptions() | ExportOptions():
            default = type(value)()
            changed = {item.name: getattr(value, item.name) for item in fields(value)}
            return [override(f"{key}.{k}", v) for k, v in changed.items() if v != getattr(default, k)]
        case dict():
            return [override(f"{key}.{name}", item) for name, item in value.items()]
        case _:
            return [override(key, value)]
