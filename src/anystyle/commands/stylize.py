"""Photographs and a style in, a stylized Gaussian scene out."""

import argparse
import contextlib
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch
from omegaconf import DictConfig, OmegaConf

from anystyle import api
from anystyle.commands._compose import job_folder, main, with_sweep
from anystyle.commands._flags import new_parser
from anystyle.commands._options import Stylize, checked
from anystyle.contracts import SceneSource, StyleSource
from anystyle.inference import memory
from anystyle.inference.assemble import assemble_frozen, default_device, default_poses, make_method
from anystyle.inference.controls import Controls, combinations
from anystyle.inference.masks import parsed
from anystyle.inference.options import PoseOptions, ViewOptions
from anystyle.inference.stages import Stages
from anystyle.inference.styles import Mixture, StyleInput, check_text
from anystyle.io.atomic import atomic_directory
from anystyle.io.sheet import to_pil
from anystyle.reconstructions.contract import Reconstruction
from anystyle.registry.build import build
from anystyle.stylizer import Stylizer
from anystyle.types import Style, Views


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
    flags.add_argument("--image", action="append", default=[], help="a style as an image file; likewise")
    flags.add_argument(
        "--mix",
        action="append",
        default=[],
        metavar="AMOUNT",
        help="with exactly two styles: the point between them, 0 is the first and 1 the second; likewise",
    )
    add_controls(flags)
    flags.add_argument(
        "--export",
        default="",
        metavar="FORMATS",
        help="further files of the scene: glb, spz, sog, splat, html; several with commas",
    )
    flags.add_argument("--out", default="out", help="where the results go (default: %(default)s)")
    return flags


def stylize(config: DictConfig, arguments: argparse.Namespace) -> None:
    """Run the command."""
    options = checked(config, Stylize)
    amounts = mixing_amounts(arguments, len(arguments.text) + len(arguments.image) + len(config.style))
    controls = given_controls(arguments)
    for text in arguments.text:
        check_text(text, "--text")
    if not arguments.inputs and config.get("scenes") is None:
        raise ValueError("no photographs are given; name a folder, files or a video")
    views, export, video = options.views, options.export, options.video
    if arguments.export:
        export = replace(export, formats=[*export.formats, *arguments.export.split(",")])
    poses = PoseOptions(config.poses or default_poses(config), config.poses_from)
    reconstruction = None if config.get("reconstruction") is None else build(Reconstruction, config.reconstruction)
    target = job_folder(arguments.out)
    watched = target.with_name(f"{target.name}.progress.png")
    stages = Stages(
        lambda name, note: print(f"{name} {note} …", file=sys.stderr, flush=True),
        lambda thumbnail: to_pil(thumbnail).save(watched),
    )
    with contextlib.ExitStack() as cleanup, atomic_directory(target, expected_entries(options)) as folder:
        cleanup.callback(watched.unlink, missing_ok=True)
        torch.manual_seed(config.seed)
        with stages("load", "the model"):
            stylizer, weights = assemble_frozen(config)
            stylizer = stylizer.to(default_device())
        inputs = arguments.inputs
        if not inputs:
            with stages("read", "the views"):
                inputs = scene_views(config, views, stylizer, reconstruction)
        results = api.stylize(
            inputs,
            given_styles(arguments, config, amounts),
            model=stylizer,
            views=views,
            poses=poses,
            splat=options.splat,
            reconstruction=reconstruction,
            method=make_method(config, stylizer.style_encoder),
            refine=config.refine,
            controls=controls,
            export=export,
            video=video,
            provenance={
                "weights": weights,
                "seed": config.seed,
                "config": OmegaConf.to_container(config, resolve=True, enum_to_str=True),
            },
            stages=stages,
        )
        results.write(folder)
    scenes = f"{len(results)} stylized scene{'s' if len(results) > 1 else ''}"
    print(f"{scenes} in {target}; look at {target / 'sheet.png'}")


def mixing_amounts(arguments: argparse.Namespace, num_styles: int) -> list[float]:
    """The amounts of ``--mix``.

    Raises:
        ValueError: There is no style, an amount is no number in [0, 1], or there are not exactly two styles to mix.
    """
    if not num_styles:
        raise ValueError('no style is given; add --text "..." or --image FILE')
    amounts: list[float] = []
    for word in ",".join(arguments.mix).split(",") if arguments.mix else []:
        try:
            amount = float(word)
        except ValueError:
            raise ValueError(f"--mix takes numbers between 0 and 1, not {word!r}") from None
        if not 0 <= amount <= 1:
            raise ValueError(f"--mix takes numbers between 0 and 1, not {word}")
        amounts.append(amount)
    if amounts and num_styles != 2:
        raise ValueError(f"--mix needs exactly two styles, and {num_styles} are given; add or drop a --text or --image")
    return amounts


def expected_entries(options: Stylize) -> list[str]:
    """Folders that a result has and a capture may have too; where one is in the way, that is said before any work."""
    return ["renders", *(["sparse"] if options.export.colmap != "none" else [])]


def scene_views(
    config: DictConfig, options: ViewOptions, stylizer: Stylizer, reconstruction: Reconstruction | None
) -> Views:
    """The first views of a scene of the configured source.

    Raises:
        ValueError: The source has no such scene, or memory does not suffice for so many of its views.
    """
    source = build(SceneSource, config.scenes)
    if not 0 <= config.scene < len(source):
        raise ValueError(f"scene={config.scene} does not exist; the source holds {len(source)}")
    count = min(source.num_views(config.scene), options.take)
    if reconstruction is None or not reconstruction.needs_cameras:
        size = source.read(config.scene, [0]).size  # of one it is known what all of them take
        memory.check(stylizer.backbone, min(count, options.max_views or count), size, stylizer.device)
    return source.read(config.scene, range(count))


def given_styles(arguments: argparse.Namespace, config: DictConfig, amounts: Sequence[float]) -> list[StyleInput]:
    """Every style asked for, in the order texts, image files, styles of the configured source; or their mixtures.

    Raises:
        ValueError: A style of the source has no image.
    """
    styles: list[StyleInput] = [*arguments.text, *map(Path, arguments.image)]
    if config.style:
        source = build(StyleSource, config.styles)
        for index in config.style:
            image = source.read(index).image
            if image is None:
                raise ValueError(f"style={index} has no image")
            styles.append(Style(image=image, names=(f"style {index}",)))
    if not amounts:
        return styles
    first, second = styles
    return [Mixture(first, second, amount) for amount in amounts]


def add_controls(parser: argparse.ArgumentParser) -> None:
    """Add them; each takes several values, and every combination is a result."""
    group = parser.add_argument_group("how a style is applied; several values make a strip")
    group.add_argument("--strength", action="append", default=[], metavar="0..1", help="0 is the unstyled scene")
    group.add_argument(
        "--preserve-color", action="append", default=[], metavar="0..1", help="keep the scene's hues; alone it means 1"
    )
    group.add_argument("--scale", action="append", default=[], metavar="FACTOR", help="size of strokes of --image")
    group.add_argument(
        "--mask",
        action="append",
        default=[],
        metavar="WHERE",
        help="where style enters: a folder of masks, sphere:X,Y,Z,RADIUS or box:X,Y,Z,X,Y,Z; ,soft=WIDTH behind it",
    )


def with_values(words: Sequence[str]) -> list[str]:
    """The words, and the value that ``--preserve-color`` alone stands for."""
    return ["--preserve-color=1" if _alone(words, index) else word for index, word in enumerate(words)]


def _alone(words: Sequence[str], index: int) -> bool:
    if words[index] != "--preserve-color" or "--" in words[:index]:
        return False
    following = words[index + 1] if index + 1 < len(words) else ""
    return not all(_is_number(word) for word in following.split(","))


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def given_controls(arguments: argparse.Namespace) -> list[Controls]:
    """Every combination of the values of the flags.

    Raises:
        ValueError: A value is no number, out of its range, or no mask.
    """
    return combinations(
        *(_numbers(flag, getattr(arguments, flag)) for flag in ("strength", "preserve_color", "scale")),
        mask=[parsed(word) for word in arguments.mask],
    )


def _numbers(flag: str, words: Sequence[str]) -> list[float]:
    values = ",".join(words).split(",") if words else []
    for word in values:
        if not _is_number(word):
            raise ValueError(f"--{flag.replace('_', '-')} takes numbers, not {word!r}")
    return [float(word) for word in values]


if __name__ == "__main__":
    main("stylize", stylize, parser(), with_sweep(parser(), with_values(sys.argv[1:])))
