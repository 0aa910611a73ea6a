"""Photographs from folders, files, patterns and videos as one set of views."""

import filecmp
import glob
import logging
import re
from collections import Counter
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from itertools import chain
from math import sqrt
from pathlib import Path
from typing import NamedTuple, NoReturn, TypeVar

import torch
from PIL import Image

from anystyle.data import images
from anystyle.errors import UserError, listing
from anystyle.examples import resolved
from anystyle.io import color, video
from anystyle.io.images import Picture
from anystyle.io.limits import require
from anystyle.paths import folders_in, natural, short_names, text_of
from anystyle.types import Cameras, Original, SourceImage, Views
from anystyle.types.views import SHOWN

MAX_ASPECT = 3.0
"""Longer panoramas lose their ends."""

MAP = re.compile(
    r"albedo|conf(idence)?|depth(map)?s?|disp(arity)?|instances?|masks?|matte|normals?|segm?(entation)?|semantics?|thumbs?"
)
"""Words in the name of an image that is a map of the photograph with the rest of the name."""

OTHER = re.compile(rf"@eadir|__macosx|thumbnails|(.*[\W\d_])?({MAP.pattern})([\W\d_].*)?", re.IGNORECASE)
"""Names of folders beside photographs whose images are not photographs."""

_COPY = r"(copy|kopie|copie|copia|副本|コピー)"
COPY = re.compile(
    rf"^{_COPY} (of|von|de|di) |[\s_の-]+(\((\w+ )?)?{_COPY}[\W\d]*$|(\s?\(\d+\)|[ ~]\d+)$", re.IGNORECASE
)
"""What systems add to the name of a copied file: ``a (1)``, ``a - Copy``, ``a copy 2``, ``Copy of a``, ``a 2``."""

COLOURS = frozenset(["color", "colour", "frame", "image", "img", "photo", "rgb"])
"""Words by which the photograph is told from its maps."""

RAW = frozenset([".arw", ".cr2", ".cr3", ".dng", ".nef", ".orf", ".pef", ".raf", ".raw", ".rw2", ".srw", ".x3f"])
"""Suffixes of photographs that are not developed."""

PIXELS = 160_000_000
"""Of all originals together: half a gigabyte, held twice while cameras are sought."""

_Read = TypeVar("_Read")
_log = logging.getLogger(__name__)


def read_views(
    inputs: Sequence[Path], *, short_side: int | None, multiple: int, max_views: int, enlarge: bool = True
) -> tuple[Views, list[SourceImage]]:
    """Read photographs as views of one size.

    The size has the aspect that most photographs have, ``short_side`` as its shorter side, and sides that are
    multiples of ``multiple``. Each photograph is scaled to cover it, and what sticks out is cut off evenly: a few
    pixels where all have one aspect, more of those that differ. An unreadable photograph among others is left out,
    with a warning in the log.

    Args:
        inputs: Folders (their images in natural order), image files, patterns such as ``photos/*.jpg``, or videos.
        short_side: In pixels; rounded to a multiple. ``None`` does not resize: all photographs must
            have one size of such multiples.
        multiple: The patch size of the network.
        max_views: How many views are read at most; of more photographs evenly spaced ones are.
        enlarge: Whether smaller photographs are enlarged to ``short_side``.
    """
    shots, problems = _shots(inputs, max_views)
    size = common_size([shot.size for shot in shots], short_side=short_side, multiple=multiple, enlarge=enlarge)
    require_views(len(shots), size)

    def covered(name: str, shot: _Shot) -> tuple[Image.Image, SourceImage]:
        return read_picture(shot.path, name, size) if shot.frame is None else cover(name, shot.frame, shot.size, size)

    pictures = _each(shots, problems, covered)
    sources = [source for _, source in pictures]
    tell_of_cut(sources)
    return as_views(pictures), sources


def require_views(count: int, size: tuple[int, int]) -> None:
    """Refuse views that memory does not hold, before a pixel of them is decoded."""
    # As bytes, as floating-point numbers, and stacked.
    bytes_needed, what = count * size[0] * size[1] * 3 * (1 + 4 + 4), f"{count} views of {size[1]}x{size[0]}"
    require(
        bytes_needed, what, "take fewer (views.take), or smaller ones (views.short_side, or short_side of the scenes)"
    )


def as_views(pictures: Sequence[tuple[Image.Image, SourceImage]], cameras: Cameras | None = None) -> Views:
    """Pictures of one size, with the sources that name them, as views of one scene."""
    stacked = torch.stack([images.to_tensor(picture) for picture, _ in pictures])[None]
    return Views(stacked, cameras, names=tuple(source.name for _, source in pictures))


_ASPECT = "%d of %d photographs have another aspect than most, as upright ones among wide ones; %s: %s"


def tell_of_cut(sources: Sequence[SourceImage]) -> None:
    """Log warnings that name photographs of which less than :data:`SHOWN` is in their view, or that do not fill it."""
    shown = {source.name: _shown(source) for source in sources}
    if whole := [source.name for source in sources if source.inside != (0, 0, *source.view_size[::-1])]:
        _log.warning(_ASPECT, len(whole), len(shown), "they are kept whole, at fewer pixels", listing(whole))
    if cut := [name for name, share in shown.items() if share < SHOWN]:
        told = f"their middles are used, {100 * min(shown.values()):.0f}% of them"
        _log.warning(_ASPECT, len(cut), len(shown), told, listing(cut))


def _shown(source: SourceImage) -> float:
    left, top, right, bottom = source.box
    return (right - left) * (bottom - top) / (source.size[0] * source.size[1])


def read_originals(
    inputs: Sequence[Path], *, longest: int, max_views: int, panorama: int | None = None
) -> list[Original]:
    """Read photographs as :func:`read_views` does, but whole, reduced to no less than the longer side ``longest``.

    Panoramas are read, too, at twice as much. Many are reduced more, to :data:`PIXELS` together.
    """
    shots, problems = _shots(inputs, max_views, panoramas=True)
    limit = round(sqrt(1.5 * PIXELS / len(shots)))
    films = {path: video.read_exif(path) for path in {shot.path for shot in shots if shot.frame is not None}}

    def original(name: str, shot: _Shot) -> Original:
        size = (shot.size[1], shot.size[0])
        # A view that is cut from a panorama has a third of its width.
        most = min(longest * (2 if size[1] == 2 * size[0] else 1), limit)
        if shot.frame is not None:
            frame = shot.frame.reduce(max(1, size[1] // most)) if size[1] == 2 * size[0] else shot.frame
            return Original(name, None, size, frame, films[shot.path], panorama=panorama)
        picture, alpha = images.open_image(shot.path, longest=most), images.open_alpha(shot.path, longest=most)
        return Original(name, shot.path, size, picture, images.read_exif(shot.path), alpha, panorama)

    return _each(shots, problems, original)


def read_picture(
    source: Picture, name: str, size: tuple[int, int], straighten: Callable[[Image.Image], Image.Image] | None = None
) -> tuple[Image.Image, SourceImage]:
    """An image file, or the bytes of one, scaled to cover a view of ``size``, height and width, and cut evenly.

    ``straighten`` removes the distortion of its lens.
    """
    path = source if isinstance(source, Path) else None
    described = name if path is None else str(path)
    whole = images.image_size(source, described)
    scale = min(whole[0] / size[1], whole[1] / size[0])
    # Decoded at twice the size that is needed where the format can, which leaves the resampling its room.
    picture = images.open_image(source, described, longest=max(1, round(2 * max(whole) / max(scale, 1.0))))
    covered, shown = cover(name, picture if straighten is None else straighten(picture), whole, size)
    return covered, replace(shown, path=path, straightened=straighten)


def image_files(folder: Path) -> list[Path]:
    """The image files of a folder, in natural order of their names; without hidden ones and :func:`map_files`."""
    files = visible(folder, images.SUFFIXES)
    maps = set(map_files(files))
    return [file for file in files if file not in maps]


def map_files(files: Sequence[Path]) -> list[Path]:
    """The images among those of a folder that are no photographs of their own, by their names.

    Depth, normals and masks are named as a photograph there and by a MAP, masks of COLMAP by the whole of its name.
    Of copies in several formats, which differ in their suffix alone, one counts, that in JPEG if there is one. A file
    of the same format, or one that is named as a COPY of another, is a copy where it has the same pixels.
    """
    words = {file: _words(file) for file in files}
    photographs = {each for each in words.values() if not any(map(MAP.fullmatch, each))}

    def rests(file: Path) -> set[tuple[str, ...]]:
        own = words[file]
        at = next((index for index, word in enumerate(own) if MAP.fullmatch(word)), len(own))
        # Blender numbers what it renders once more: r_0_depth_0001.png beside r_0.png.
        return {own[:at] + own[at + 1 :], own[:at]} - {own}

    names = {file.name for file in files}
    chosen = {file.stem: file for file in sorted(files, key=lambda file: file.suffix.lower() in (".jpg", ".jpeg"))}

    formats = Image.registered_extensions()

    def is_copy(file: Path) -> bool:
        one, original = chosen[file.stem], chosen.get(COPY.sub("", file.stem), file)
        in_other = formats.get(one.suffix.lower()) != formats.get(file.suffix.lower())
        return in_other or any(each != file and _alike(file, each) for each in (one, original))

    return [file for file in files if photographs & rests(file) or file.stem in names or is_copy(file)]


def _alike(one: Path, other: Path) -> bool:
    """Whether two images have the same bytes, or else the same pixels."""
    if filecmp.cmp(one, other, shallow=False):
        return True
    try:
        sizes = images.image_size(one) == images.image_size(other)
        return sizes and images.open_image(one).tobytes() == images.open_image(other).tobytes()
    except ValueError:
        return False


def _words(path: Path) -> tuple[str, ...]:
    """The words and numbers of a name, without COLOURS: those of ``Image0001.png`` are those of ``frame_0001.png``."""
    words = re.split(r"[\W_]+|(?<=[a-z\d])(?=[A-Z])|(?<=[^\W\d_])(?=\d)", path.stem)
    return tuple(word.lower() for word in words if word and word.lower() not in COLOURS)


def visible(folder: Path, suffixes: Collection[str]) -> list[Path]:
    """Files of a folder by their suffixes; ``._NAME`` of a Mac and other hidden ones are none."""
    files = [path for path in folder.glob("[!.]*") if path.suffix.lower() in suffixes and path.is_file()]
    return sorted(files, key=lambda path: natural(path.name))


def nested_image_files(folder: Path, depth: int = 3) -> list[Path]:
    """The image files of a folder, or where it has none, those of the folders in it, such as a rig's ``cam0``."""
    files = image_files(folder) if folder.is_dir() else []
    inside = folders_of_photographs(folder) if depth and not files else ()
    return files or [file for each in inside for file in nested_image_files(each, depth - 1)]


def folders_of_photographs(folder: Path) -> list[Path]:
    """The folders in a folder that may hold photographs; of reduced copies the largest."""
    inside = [path for path in folders_in(folder) if not OTHER.fullmatch(path.name)]
    copies = [path for path in inside if re.fullmatch(r"images_\d+", path.name)]
    return [path for path in inside if path not in copies[1:]]


def _named_as_maps(folder: Path) -> list[Path]:
    """The folders in a folder whose names are those of maps, but may be of photographs: ``normal``, ``conf_room``."""
    return [path for path in sorted(folder.glob("[!.]*")) if path.is_dir() and OTHER.fullmatch(path.name)]


def common_size(
    sizes: Sequence[tuple[int, int]], *, short_side: int | None, multiple: int, enlarge: bool = True
) -> tuple[int, int]:
    """Height and width that most photographs fit, from their widths and heights, maybe without enlarging them.

    Without ``short_side`` it is the size that all have.
    """
    if short_side is None:
        (width, height), *others = sorted(set(sizes))
        if others:
            shown = ", ".join(f"{width}x{height}" for width, height in sorted(set(sizes))[:5])
            told = f"the photographs have {1 + len(others)} sizes ({shown}); views.resize=true brings them to one"
            raise UserError(told)
        if width % multiple or height % multiple:
            told = f"the photographs are {width}x{height} pixels, and sides must be multiples of {multiple}"
            raise UserError(f"{told}: views.resize=true brings them to such a size")
        return height, width
    # The larger of two equally frequent sizes, independent of their order.
    (width, height), _ = max(Counter(sizes).items(), key=lambda size: (size[1], size[0]))
    aspect = min(max(width / height, 1 / MAX_ASPECT), MAX_ASPECT)
    short_side = short_side if enlarge else min(short_side, width, height)
    short = max(multiple, round(short_side / multiple) * multiple)
    long = max(short, round(short * max(aspect, 1 / aspect) / multiple) * multiple)
    return (short, long) if aspect >= 1 else (long, short)


def files_of(item: Path) -> list[Path]:
    """The files that a folder, a pattern or the name of an example stands for, or the file itself."""
    item = resolved(item)
    if item.is_dir():
        # Captures with cameras keep their photographs in a folder of that name.
        direct = (image_files(folder) for folder in (item, item / "images") if folder.is_dir())
        nested = (nested_image_files(folder) for folder in (item / "images", item, *_named_as_maps(item)))
        found = next(filter(None, chain(direct, nested)), [])
        thumbnail = len(found) == 1 and any(film.stem == found[0].stem for film in visible(item, video.SUFFIXES))
        return found if found and not thumbnail else _film_of(item)
    if item.is_file():
        return [item]
    found = map(Path, glob.glob(str(item)))  # noqa: PTH207  (a pattern may be absolute)
    matches = [path for path in found if path.suffix.lower() in images.SUFFIXES | video.SUFFIXES]
    if not matches:
        raise UserError(f"there is no folder, image or video {item}")
    return sorted(matches, key=lambda path: natural(str(path)))


def _film_of(folder: Path) -> list[Path]:
    """The film of a folder without images, or what to do about what is there."""
    films, raw = visible(folder, video.SUFFIXES), visible(folder, RAW)
    if len(films) == 1:
        return films
    if films:
        raise UserError(f"there are {len(films)} films in the folder {folder}; name one: {listing(films)}")
    if raw:
        raise UserError(f"the {len(raw)} photographs in {folder} are not developed ({_kinds(raw)}); {_DEVELOP}")
    others = _kinds([path for path in folder.glob("[!.]*") if path.suffix and path.is_file()])
    held = f"; its files are {others} (a scene is named by its file)" if others else ""
    raise UserError(f"there are no images in the folder {folder}{held}")


_DEVELOP = "save them as JPEG or TIFF with the program of the camera"


def _kinds(files: Sequence[Path]) -> str:
    return ", ".join(sorted({file.suffix[1:].upper() for file in files}))


class _Shot(NamedTuple):
    """A photograph that is still to be decoded, or a frame of a video; its size is (width, height)."""

    path: Path
    name: str
    size: tuple[int, int]
    frame: Image.Image | None = None


def _shots(inputs: Sequence[Path], max_views: int, *, panoramas: bool = False) -> tuple[list[_Shot], list[str]]:
    """The headers of photographs and the frames of videos, and what is wrong with the others."""
    found = [path for item in inputs for path in files_of(item)]
    paths, last = found, len(found) - 1
    if len(found) > max_views:
        paths = [found[round(index * last / max(max_views - 1, 1))] for index in range(max_views)]
        _log.warning("%d of %d photographs are taken, evenly spaced; views.take sets how many", max_views, len(found))
    for item in filter(Path.is_dir, map(resolved, inputs)):
        folders = list(dict.fromkeys(path.parent for path in found if item in path.parents))
        _tell_folders(item, folders)
        for folder in folders:
            _tell_left_out(folder)
    shots: list[_Shot] = []
    problems: list[str] = []
    frames_each = max(1, max_views // max(1, sum(path.suffix.lower() in video.SUFFIXES for path in paths)))
    for path in paths:
        try:
            if path.suffix.lower() in video.SUFFIXES:
                for number, frame in video.read_frames(path, frames_each):
                    shots.append(_Shot(path, f"{text_of(path.stem)}_{number:06d}", frame.size, frame))
            else:
                shots.append(_Shot(path, text_of(path.stem), images.photograph_size(path, panoramas=panoramas)))
        except ValueError as error:
            problems.append(str(error))
    if bright := [shot.path.name for shot in shots if not shot.frame and images.hdr_codes(shot.path)]:
        _log.warning("photographs of high dynamic range (PQ or HLG) are %s: %s", color.CLIPPED, listing(bright, 3))
    if not panoramas and shots and all(width == 2 * height for _, _, (width, height), _ in shots):
        told = "poses=sfm views.panorama=6 cuts them"
        _log.warning("all photographs are twice as wide as high, as 360° cameras take them; %s", told)
    return shots or _nothing(problems), problems


def _tell_folders(item: Path, folders: Sequence[Path]) -> None:
    """Say which folders in a given one are read as photographs, or are not."""
    stems = {file.stem for folder in folders for file in image_files(folder)}
    for each in _named_as_maps(item):
        if each in folders:
            _log.warning("%s is named as maps of photographs are, and read as photographs: there are no others", each)
        elif (files := image_files(each)) and stems.isdisjoint(file.stem for file in files):
            _log.warning("the images in %s are left out, for its name is that of maps of photographs", each)
    if len(folders) > 1:
        _log.warning("the photographs of %s are those in %s", item, listing([each.name for each in folders]))
    for folder in folders if len(folders) == 1 else ():
        if left := [each.name for each in folders_of_photographs(folder) if image_files(each)]:
            _log.warning("%s has photographs of its own; those in %s are left out", folder, listing(left))


def _tell_left_out(folder: Path) -> None:
    """Say which files beside photographs are not taken for photographs."""
    files = visible(folder, images.SUFFIXES)
    if maps := map_files(files):
        told = "%d of %d images in %s are depth, normals, masks or copies of others, and are left out: %s"
        _log.warning(told, len(maps), len(files), folder, listing([file.name for file in maps], most=4))
    developed = {file.stem for file in files}
    films = [file.name for file in visible(folder, video.SUFFIXES) if file.stem not in developed]
    if files and films:  # a live photograph and the thumbnail of a film are named as that film
        _log.warning("%s has photographs; the films in it are left out: %s", folder, listing(films, most=4))
    if raw := [file for file in visible(folder, RAW) if file.stem not in developed]:
        _log.warning(
            "%d photographs in %s are not developed (%s) and are left out; %s", len(raw), folder, _kinds(raw), _DEVELOP
        )


def _each(shots: Sequence[_Shot], problems: list[str], read: Callable[[str, _Shot], _Read]) -> list[_Read]:
    """The result of ``read`` for each photograph and its name; unreadable ones are logged and left out."""
    results: list[_Read] = []
    for name, shot in zip(short_names([shot.path.parent / shot.name for shot in shots]), shots, strict=True):
        try:
            results.append(read(name, shot))
        except ValueError as error:
            problems.append(str(error))
    for problem in problems:
        _log.warning("left out: %s", problem)
    return results or _nothing(problems)


def _nothing(problems: Sequence[str]) -> NoReturn:
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    raise UserError(f"no photograph can be read: {problems[0]}{more}")


def cover(
    name: str, picture: Image.Image, source: tuple[int, int], size: tuple[int, int], *, whole: bool = False
) -> tuple[Image.Image, SourceImage]:
    """A view of ``size`` from a picture, which may be a reduced copy of the source; see ``SourceImage.covering``."""
    shown = SourceImage.covering(name, (source[1], source[0]), size, whole=whole)
    return shown.resampled(picture, Image.Resampling.LANCZOS), shown
