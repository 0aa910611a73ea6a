"""Photographs from folders, files, patterns and videos as one set of views."""

import glob
import logging
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from PIL import Image
from torch import Tensor

from anystyle.data import images, video
from anystyle.types import Views

MAX_ASPECT = 3.0
"""Longer panoramas lose their ends."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class SourceImage:
    """Where a view comes from, and what part of the source it shows.

    Args:
        name: Of the file without suffix, or of the video with the frame's number.
        size: Height and width of the upright source in pixels.
        box: Left, top, right and bottom of what the view shows, in source pixels.
        view_size: Height and width of the view in pixels.
    """

    name: str
    size: tuple[int, int]
    box: tuple[float, float, float, float]
    view_size: tuple[int, int]

    @classmethod
    def unchanged(cls, name: str, size: tuple[int, int]) -> "SourceImage":
        """A view that is its source."""
        return cls(name, size, (0.0, 0.0, float(size[1]), float(size[0])), size)

    def source_intrinsics(self, intrinsics: Float[Tensor, "3 3"]) -> Float[Tensor, "3 3"]:
        """Intrinsics in pixels of the view as intrinsics in pixels of the source."""
        left, top, right, bottom = self.box
        height, width = self.view_size
        x, y = (right - left) / width, (bottom - top) / height
        source_from_view = intrinsics.new_tensor([[x, 0.0, left], [0.0, y, top], [0.0, 0.0, 1.0]])
        return source_from_view @ intrinsics


def read_views(
    inputs: Sequence[Path], *, short_side: int, multiple: int, max_views: int
) -> tuple[Views, list[SourceImage]]:
    """Read photographs as views of one size.

    The size has the aspect that most photographs have, ``short_side`` as its shorter side, and sides that are
    multiples of ``multiple``. Each photograph is scaled to cover it, and what sticks out is cut off evenly: a few
    pixels where all have one aspect, more of those that differ. An unreadable photograph among others is left out,
    with a warning in the log.

    Args:
        inputs: Folders (their images in natural order), image files, patterns such as ``photos/*.jpg``, or videos.
        short_side: In pixels; rounded to a multiple.
        multiple: The patch size of the network.
        max_views: Of more photographs, evenly spaced ones are taken.

    Raises:
        ValueError: Nothing can be read; the message says why.
    """
    found = _find(inputs)
    thinned = evenly(found, max_views)
    if len(thinned) < len(found):
        _log.warning(
            "%d of %d photographs are taken, evenly spaced; views.max_views sets how many", max_views, len(found)
        )
    pictures: list[tuple[str, Image.Image]] = []
    problems: list[str] = []
    for path in thinned:
        try:
            if path.suffix.lower() in video.SUFFIXES:
                share = max(1, max_views // sum(item.suffix.lower() in video.SUFFIXES for item in thinned))
                frames = video.read_frames(path, share)
                pictures.extend((f"{path.stem}_{number:06d}", frame) for number, frame in frames)
            else:
                pictures.append((path.stem, images.open_image(path)))
        except ValueError as error:
            problems.append(str(error))
            _log.warning("left out: %s", error)
    if not pictures:
        raise ValueError(f"no photograph can be read: {problems[0]}" + _more(len(problems) - 1))
    size = common_size([picture.size for _, picture in pictures], short_side=short_side, multiple=multiple)
    covered = [_cover(name, picture, size) for name, picture in pictures]
    views = Views(
        images=torch.stack([images.to_tensor(picture) for picture, _ in covered])[None],
        names=tuple(source.name for _, source in covered),
    )
    return views, [source for _, source in covered]


def natural(name: str) -> list[tuple[int, str]]:
    """A key that sorts ``view2`` before ``view10``."""
    return [(int(part), "") if part.isdigit() else (0, part) for part in re.split(r"(\d+)", name.casefold()) if part]


def evenly(items: Sequence[Path], count: int) -> list[Path]:
    """At most ``count`` items, evenly spaced, the first and the last among them."""
    if len(items) <= count:
        return list(items)
    if count == 1:
        return [items[0]]
    return [items[round(place * (len(items) - 1) / (count - 1))] for place in range(count)]


def common_size(sizes: Sequence[tuple[int, int]], *, short_side: int, multiple: int) -> tuple[int, int]:
    """Height and width that most photographs fit, from their widths and heights."""
    (width, height), _ = Counter(sizes).most_common(1)[0]
    aspect = min(max(width / height, 1 / MAX_ASPECT), MAX_ASPECT)
    short = max(multiple, round(short_side / multiple) * multiple)
    long = max(short, round(short * max(aspect, 1 / aspect) / multiple) * multiple)
    return (short, long) if aspect >= 1 else (long, short)


def _find(inputs: Sequence[Path]) -> list[Path]:
    known = images.SUFFIXES | video.SUFFIXES
    found: list[Path] = []
    for item in inputs:
        if item.is_dir():
            inside = sorted(
                (path for path in item.iterdir() if path.is_file() and path.suffix.lower() in images.SUFFIXES),
                key=lambda path: natural(path.name),
            )
            if not inside:
                raise ValueError(f"there are no images in the folder {item}")
            found.extend(inside)
        elif item.is_file():
            found.append(item)
        else:
            names = glob.glob(str(item))  # noqa: PTH207  (a pattern may be absolute)
            matches = [Path(name) for name in names if Path(name).suffix.lower() in known]
            if not matches:
                raise ValueError(f"there is no folder, image or video {item}")
            found.extend(sorted(matches, key=lambda path: natural(str(path))))
    return found


def _cover(name: str, picture: Image.Image, size: tuple[int, int]) -> tuple[Image.Image, SourceImage]:
    height, width = size
    scale = min(picture.width / width, picture.height / height)
    shown = (scale * width, scale * height)
    left, top = (picture.width - shown[0]) / 2, (picture.height - shown[1]) / 2
    box = (left, top, left + shown[0], top + shown[1])
    resized = picture.resize((width, height), Image.Resampling.LANCZOS, box=box)
    return resized, SourceImage(name, (picture.height, picture.width), box, size)


def _more(count: int) -> str:
    return f" (and {count} more)" if count > 0 else ""
