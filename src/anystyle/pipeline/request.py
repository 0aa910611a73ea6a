"""What a stylization is asked for, as one value."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path

from omegaconf import DictConfig

from anystyle.contracts import StyleSource
from anystyle.errors import UserError
from anystyle.pipeline.controls import Controls
from anystyle.pipeline.film import Film
from anystyle.pipeline.inputs import GivenInputs, Inputs, check_inputs, inputs_of
from anystyle.pipeline.options import ExportOptions, PoseOptions, SplatOptions, VideoOptions, ViewOptions
from anystyle.pipeline.styles import StyleInput, check_styles
from anystyle.ranges import checked_seed
from anystyle.registry.build import build
from anystyle.registry.compose import compose, options, override
from anystyle.types import Style


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
        """The composed configuration."""
        return compose("stylize", self.overrides) if self.composed is None else self.composed

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
        """Refuse inputs that are not there."""
        if self.inputs is None and self.config.get("scenes") is None:
            raise UserError("no photographs are given; name a folder, files or a video")
        check_inputs(self.inputs)
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
