"""Results, photographs and styles found in folders, and pictures of one size made of them."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import av
from PIL import Image, ImageOps

from anystyle.io.images import decodable, opened

_T = TypeVar("_T")

SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tif", ".tiff")
_LONGEST = 4096
_INNER = ("renders", "images")  # folders that hold a result's or a scene's frames


Results = Mapping[tuple[str, str], Sequence[Path]]
"""One method's frames of each scene and style, in order."""


def frames_in(path: Path) -> list[Path]:
    """The images that a file or a folder stands for, in order of their names."""
    if path.is_file():
        return [path] if path.suffix.lower() in SUFFIXES else []
    inner = next((path / name for name in _INNER if (path / name).is_dir()), path)
    return sorted(file for file in inner.iterdir() if file.is_file() and file.suffix.lower() in SUFFIXES)


def _named(folder: Path) -> dict[str, Path]:
    """Folders and images in a folder, by name without suffix; hidden ones are left out."""
    entries = [entry for entry in sorted(folder.iterdir()) if not entry.name.startswith(".")]
    return {
        entry.stem if entry.is_file() else entry.name: entry
        for entry in entries
        if entry.is_dir() or entry.suffix.lower() in SUFFIXES
    }


def _folder(path: Path, kind: str) -> Path:
    if not path.is_dir():
        raise ValueError(f"{kind} {path} is no folder; expected one")
    return path


def find_results(method: str, folder: Path) -> Results:
    """Results laid out as ``SCENE/STYLE.png`` or ``SCENE/STYLE/FRAMES``.

    Raises:
        ValueError: There are none.
    """
    frames_of: dict[tuple[str, str], Sequence[Path]] = {}
    for scene, path in _named(_folder(folder, f"method {method}:")).items():
        if not path.is_dir():
            continue
        for style, result in _named(path).items():
            frames = frames_in(result)
            if frames:
                frames_of[scene, style] = frames
    if not frames_of:
        raise ValueError(f"method {method}: {folder} holds no results; expected SCENE/STYLE.png or SCENE/STYLE/*.png")
    return frames_of


def find_contents(folder: Path) -> dict[str, list[Path]]:
    """Photographs laid out as ``SCENE.jpg`` or ``SCENE/FRAMES``, by scene."""
    return {name: frames for name, path in _named(_folder(folder, "contents")).items() if (frames := frames_in(path))}


def find_styles(folder: Path) -> dict[str, Path]:
    """Styles laid out as ``STYLE.jpg``, or ``STYLE.txt`` for a style in words, by name."""
    files = sorted(file for file in _folder(folder, "styles").iterdir() if file.is_file())
    return {file.stem: file for file in files if file.suffix.lower() in (*SUFFIXES, ".txt")}


def matching_frames(groups: Sequence[Sequence[Path]], count: int) -> list[list[Path]]:
    """``count`` frames of each group, evenly spaced: of those that all groups name alike, else of each group's own.

    Raises:
        ValueError: A group has fewer.
    """
    few = min(groups, key=len)
    if len(few) < count:
        raise ValueError(f"{few[0].parent} has {len(few)} view(s) where {count} are planned; add some or plan fewer")
    common = sorted(set.intersection(*({frame.stem for frame in group} for group in groups)))
    if len(common) >= count:
        names = spread(common, count)
        return [[frame for frame in group if frame.stem in names] for group in groups]
    return [spread(group, count) for group in groups]


def spread(entries: Sequence[_T], count: int) -> list[_T]:
    """``count`` evenly spaced entries, the middle one for 1; all where there are fewer."""
    count = min(count, len(entries))
    return [entries[(2 * index + 1) * len(entries) // (2 * count)] for index in range(count)]


def read_picture(path: Path) -> Image.Image:
    """An image as RGB, upright, transparency over white, without any metadata.

    Raises:
        ValueError: It is no image, damaged, or larger than 100 megapixels.
    """
    with opened(path) as image:
        decodable(image, _LONGEST)
        upright = ImageOps.exif_transpose(image).convert("RGBA")
    white = Image.new("RGBA", upright.size, "white")
    return Image.alpha_composite(white, upright).convert("RGB")


def fitted_size(size: tuple[int, int], longest: int) -> tuple[int, int]:
    """Width and height with the same proportions and ``longest`` as the longer side."""
    scale = longest / max(size)
    return max(1, round(size[0] * scale)), max(1, round(size[1] * scale))


def filled(image: Image.Image, size: tuple[int, int]) -> Image.Image:
    """An image scaled to fill ``size``, what stands out cut off evenly."""
    return ImageOps.fit(image, size, Image.Resampling.LANCZOS)


def contained(image: Image.Image, longest: int) -> Image.Image:
    """An image scaled to ``longest``, uncut."""
    return image.resize(fitted_size(image.size, longest), Image.Resampling.LANCZOS)


def degraded(image: Image.Image) -> Image.Image:
    """What nobody prefers: gray, and blurred to a sixteenth of the resolution."""
    small = ImageOps.grayscale(image).resize((max(1, image.width // 16), max(1, image.height // 16)))
    return small.resize(image.size, Image.Resampling.BICUBIC).convert("RGB")


def write_video(images: Sequence[Image.Image], path: Path, frames_per_second: int) -> None:
    """An H.264 file that browsers play, without sound and without metadata."""
    with av.open(str(path), "w", options={"movflags": "+faststart"}) as container:
        stream = container.add_stream("libx264", rate=frames_per_second, options={"crf": "18", "preset": "fast"})
        stream.pix_fmt = "yuv420p"
        stream.width, stream.height = (side - side % 2 for side in images[0].size)
        for image in images:
            frame = av.VideoFrame.from_image(image.crop((0, 0, stream.width, stream.height)))
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def write_picture(image: Image.Image, path: Path) -> None:
    """A JPEG file without visible loss and without metadata."""
    image.save(path, "JPEG", quality=92, subsampling=0, optimize=True)
