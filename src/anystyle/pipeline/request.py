"""What ``anystyle stylize`` is asked for, as one value: from the arguments of the command line, and back to them."""

import argparse
import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from anystyle.cli.arguments import is_override, new_parser, split
from anystyle.cli.launch import checked_seed
from anystyle.contracts import StyleSource
from anystyle.errors import UserError
from anystyle.io.documents import read_json
from anystyle.pipeline.controls import FIELDS, Controls, Mask, combinations
from anystyle.pipeline.export import film
from anystyle.pipeline.options import ExportOptions, PoseOptions, SplatOptions, ViewOptions
from anystyle.pipeline.read import Inputs, check_inputs, paths_of
from anystyle.pipeline.styles import Mixture, Named, Places, StyleInput, check_styles, check_text
from anystyle.registry.build import build
from anystyle.registry.compose import compose, options, override
from anystyle.types import Style, Views

NUMBERS = ("strength", "preserve_color", "scale")
"""The controls that are numbers."""


@dataclass(frozen=True)
class Request:
    """What a stylization is asked for.

    The command line, :func:`anystyle.stylize`, the viewer and the benchmark make one of these. Options are overrides in
    Hydra's grammar, composed once, and read as the dataclasses of options.

    Args:
        inputs: Paths of photographs, patterns, a video or a saved scene; or views in memory. Without any, the
            configured ``scenes`` are used.
        styles: Each gives a result; texts, image files, and what :func:`anystyle.stylize` takes.
        controls: How each style is applied; each combination of a style and controls gives a result.
        overrides: Such as ``model=tiny``, ``views.take=12`` and ``video.path=orbit``.

    Example:
        >>> request = Request.from_args(["photos/", "--text", "blue ink", "--strength", "0.5", "views.take=12"])
        >>> request.views.take
        12
        >>> request.args()
        ['photos/', '--text', 'blue ink', '--strength', '0.5', 'views.take=12']
    """

    inputs: tuple[str, ...] | Views = ()
    styles: tuple[StyleInput, ...] = ()
    controls: tuple[Controls, ...] = (Controls(),)
    overrides: tuple[str, ...] = ()

    @classmethod
    def from_args(cls, args: Sequence[str]) -> "Request":
        """The request of a command line after ``anystyle stylize``; ``--out`` and ``--open`` do not belong to it.

        Raises:
            UserError: An argument is unknown, or does not go with another.
        """
        arguments, overrides = parsed(args)
        if foreign := [word for word in overrides if not is_override(word)]:
            raise UserError(f"{foreign[0]} is a flag of Hydra's, which only the command line takes")
        return cls.of(arguments, overrides)

    @classmethod
    def of(cls, arguments: argparse.Namespace, overrides: Sequence[str], config: DictConfig | None = None) -> "Request":
        """The request of what :func:`parsed` returns, with the configuration where Hydra has composed it already."""
        request = cls(tuple(arguments.inputs), _styles_of(arguments), tuple(_controls_of(arguments)), tuple(overrides))
        if config is not None:
            vars(request)["config"] = config
        return request

    @classmethod
    def made(
        cls, inputs: Inputs, styles: Sequence[StyleInput], controls: Sequence[Controls], **given: object
    ) -> "Request":
        """The request of Python values; ``given`` are groups with a choice, a dataclass of options, or a mapping."""
        words = tuple(word for key, value in given.items() for word in _overrides_of(key, value))
        located = inputs if isinstance(inputs, Views) else tuple(str(path) for path in paths_of(inputs))
        return cls(located, tuple(styles), tuple(controls), words)

    @cached_property
    def config(self) -> DictConfig:
        """The composed configuration."""
        return compose("stylize", self.overrides)

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
        if chosen and self.styles and isinstance(first := self.styles[0], Places) and len(self.styles) == 1:
            return (Places((*((style, None) for style in chosen), *first.styles)),)
        return (*self.styles, *chosen)

    def check(self) -> None:
        """Refuse what makes no sense or is not there, before networks are loaded."""
        if not self.all_styles or not self.controls:
            raise UserError('no style is given; add --text "..." or --image FILE, and at least one control or none')
        if isinstance(self.inputs, Views) or self.inputs:
            check_inputs(self.inputs, self.poses)
        elif self.config.get("scenes") is None:
            raise UserError("no photographs are given; name a folder, files or a video")
        check_styles(self.all_styles)
        for key in ("views", "splat", "export"):
            options(self.config, key)
        film(self.config.video)
        checked_seed(self.config.seed)

    def args(self) -> list[str]:
        """The arguments of the command line that ask for the same.

        Raises:
            UserError: Views or styles are in memory, or controls are not all combinations of their values.
        """
        if isinstance(self.inputs, Views):
            raise UserError("views in memory have no command line; give their files")
        inputs = [f"./{path}" if path.startswith("-") or is_override(path) else path for path in self.inputs]
        return [*inputs, *_styles_as_args(self.styles), *_controls_as_args(self.controls), *self.overrides]

    @property
    def digest(self) -> str | None:
        """By which the same request from the same folder is known again; ``None`` if something of it is in memory."""
        try:
            asked = [str(Path.cwd()), *replace(self, overrides=()).args()]
        except UserError:
            return None
        config = OmegaConf.to_yaml(self.config, resolve=True, sort_keys=True)
        return hashlib.sha256(json.dumps([*asked, config]).encode()).hexdigest()


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle stylize``; every other argument is a Hydra override."""
    flags = new_parser(
        "stylize",
        "Stylize photographs as a 3D Gaussian scene. Arguments such as key=value are Hydra overrides.",
        epilog="Every option of every component: anystyle stylize --cfg job",
    )
    add = flags.add_argument
    inputs = "a folder, files, a glob or a video; a PLY file or a folder of results; or none with scenes=NAME"
    add("inputs", nargs="*", help=inputs)
    style: dict[str, Any] = {"action": _StyleFlag, "dest": "styles", "default": []}
    add("--text", **style, help="a style in words; may be given several times")
    image = (
        "a style as an image file; likewise. STYLE@MASK is a style in one place of the scene, see --mask, and "
        "STYLE@color+rotation one of some attributes of opacity, scale, rotation, color; several make one scene"
    )
    add("--image", **style, help=image)
    name = "what the --text or --image before it is called in folders, on the sheet and in pages"
    add("--name", action=_NameFlag, dest="styles", help=name)
    mix = "with exactly two styles: the point between them, 0 is the first and 1 the second; likewise"
    add("--mix", action="append", default=[], metavar="AMOUNT", help=mix)
    control = flags.add_argument_group("how a style is applied; several values make a strip").add_argument
    several: dict[str, Any] = {"action": "append", "default": []}
    control("--strength", **several, metavar="0..1", help="0 is the unstyled scene")
    control("--preserve-color", **several, metavar="0..1", help="keep the scene's hues")
    control("--scale", **several, metavar="FACTOR", help="size of strokes")
    mask = (
        "where style enters: a folder of masks, sphere:X,Y,Z,RADIUS, box:X,Y,Z,X,Y,Z, "
        "like:X,Y,Z,RADIUS,TOLERANCE; ,soft=WIDTH after it"
    )
    control("--mask", **several, metavar="WHERE", help=mask)
    photo_masks = (
        "images named as the photographs; what is black in them, such as people or the sky, is not learnt. "
        "views.masked=empty: nothing is there"
    )
    add("--photo-masks", metavar="DIR", help=photo_masks)
    formats = "additional files of the scene, by the names of `anystyle plugins format`; several with commas"
    add("--export", default="", metavar="FORMATS", help=formats)
    add("--again", metavar="REPORT", help="what a report.json was asked for; further arguments are added")
    add("--out", default="out", help="where the results go (default: %(default)s)")
    add("--overwrite", action="store_true", help="replace the results of another run in --out")
    add("--open", action="store_true", help="look at them in the browser, where there is a display")
    return flags


def parsed(args: Sequence[str], flags: argparse.ArgumentParser | None = None) -> tuple[argparse.Namespace, list[str]]:
    """The flags of a command line, and its overrides with those that flags stand for."""
    arguments, overrides = split(flags or parser(), args)
    if arguments.again is not None:
        request = read_json(Path(arguments.again), dict[str, Any], what="report").get("request")
        if not isinstance(request, list):
            raise UserError(f"{arguments.again} does not say what was asked for; its inputs were in memory or left out")
        index = next(i for i, word in enumerate(args) if word.partition("=")[0] == "--again")
        following = args[index + (1 if "=" in args[index] else 2) :]
        return parsed([*map(str, request), *args[:index], *following], flags)
    meant: dict[str, object] = {} if arguments.photo_masks is None else {"views.masks": arguments.photo_masks}
    if arguments.export:
        if any(word.startswith("export.formats=") for word in overrides):
            raise UserError("formats are named twice; give --export or export.formats")
        meant["export.formats"] = arguments.export.split(",")
    return arguments, [*(override(key, value) for key, value in meant.items()), *overrides]


class _StyleFlag(argparse.Action):
    """Collects texts and images in one list, so that styles have the order in which they are typed."""

    def __call__(self, parser: object, namespace: argparse.Namespace, values: Any, option_string: Any = None) -> None:
        namespace.styles = [*namespace.styles, (Path if option_string == "--image" else str, values, None)]


class _NameFlag(argparse.Action):
    """Names the style before it."""

    def __call__(self, parser: object, namespace: argparse.Namespace, values: Any, option_string: Any = None) -> None:
        if not namespace.styles or namespace.styles[-1][2] is not None:
            raise UserError(f"--name {values} follows the --text or --image that it names")
        *others, (kind, word, _) = namespace.styles
        namespace.styles = [*others, (kind, word, values)]


def _styles_of(arguments: argparse.Namespace) -> tuple[StyleInput, ...]:
    """The styles in the order of their flags, or their mixtures, or one :class:`Places` of all."""
    given = [_by_place(word, _named(kind, name)) for kind, word, name in arguments.styles]
    for kind, word, _ in arguments.styles:
        if kind is str:
            check_text(word, "--text")
    amounts = _numbers("mix", arguments.mix)
    if not all(0 <= amount <= 1 for amount in amounts):
        raise UserError(f"--mix takes numbers between 0 and 1, not {','.join(arguments.mix)}")
    if any(place for _, place in given):
        if amounts:
            raise UserError("--mix applies two styles to the whole scene; leave out --mix, or the @... of the styles")
        return (Places(tuple(sorted(given, key=lambda one: one[1] is not None))),)
    styles = tuple(style for style, _ in given)
    if amounts and len(styles) != 2:
        raise UserError(f"--mix needs exactly two styles, and {len(styles)} are given; add or drop a --text or --image")
    return tuple(Mixture(styles[0], styles[1], amount) for amount in amounts) or styles


def _named(kind: type[str | Path], name: str | None) -> Callable[[str], StyleInput]:
    return kind if name is None else lambda word: Named(kind(word), name)


def _by_place(word: str, kind: Callable[[str], StyleInput]) -> tuple[StyleInput, Mask | Controls | None]:
    """A style, and the mask or the attributes behind its last ``@``, or both, if there are any."""
    style, at, place = word.rpartition("@")
    attributes = tuple(place.split("+"))
    named, folder = set(attributes) <= FIELDS.keys(), place.partition(",")[0]
    # A text may be longer than the name of a folder can be.
    known = named or place.startswith(("sphere:", "box:", "like:")) or (len(folder) < 256 and Path(folder).is_dir())
    whole = kind(word)
    plain = whole.style if isinstance(whole, Named) else whole
    if not at or (isinstance(plain, str) and not known) or (isinstance(plain, Path) and plain.exists()):
        return whole, None
    inner, before = _by_place(style, kind)
    controls = before if isinstance(before, Controls) else Controls(mask=before)
    if named:
        return inner, replace(controls, attributes=(*controls.attributes, *attributes))
    if controls.mask is not None:
        raise UserError(f"{word} names two places; give one mask")
    mask = _mask(place)
    return inner, replace(controls, mask=mask) if controls.attributes else mask


def _mask(word: str) -> Mask:
    from anystyle.pipeline.masks import parsed

    return parsed(word)


def _controls_of(arguments: argparse.Namespace) -> list[Controls]:
    """Every combination of the values of the flags."""
    numbers = (_numbers(flag, getattr(arguments, flag)) for flag in NUMBERS)
    return combinations(*numbers, mask=[_mask(word) for word in arguments.mask])


def _numbers(flag: str, words: Sequence[str]) -> list[float]:
    try:
        return [float(word) for word in ",".join(words).split(",")] if words else []
    except ValueError:
        raise UserError(f"--{flag.replace('_', '-')} takes numbers, not {','.join(words)!r}") from None


def _styles_as_args(styles: Sequence[StyleInput]) -> list[str]:
    words: list[str] = []
    mixed = [style for style in styles if isinstance(style, Mixture)]
    if mixed:
        first, second = mixed[0].first, mixed[0].second
        if len(mixed) < len(styles) or any((style.first, style.second) != (first, second) for style in mixed):
            raise UserError("mixtures of several pairs of styles have no command line")
        return [*_styles_as_args([first, second]), "--mix", ",".join(f"{style.amount:g}" for style in mixed)]
    for style in styles:
        match style:
            case Places(styles=parts):
                for part, place in parts:
                    plain, name = (part.style, ["--name", part.name]) if isinstance(part, Named) else (part, [])
                    *flag, word = _styles_as_args([plain])
                    words += [*flag, word + _place_as_text(place), *name]
            case Named(style=plain, name=name):
                words += [*_styles_as_args([plain]), "--name", name]
            case str() | Path():
                name, value = "--text" if isinstance(style, str) else "--image", str(style)
                words += [f"{name}={value}"] if value.startswith("-") else [name, value]
            case _:
                raise UserError("styles in memory have no command line; give their files")
    return words


def _place_as_text(place: Mask | Controls | None) -> str:
    controls = place if isinstance(place, Controls) else Controls(mask=place)
    mask = "" if controls.mask is None else f"@{controls.mask.text}"
    return mask + (f"@{'+'.join(controls.attributes)}" if controls.attributes else "")


def _controls_as_args(controls: Sequence[Controls]) -> list[str]:
    values = {name: list(dict.fromkeys(getattr(one, name) for one in controls)) for name in (*NUMBERS, "mask")}
    masks = [mask for mask in values.pop("mask") if mask is not None]
    if tuple(combinations(*values.values(), mask=masks)) != tuple(controls):
        raise UserError("controls that are not all combinations of their values have no command line")
    words: list[str] = []
    for name, numbers in values.items():
        if numbers != [getattr(Controls(), name)]:
            words += [f"--{name.replace('_', '-')}", ",".join(f"{value:g}" for value in numbers)]
    return [*words, *(word for mask in masks for word in ("--mask", mask.text))]


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
