"""Photographs and a style in, a stylized Gaussian scene out."""

import argparse
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import torch
from omegaconf import DictConfig

from anystyle.cli.arguments import new_parser
from anystyle.cli.launch import checked_seed, job_folder, main, with_sweep
from anystyle.cli.run import show
from anystyle.contracts import Reconstruction, StyleSource
from anystyle.errors import UserError
from anystyle.io.sheet import to_pil
from anystyle.pipeline.controls import FIELDS, Controls, Mask, combinations
from anystyle.pipeline.load import make_scenes
from anystyle.pipeline.options import PoseOptions, ViewOptions
from anystyle.pipeline.provenance import without_folders
from anystyle.pipeline.stages import Stages
from anystyle.pipeline.styles import Mixture, Places, StyleInput, check_text
from anystyle.pipeline.stylize import stylize
from anystyle.registry.build import build
from anystyle.registry.catalog import catalog
from anystyle.registry.compose import options
from anystyle.types import Progress, Style, Views


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle stylize``; every other word is a Hydra override."""
    flags = new_parser(
        "stylize",
        "Stylize photographs as a 3D Gaussian scene. Words such as key=value are Hydra overrides.",
        epilog="Every option of every component: anystyle stylize --cfg job",
    )
    flags.add_argument(
        "inputs",
        nargs="*",
        help="a folder, files, a glob or a video; a PLY file or a folder of results; or none with scenes=NAME",
    )
    flags.add_argument("--text", action="append", default=[], help="a style in words; may be given several times")
    flags.add_argument(
        "--image",
        action="append",
        default=[],
        help="a style as an image file; likewise. STYLE@MASK is a style in one place of the scene, see --mask, and "
        "STYLE@color+rotation one of some attributes of opacity, scale, rotation, color; several make one scene",
    )
    flags.add_argument(
        "--mix",
        action="append",
        default=[],
        metavar="AMOUNT",
        help="with exactly two styles: the point between them, 0 is the first and 1 the second; likewise",
    )
    add_controls(flags)
    flags.add_argument(
        "--photo-masks",
        metavar="DIR",
        help="images named as the photographs; what is black in them, such as people or the sky, is not learnt. "
        "views.masked=empty: nothing is there",
    )
    flags.add_argument(
        "--export",
        default="",
        metavar="FORMATS",
        help="further files of the scene, by the names of `anystyle plugins format`; several with commas",
    )
    flags.add_argument(
        "--no-provenance", action="store_true", help="files say nothing of photographs, styles and networks"
    )
    flags.add_argument("--out", default="out", help="where the results go (default: %(default)s)")
    flags.add_argument("--open", action="store_true", help="look at them in the browser, where there is a display")
    return flags


def command(config: DictConfig, arguments: argparse.Namespace) -> None:
    """Run the command."""
    amounts = mixing_amounts(arguments, len(arguments.text) + len(arguments.image) + len(config.style))
    for text in arguments.text:
        check_text(text, "--text")
    if not arguments.inputs and config.get("scenes") is None:
        raise UserError("no photographs are given; name a folder, files or a video")
    if arguments.export:
        config.export.formats = [*config.export.formats, *arguments.export.split(",")]
    config.export.provenance &= not arguments.no_provenance
    config.views.masks = arguments.photo_masks or config.views.masks
    views, export = options(config, "views"), options(config, "export")
    poses = PoseOptions(config.poses, config.poses_from)
    target = job_folder(arguments.out)
    torch.manual_seed(checked_seed(config.seed))
    with ExitStack() as cleanup:
        stages = Stages(reporter(target.with_name(f"{target.name}.progress.png"), cleanup))
        results = stylize(
            arguments.inputs or scene_views(config, views),
            given_styles(arguments, config, amounts),
            model=config,
            views=views,
            poses=poses,
            splat=options(config, "splat"),
            controls=given_controls(arguments),
            out=target,
            export=export,
            video=config.video,
            provenance={"seed": config.seed, "config": without_folders(config)},
            stages=stages,
        )
    scenes = f"{len(results)} stylized scene{'s' if len(results) > 1 else ''}"
    # Of the files of all styles, one that nothing reads back is a page to look at.
    formats = [(name, catalog().find("format", name).load()) for name in export.formats]
    pages = [target / f"scene.{name}" for name, kind in formats if kind.many_styles and not kind.reads]
    page = next((path for path in pages if path.is_file()), target / "sheet.png")
    took = f"{sum(stages.seconds.values()):.0f} s, {stages.write_share:.0%} of them for files"
    print(f"{scenes} in {target} in {took}; look at {page}")
    if arguments.open:
        show(page.resolve().as_uri())


def reporter(thumbnail: Path, cleanup: ExitStack) -> Callable[[str, Progress], None]:
    """Prints stages to the standard error stream, and keeps the latest thumbnail in a file until ``cleanup``."""
    cleanup.callback(thumbnail.unlink, missing_ok=True)

    def report(stage: str, progress: Progress) -> None:
        print(f"{stage} {progress.line} …", file=sys.stderr, flush=True)
        if progress.thumbnail is not None:
            to_pil(progress.thumbnail).save(thumbnail)

    return report


def mixing_amounts(arguments: argparse.Namespace, num_styles: int) -> list[float]:
    """The amounts of ``--mix``."""
    if not num_styles:
        raise UserError('no style is given; add --text "..." or --image FILE')
    amounts = _numbers("mix", arguments.mix)
    if not all(0 <= amount <= 1 for amount in amounts):
        raise UserError(f"--mix takes numbers between 0 and 1, not {','.join(arguments.mix)}")
    if amounts and num_styles != 2:
        raise UserError(f"--mix needs exactly two styles, and {num_styles} are given; add or drop a --text or --image")
    return amounts


def scene_views(config: DictConfig, options: ViewOptions) -> Views:
    """The first views of a scene of the configured source."""
    source = make_scenes(config)
    if not 0 <= config.scene < len(source):
        raise UserError(f"scene={config.scene} does not exist; the source holds {len(source)}")
    number = min(source.num_views(config.scene), options.take or Reconstruction.max_views)
    return source.read(config.scene, range(number))


def given_styles(arguments: argparse.Namespace, config: DictConfig, amounts: Sequence[float]) -> list[StyleInput]:
    """Every style asked for, in the order texts, image files, styles of the configured source; or their mixtures.

    Styles one of which has a place are one style, :class:`Places`.
    """
    given = [*(_by_place(word, str) for word in arguments.text), *(_by_place(word, Path) for word in arguments.image)]
    styles = [style for style, _ in given]
    if config.style:
        source = build(StyleSource, config.styles)
        for index in config.style:
            image = source.read(index).image
            if image is None:
                raise UserError(f"style={index} has no image")
            styles.append(Style(image=image, names=(f"style {index}",)))
    if any(mask for _, mask in given):
        if amounts:
            raise UserError("--mix applies two styles to the whole scene; leave out --mix, or the @... of the styles")
        given += [(style, None) for style in styles[len(given) :]]
        return [Places(tuple(sorted(given, key=lambda one: one[1] is not None)))]
    if not amounts:
        return styles
    first, second = styles
    return [Mixture(first, second, amount) for amount in amounts]


def _by_place(word: str, kind: Callable[[str], StyleInput]) -> tuple[StyleInput, Mask | Controls | None]:
    """A style, and the mask or the attributes behind its last ``@``, or both, if there are any."""
    style, at, place = word.rpartition("@")
    attributes = tuple(place.split("+"))
    named = set(attributes) <= FIELDS.keys()
    known = named or place.startswith(("sphere:", "box:")) or Path(place.partition(",")[0]).is_dir()
    if not at or (kind is str and not known) or (kind is Path and Path(word).exists()):
        return kind(word), None
    inner, before = _by_place(style, kind)
    controls = before if isinstance(before, Controls) else Controls(mask=before)
    if named:
        return inner, replace(controls, attributes=(*controls.attributes, *attributes))
    if controls.mask is not None:
        raise UserError(f"{word} names two places; give one mask")
    from anystyle.pipeline.masks import parsed

    return inner, replace(controls, mask=parsed(place)) if controls.attributes else parsed(place)


def add_controls(parser: argparse.ArgumentParser) -> None:
    """Add the flags of controls; each takes several values, and every combination is a result."""
    group = parser.add_argument_group("how a style is applied; several values make a strip")
    group.add_argument("--strength", action="append", default=[], metavar="0..1", help="0 is the unstyled scene")
    group.add_argument("--preserve-color", action="append", default=[], metavar="0..1", help="keep the scene's hues")
    group.add_argument("--scale", action="append", default=[], metavar="FACTOR", help="size of strokes")
    group.add_argument(
        "--mask",
        action="append",
        default=[],
        metavar="WHERE",
        help="where style enters: a folder of masks, sphere:X,Y,Z,RADIUS, box:X,Y,Z,X,Y,Z, "
        "like:X,Y,Z,RADIUS,TOLERANCE; ,soft=WIDTH after it",
    )


def given_controls(arguments: argparse.Namespace) -> list[Controls]:
    """Every combination of the values of the flags."""
    masks: list[Mask] = []
    if arguments.mask:
        from anystyle.pipeline.masks import parsed

        masks = [parsed(word) for word in arguments.mask]
    numbers = (_numbers(flag, getattr(arguments, flag)) for flag in ("strength", "preserve_color", "scale"))
    return combinations(*numbers, mask=masks)


def _numbers(flag: str, words: Sequence[str]) -> list[float]:
    values = ",".join(words).split(",") if words else []
    try:
        return [float(word) for word in values]
    except ValueError:
        raise UserError(f"--{flag.replace('_', '-')} takes numbers, not {','.join(values)!r}") from None


if __name__ == "__main__":
    main("stylize", command, parser(), with_sweep(parser(), sys.argv[1:]))
