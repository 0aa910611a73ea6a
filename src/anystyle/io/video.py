"""Reading frames of videos, and writing videos."""

import logging
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import av
import numpy as np
from av.container import InputContainer
from av.error import FFmpegError
from av.video.frame import VideoFrame
from av.video.reformatter import ColorRange, Colorspace
from jaxtyping import Float
from PIL import ExifTags, Image
from scipy.ndimage import laplace
from torch import Tensor

from anystyle.errors import UserError
from anystyle.io import color
from anystyle.io.atomic import atomic_path
from anystyle.io.documents import regular
from anystyle.io.limits import require
from anystyle.io.sheet import to_pil

_log = logging.getLogger(__name__)

SUFFIXES = frozenset(
    {".3g2", ".3gp", ".avi", ".m2ts", ".m4v", ".mkv", ".mov", ".mp4", ".mpeg", ".mpg", ".mts", ".ogv", ".ts", ".webm"}
)
"""Suffixes of files that are read as videos."""

_CONTAINERS = "avi,matroska,webm,mov,mp4,m4a,3gp,3g2,mj2,mpeg,mpegvideo,mpegts,ogg"
"""The names of their containers in ffmpeg; playlists are left out, as they refer to other files."""

MANY_FRAMES = 3000
"""Frames; only the key frames of longer videos are decoded."""

HD_LINES = 720
"""From this height on players take the colours of a film for BT.709, below for BT.601."""

BT709 = 1
"""Its matrix, primaries and transfer function in ITU-T H.273."""


class _Timeline(NamedTuple):
    """The number of a video's frames, and when it starts and ends in the time base of its stream.

    ``pixel_aspect`` is the width of a pixel by its height.
    """

    frames: int
    start: int
    end: int
    pixel_aspect: float

    def part(self, number: int, time: int | None, count: int) -> int:
        """Which of ``count`` parts of equal length a frame lies in; each has its own where there are no more frames.

        Where the video has no times, its number decides.
        """
        if time is None or self.end <= self.start or self.frames <= count:
            return min(number * count // max(self.frames, 1), count - 1)
        length = self.end - self.start
        # Containers round the times of frames, to milliseconds in Matroska: a frame at a border belongs behind it.
        rounding = min(2.0, length / (4 * self.frames))
        return min(max(0, int((time - self.start + rounding) * count / length)), count - 1)


def read_frames(path: Path, count: int) -> list[tuple[int, Image.Image]]:
    """Numbers and upright 8-bit RGB images of frames: of ``count`` parts of equal seconds the sharpest of each.

    Phones vary the rate of frames. A video of no more frames is read whole.
    """
    regular(path, most=None, what="video")
    try:
        timeline = _inspect(path, count)
        best = _sharpest(path, count, timeline, key_frames_only=True) if timeline.frames > MANY_FRAMES else {}
        if len(best) < count:  # some encoders write hardly any key frames
            best = _sharpest(path, count, timeline, key_frames_only=False)
    except FFmpegError as error:
        raise UserError(f"{path} is not a video, or is damaged ({error.strerror})") from None
    if not best:
        raise UserError(f"{path} is a video without frames")
    return [best[part] for part in sorted(best)]


def read_exif(path: Path) -> Image.Exif:
    """What a phone wrote into a video about its lens, as EXIF data of the frames; empty where it wrote nothing."""
    with opened(path) as container:
        found = {**container.metadata, **container.streams.video[0].metadata}
    tags, exif = ExifTags.Base, Image.Exif()
    details = exif.get_ifd(ExifTags.IFD.Exif)
    for place, tag, key in (
        (exif, tags.Make, "make"),
        (exif, tags.Model, "model"),
        (details, tags.LensModel, "camera.lens_model"),
        (details, tags.FocalLengthIn35mmFilm, "camera.focal_length.35mm_equivalent"),
    ):
        if text := found.get(f"com.apple.quicktime.{key}"):
            place[tag] = text[:200]
    return exif


def opened(path: Path) -> InputContainer:
    """Open a local video: neither its name (``http:x.mp4``) nor a playlist in it makes ffmpeg open anything else."""
    local = {"protocol_whitelist": "file", "format_whitelist": _CONTAINERS}
    return av.open(f"file:{path.absolute()}", container_options=local, options=local)


def _sharpest(
    path: Path, count: int, timeline: _Timeline, *, key_frames_only: bool
) -> dict[int, tuple[int, Image.Image]]:
    """Number and image of the sharpest frame in each of ``count`` parts, by part; empty parts are left out."""
    best: dict[int, tuple[float, int, Image.Image]] = {}
    for number, frame in _decode(path, key_frames_only=key_frames_only):
        part, sharp = timeline.part(number, frame.pts, count), _sharpness(frame)
        if part not in best or sharp > best[part][0]:
            image = color.to_image(frame, round(frame.width * timeline.pixel_aspect))
            best[part] = (sharp, number, image.rotate(frame.rotation, expand=True))
    return {part: (number, image) for part, (_, number, image) in best.items()}


def _inspect(path: Path, count: int) -> _Timeline:
    """The frames, counted by packets; a truncated file is refused, and frames that memory does not hold."""
    with path.open("rb") as file:
        start = file.read(8)
    # The header of an AVI file states its size; decoders do not report what is missing.
    if start[:4] == b"RIFF" and path.stat().st_size < 0.98 * (8 + int.from_bytes(start[4:], "little")):
        raise UserError(f"{path} has {path.stat().st_size:,} bytes and announces more: it is truncated; get it again")
    with opened(path) as container:
        if not container.streams.video:
            raise UserError(f"{path} has no video in it")
        stream = container.streams.video[0]
        base = float(stream.time_base or 0)
        announced = float(stream.duration or 0) * base or (container.duration or 0) / av.time_base
        packets = [(packet.pts, packet.duration) for packet in container.demux(stream) if packet.size]
        ends = [0 if start is None else start + (duration or 0) for start, duration in packets]
        there = max(ends, default=0)
        if base and there and announced - there * base > max(0.5, 0.02 * announced):
            raise UserError(f"{path} ends after {there * base:.1f} of {announced:.1f} s: it is truncated; get it again")
        if (size := stream.codec_context) is not None:  # without a decoder, reading raises
            what = f"{min(count, len(ends))} frames of {size.width}x{size.height} of {path}"
            require(3 * min(count, len(ends)) * size.width * size.height, what, "take fewer (views.take)")
            if (curve := color.CURVES.get(size.color_trc)) is not None:
                _log.warning("%s is a film of high dynamic range (%s), %s", path, curve, color.CLIPPED)
            parts = getattr(size.format, "components", ())  # VP9 has it in a stream of its own
            if any(part.is_alpha for part in parts) or stream.metadata.get("alpha_mode") == "1":
                _log.warning("%s has an alpha channel, which is not used: give its frames as PNG to use it", path)
        aspect = float(stream.sample_aspect_ratio or 1)
        if aspect != 1:
            _log.warning("%s has pixels %.2f times as wide as high; its frames are widened as players do", path, aspect)
        return _Timeline(len(ends), min((start for start, _ in packets if start is not None), default=0), there, aspect)


def _decode(path: Path, *, key_frames_only: bool) -> Iterator[tuple[int, VideoFrame]]:
    with opened(path) as container:
        stream = container.streams.video[0]
        stream.thread_type = "AUTO"
        if key_frames_only:
            stream.codec_context.skip_frame = "NONKEY"
        for index, frame in enumerate(container.decode(stream)):
            if not key_frames_only:
                yield index, frame
            elif frame.pts is not None and frame.time_base is not None and stream.average_rate is not None:
                seconds = (frame.pts - (stream.start_time or 0)) * frame.time_base
                yield max(0, round(seconds * stream.average_rate)), frame


def _sharpness(frame: VideoFrame) -> float:
    """Variance of the Laplacian of a small grey copy."""
    scale = min(1.0, 256 / max(frame.width, frame.height))
    size = {"width": max(4, round(frame.width * scale)), "height": max(4, round(frame.height * scale))}
    grey = frame.reformat(**size, format="gray").to_ndarray().astype(np.float32)
    return float(laplace(grey)[1:-1, 1:-1].var())


def write_video(frames: Iterable[Float[Tensor, "3 H W"]], path: Path, *, fps: int = 30) -> None:
    """Write frames, sRGB in [0, 1], as H.264 video that browsers play, one by one as they come; whole or not at all.

    All have one size; an odd row or column at the end is dropped, as the format demands. From :data:`HD_LINES` on,
    colours are stored and tagged as ITU-R BT.709, as players take films of that size.
    """
    with atomic_path(path) as temporary, av.open(str(temporary), "w", format="mp4") as container:
        # At this rate factor H.264 is visually lossless; films of "veryfast" are a tenth smaller, and take 1.7 as long.
        stream = container.add_stream("libx264", rate=fps, options={"crf": "18", "preset": "superfast"})
        stream.pix_fmt = "yuv420p"
        empty = True
        for image in frames:
            height, width = (side // 2 * 2 for side in image.shape[1:])
            if empty:
                stream.width, stream.height, empty = width, height, False
                if height >= HD_LINES:
                    context = stream.codec_context
                    context.colorspace, context.color_primaries, context.color_trc = BT709, BT709, BT709
                    context.color_range = ColorRange.MPEG
            frame = VideoFrame.from_image(to_pil(image[:, :height, :width]))
            if height >= HD_LINES:
                frame = frame.reformat(format="yuv420p", dst_colorspace=Colorspace.ITU709)
            container.mux(stream.encode(frame))
        if empty:
            raise ValueError(f"there are no frames to write to {path}")
        container.mux(stream.encode())
