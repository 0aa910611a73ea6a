"""Photographs and a style in, a stylized Gaussian scene out."""

import argparse
import contextlib
import functools
import re
import sys
import unicodedata
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from importlib.metadata import version
from pathlib import Path

import torch
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from torch import Tensor

from anystyle import known_cameras, memory
from anystyle.assemble import assemble
from anystyle.commands._compose import main, override, split
from anystyle.commands._progress import Stages
from anystyle.contracts import SceneSource, StyleSource
from anystyle.data.folder import SourceImage, read_views
from anystyle.data.images import read_image
from anystyle.errors import UserError
from anystyle.files import atomic_directory
from anystyle.geometry.alignment import Similarity
from anystyle.groups import Capture, encode_groups, with_cameras
from anystyle.paging import thrifty
from anystyle.refine import refine
from anystyle.registry.build import build
from anystyle.results import Path3D, render_each, write_cameras, write_colmap, write_report, write_scene, write_sheet
from anystyle.sheet import Cell, to_pil
from anystyle.stylizer import Stylizer
from anystyle.testing.check import ContractError
from anystyle.testing.comparing import conform
from anystyle.types import Attributes, Cameras, Gaussians, Geometry, Scene, StyleEmbedding, Views

LONGEST_TEXT = 2000


@dataclass(frozen=True)
class NamedStyle:
    """A style with what people see of it: a folder's name, a title, a cell of the sheet."""

    name: str
    title: str
    cell: Cell
    embedding: StyleEmbedding


POSES = ("predicted", "target", "known")
MODELS = ("none", "binary", "text")


@dataclass(frozen=True)
class Placed:
    """An encoded capture with the cameras that somebody knew.

    Args:
        capture: The capture; with known cameras in place of predicted ones where they were asked for.
        targets: Names and cameras of further views, where they were asked for.
        change: The way from the known cameras' frame to the capture's.
    """

    capture: Capture
    targets: tuple[Sequence[str], Cameras] | None = None
    change: Similarity | None = None


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle stylize``; every other word is a Hydra override."""
    flags = argparse.ArgumentParser(
        prog="anystyle stylize",
        description="Stylize photographs as a 3D Gaussian scene. Words such as key=value are Hydra overrides.",
        epilog="Every option of every component: anystyle stylize --cfg job",
        allow_abbrev=False,
    )
    flags.add_argument("inputs", nargs="*", help="a folder, files, a glob or a video; or none with scenes=NAME")
    flags.add_argument("--text", action="append", default=[], help="a style in words; may be given several times")
    flags.add_argument("--image", action="append", default=[], help="a style as an image file; likewise")
    flags.add_argument(
        "--mix",
        action="append",
        default=[],
        metavar="AMOUNT",
        help="with exactly two styles: the point between them, 0 is the first and 1 the second; likewise",
    )
    flags.add_argument("--out", default="out", help="where the results go (default: %(default)s)")
    return flags


def slug(text: str, limit: int = 40) -> str:
    """A text as part of a file name: lower-case ASCII words joined by hyphens."""
    plain = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode().lower()
    words = re.sub(r"[^a-z0-9]+", "-", plain).strip("-")
    return words[:limit].rstrip("-") or "style"


def check_arguments(arguments: argparse.Namespace, config: DictConfig) -> list[float]:
    """Judge the flags before any work; return the mixing amounts.

    Raises:
        ValueError: There is no style, an empty or endless text, or a mixture that cannot be made.
    """
    styles = len(arguments.text) + len(arguments.image) + len(config.style)
    if not styles:
        raise ValueError('no style is given; add --text "..." or --image FILE')
    for text in arguments.text:
        if not text.strip():
            raise ValueError("--text is empty; say what the result should look like")
        if len(text) > LONGEST_TEXT:
            raise ValueError(f"--text has {len(text)} characters; describe the style in at most {LONGEST_TEXT}")
    if not arguments.inputs and config.get("scenes") is None:
        raise ValueError("no photographs are given; name a folder, files or a video")
    for option, value, choices in (("poses", config.poses, POSES), ("export.colmap", config.export.colmap, MODELS)):
        if value not in choices:
            raise ValueError(f"{option}={value}; choose one of {', '.join(choices)}")
    if config.views.short_side is not None and not config.views.resize:
        raise ValueError(f"views.short_side={config.views.short_side} with views.resize=false; give one of them")
    amounts: list[float] = []
    for word in ",".join(arguments.mix).split(",") if arguments.mix else []:
        try:
            amount = float(word)
        except ValueError:
            raise ValueError(f"--mix takes numbers between 0 and 1, not {word!r}") from None
        if not 0 <= amount <= 1:
            raise ValueError(f"--mix takes numbers between 0 and 1, not {word}")
        amounts.append(amount)
    if amounts and styles != 2:
        raise ValueError(f"--mix needs exactly two styles, and {styles} are given; add or drop a --text or --image")
    return amounts


def read_inputs(
    arguments: argparse.Namespace, config: DictConfig, multiple: int, side: int
) -> tuple[Views, list[SourceImage]]:
    """The input views and where each came from: files, or a scene of a registered source."""
    if arguments.inputs:
        return read_views(
            [Path(word) for word in arguments.inputs],
            short_side=(config.views.short_side or side) if config.views.resize else None,
            multiple=multiple,
            max_views=config.views.take,
        )
    source = build(SceneSource, config.scenes)
    if not 0 <= config.scene < len(source):
        raise ValueError(f"scene={config.scene} does not exist; the source holds {len(source)}")
    views = source.read(config.scene, range(min(source.num_views(config.scene), config.views.take)))
    if any(length % multiple for length in views.size):
        raise ValueError(f"the scene's images are {views.size}; their sides must be multiples of {multiple}")
    names = [f"view_{place:02d}" for place in range(views.images.shape[1])]
    return views, [SourceImage.unchanged(name, views.size) for name in names]


def place_cameras(
    config: DictConfig, stylizer: Stylizer, capture: Capture, views: Views, sources: Sequence[SourceImage]
) -> Placed:
    """Use stored cameras as ``poses`` says."""
    if config.poses == "predicted":
        return Placed(capture)
    from_files = sources[0].path is not None
    where = None if config.poses_from is None else Path(config.poses_from)
    names = [source.name for source in sources]
    stored = views.cameras
    known = known_cameras.from_files(sources, where) if from_files else known_cameras.from_views(stored, names)
    if config.poses == "known":
        cameras = known.of_all(names).to(capture.cameras.intrinsics.device)
        capture, change = with_cameras(capture, cameras, stylizer.backbone)
        return Placed(capture, change=change)
    targets, change = known.placed(capture.cameras)
    return Placed(capture, (_unique([slug(name, 80) for name in known.names]), targets), change)


def encoder(config: DictConfig, stylizer: Stylizer) -> Callable[[Views], Scene]:
    """How views are encoded: in the single pass, or with cameras refined after it.

    What comes of it has the shapes that its types say: a plugin's mistake is told here, not by what trips over it.
    """

    def encode(views: Views) -> Scene:
        scene = stylizer.encode(views)
        batch, number, _, height, width = views.images.shape
        sizes = {"B": batch, "V": number, "H": height, "W": width}
        try:
            conform(scene.geometry, Geometry, "the backbone's `geometry_head`", **sizes)
            conform(scene.cameras, Cameras, "the backbone's `geometry_head`", **sizes)
            conform(scene.attributes, Attributes, "the backbone's `gaussian_head`", **sizes)
        except ContractError as error:
            raise ValueError(f"{error}; `anystyle plugins check backbone NAME` says all") from error
        return refine(scene, stylizer.backbone.adapter) if config.refine else scene

    return encode


def named_styles(arguments: argparse.Namespace, config: DictConfig, stylizer: Stylizer) -> list[NamedStyle]:
    """Embed every style asked for, in the order texts, images, styles of a registered source."""
    device = next(stylizer.parameters()).device
    styles: list[NamedStyle] = []
    for text in arguments.text:
        styles.append(NamedStyle(slug(text), f"“{' '.join(text.split())}”", None, stylizer.embed(text=text)))
    images: list[tuple[str, Tensor]] = [(Path(word).stem, read_image(Path(word))[None]) for word in arguments.image]
    if config.style:
        source = build(StyleSource, config.styles)
        for place in config.style:
            style = source.read(place)
            if style.image is None:
                raise ValueError(f"style={place} has no image")
            images.append((f"style {place}", style.image))
    for title, image in images:
        styles.append(NamedStyle(slug(title), title, to_pil(image[0]), stylizer.embed(image=image.to(device))))
    return styles


def mixed(styles: Sequence[NamedStyle], amounts: Sequence[float]) -> list[NamedStyle]:
    """The points between two styles."""
    first, second = styles
    return [
        NamedStyle(
            name=f"{slug(first.name, 24)}_{amount:.2f}_{slug(second.name, 24)}",
            title=f"{1 - amount:.0%} {first.title}, {amount:.0%} {second.title}",
            cell=first.cell if amount == 0 else second.cell if amount == 1 else None,
            embedding=first.embedding.toward(second.embedding, amount),
        )
        for amount in amounts
    ]


def checked(gaussians: Gaussians, what: str) -> Gaussians:
    """The Gaussians themselves, if all their numbers are finite: a scene of NaN is written like any other.

    Raises:
        ValueError: They are not.
    """
    for item in fields(gaussians):
        values: Tensor = getattr(gaussians, item.name)
        lost = values.numel() - int(values.isfinite().sum())
        if lost:
            raise ValueError(
                f"{lost} of {values.numel()} numbers of the {item.name} of {what} are NaN or infinite; expected finite "
                "ones. `anystyle plugins check backbone NAME` says where a backbone of your own makes them; trained "
                "weights may need precision=fp32"
            )
    return gaussians


def stylize(config: DictConfig, arguments: argparse.Namespace) -> None:
    """Run the command."""
    amounts = check_arguments(arguments, config)
    stages = Stages()
    target = job_folder(arguments.out)
    with atomic_directory(target) as out:
        torch.manual_seed(config.seed)
        with stages("load", "the model"):
            stylizer, weights = assemble(config)
            device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
            stylizer = stylizer.requires_grad_(False).eval().to(device)
            backbone = stylizer.backbone
            thrifty(stylizer.stages)
        with stages("read", "the views"):
            views, sources = read_inputs(arguments, config, backbone.patch_size, backbone.resolution)
            count, size = views.images.shape[1], config.views.max_views
            memory.check(backbone, min(count, size or count), views.size, device)
        with stages("encode", f"{count} views of {views.size[1]}x{views.size[0]}"):
            images = replace(views, cameras=None, depth=None).to(device)
            encoded = encode_groups(encoder(config, stylizer), images, size=size, overlap=config.views.overlap)
            placed = place_cameras(config, stylizer, encoded, views, sources)
            capture = placed.capture
        with stages("embed", "the styles"):
            styles = named_styles(arguments, config, stylizer)
            styles = mixed(styles, amounts) if amounts else styles
        photographs = [to_pil(image) for image in views.images[0]]
        names = _unique([slug(source.name, 80) for source in sources])
        path = Path3D(frames=config.video.frames, fps=config.video.fps, scale=config.video.scale)
        with stages("render", "the unstyled scene"):
            plain = checked(capture.gaussians(stylizer.unstyled), "the unstyled scene")
            unstyled = [to_pil(image) for image in render_each(stylizer, plain, capture.cameras)]
        columns: list[tuple[str, Cell, Sequence[Cell]]] = [("unstyled", None, unstyled)]
        report: dict[str, object] = {}
        for place, style in enumerate(styles):
            folder = out if len(styles) == 1 else out / f"{place + 1:02d}-{style.name}"
            with stages("restyle", f"{place + 1}/{len(styles)}: {' '.join(style.title.split())[:70]}"):
                gaussians = capture.gaussians(functools.partial(stylizer.restyle, embedding=style.embedding))
                gaussians = checked(gaussians, f"the scene in the style {style.title}")
            with stages("write", "scene, renders and video"):
                renders = write_scene(
                    folder,
                    stylizer,
                    gaussians,
                    capture.cameras,
                    names=names,
                    path=path,
                    targets=placed.targets,
                    y_up=config.export.y_up,
                )
                write_cameras(folder / "cameras.json", capture.cameras, sources, placed.change)
                if config.export.colmap != "none":
                    binary = config.export.colmap == "binary"
                    write_colmap(folder / "sparse" / "0", gaussians, capture.cameras, sources, binary=binary)
            column = (style.title, style.cell, renders)
            write_sheet(folder / "sheet.png", photographs, [columns[0], column])
            columns.append(column)
            report = {
                "style": style.title,
                "gaussians": int((gaussians.opacities > 0).sum()),
                "views": count,
                "groups": len(capture.groups),
                "inputs": [source.name for source in sources],
                "size": list(views.size),
                "seconds": {stage: round(seconds, 4) for stage, seconds in stages.seconds.items()},
                "weights": weights,
                "seed": config.seed,
                "config": OmegaConf.to_container(config, resolve=True, enum_to_str=True),
                "versions": {name: version(name) for name in ("anystyle", "torch", "numpy")},
            }
            write_report(folder / "report.json", report)
        if len(styles) > 1:
            write_sheet(out / "sheet.png", photographs, columns)
            write_report(out / "report.json", report | {"style": [style.title for style in styles]})
    made = f"{len(styles)} stylized scene{'s' if len(styles) > 1 else ''}"
    print(f"{made} in {target}; look at {target / 'sheet.png'}")


def job_folder(out: str) -> Path:
    """Where results go: ``--out``, and in a multirun a folder of each job's own in it."""
    if not HydraConfig.initialized() or HydraConfig.get().mode is not RunMode.MULTIRUN:
        return Path(out)
    return Path(HydraConfig.get().runtime.output_dir)


def with_sweep(words: Sequence[str]) -> list[str]:
    """The words, and for a multirun the word that makes it write into ``--out``."""
    with contextlib.suppress(UserError):  # told where the words are read for good
        arguments, rest = split(parser(), words)
        if {"-m", "--multirun"} & set(rest):
            return [*words, override("hydra.sweep.dir", arguments.out)]
    return list(words)


def _unique(names: Sequence[str]) -> list[str]:
    """Names with a number added where one would be used twice."""
    seen: dict[str, int] = {}
    result: list[str] = []
    for name in names:
        seen[name] = seen.get(name, 0) + 1
        result.append(name if seen[name] == 1 else f"{name}-{seen[name]}")
    return result


if __name__ == "__main__":
    main("stylize", stylize, parser(), with_sweep(sys.argv[1:]))
