"""Videos: frames in, frames out."""

from collections.abc import Iterable, Iterator
from pathlib import Path

import av
import numpy as np
from av.container import InputContainer
from av.error import FFmpegError
from av.video.frame import VideoFrame
from av.video.stream import VideoStream
from jaxtyping import Float
from PIL import Image
from torch import Tensor

from anystyle.capacity import require
from anystyle.documents import regular
from anystyle.io.atomic import atomic_path
from anystyle.io.sheet import to_pil

SUFFIXES = frozenset({".avi", ".m4v", ".mkv", ".mov", ".mp4", ".mpeg", ".mpg", ".ogv", ".webm"})
"""File names that are taken for videos."""

_CONTAINERS = "avi,matroska,webm,mov,mp4,m4a,3gp,3g2,mj2,mpeg,mpegvideo,mpegts,ogg"
"""What ffmpeg calls the containers of these: no playlists, which name other files."""

MANY_FRAMES = 3000
"""Of longer videos only key frames are decoded."""


def read_frames(path: Path, count: int) -> list[tuple[int, Image.Image]]:
    """Evenly spaced frames: the video is cut into ``count`` equal parts, and the sharpest frame of each is taken.

    Returns:
        Frame numbers and upright 8-bit RGB images, in order.

    Raises:
        ValueError: It is no video, a damaged one, or has no frame.
    """
    regular(path, most=None, what="video")
    try:
        total = _count_frames(path)
        _room_for(path, min(count, total))
        best = _sharpest(path, count, total, key_frames_only=total > MANY_FRAMES)
        if total > MANY_FRAMES and len(best) < count:
            # Some encoders write hardly any key frames.
            best = _sharpest(path, count, total, key_frames_only=False)
    except FFmpegError as error:
        raise ValueError(f"{path} is no video, or a damaged one ({error.strerror})") from None
    if not best:
        raise ValueError(f"{path} is a video without frames")
    with path.open("rb") as file:
        start = file.read(8)
    # AVI says how many bytes there are, and decoders make up an index for what is left.
    if start[:4] == b"RIFF" and path.stat().st_size < 0.98 * (8 + int.from_bytes(start[4:], "little")):
        raise ValueError(f"{path} has {path.stat().st_size:,} bytes and announces more: it is truncated; get it again")
    announced, there = _seconds(path)
    if announced - there > max(0.5, 0.02 * announced):
        raise ValueError(f"{path} ends after {there:.1f} of {announced:.1f} s: it is truncated; get it again")
    return [best[part] for part in sorted(best)]


def _opened(path: Path) -> InputContainer:
    """A local file, whatever its name looks like: ``http:x.mp4`` is no address, and a playlist in it leads nowhere."""
    local = {"protocol_whitelist": "file", "format_whitelist": _CONTAINERS}
    return av.open(f"file:{path.absolute()}", container_options=local, options=local)


def _sharpest(path: Path, count: int, total: int, *, key_frames_only: bool) -> dict[int, tuple[int, Image.Image]]:
    """Number and image of the sharpest frame of each of ``count`` equal parts that has frames."""
    sharpness: dict[int, float] = {}
    best: dict[int, tuple[int, Image.Image]] = {}
    for number, frame in _decode(path, key_frames_only=key_frames_only):
        part = min(number * count // max(total, 1), count - 1)
        sharp = _sharpness(frame)
        if sharp > sharpness.get(part, -1.0):
            sharpness[part] = sharp
            best[part] = (number, _upright(frame))
    return best


def _count_frames(path: Path) -> int:
    """The number of frames by their packets, for headers do not always tell."""
    with _opened(path) as container:
        if not container.streams.video:
            raise ValueError(f"{path} has no video in it")
        return sum(1 for packet in container.demux(container.streams.video[0]) if packet.size)


def _room_for(path: Path, frames: int) -> None:
    """Refuse frames that memory does not hold, before they are decoded."""
    with _opened(path) as container:
        size = container.streams.video[0].codec_context
        if size is None:
            return  # no decoder is known; reading says so
        what = f"{frames} frames of {size.width}x{size.height} of {path}"
        require(3 * frames * size.width * size.height, what, "take fewer (views.take)")


def _seconds(path: Path) -> tuple[float, float]:
    """How long a video says it is, and how long the part is that is there; 0 and 0 where it does not say."""
    with _opened(path) as container:
        stream = container.streams.video[0]
        base = float(stream.time_base) if stream.time_base else 0.0
        declared = float(stream.duration or 0) * base
        announced = declared or (container.duration or 0) / av.time_base
        ends = [
            (packet.pts + (packet.duration or 0)) * base for packet in container.demux(stream) if packet.pts is not None
        ]
    return (announced, max(ends)) if announced and ends and base else (0.0, 0.0)


def _decode(path: Path, *, key_frames_only: bool) -> Iterator[tuple[int, VideoFrame]]:
    with _opened(path) as container:
        stream = container.streams.video[0]
        stream.thread_type = "AUTO"
        if key_frames_only:
            stream.codec_context.skip_frame = "NONKEY"
        for index, frame in enumerate(container.decode(stream)):
            number = _number(frame, stream) if key_frames_only else index
            if number is not None:
                yield number, frame


def _number(frame: VideoFrame, stream: VideoStream) -> int | None:
    """A frame's number from its time, where the file tells it."""
    if frame.pts is None or frame.time_base is None or stream.average_rate is None:
        return None
    return max(0, round((frame.pts - (stream.start_time or 0)) * frame.time_base * stream.average_rate))


def _sharpness(frame: VideoFrame) -> float:
    """Variance of the Laplacian of a small grey copy."""
    scale = min(1.0, 256 / max(frame.width, frame.height))
    size = {"width": max(4, round(frame.width * scale)), "height": max(4, round(frame.height * scale))}
    grey = frame.reformat(**size, format="gray").to_ndarray().astype(np.float32)
    laplacian = grey[1:-1, :-2] + grey[1:-1, 2:] + grey[:-2, 1:-1] + grey[2:, 1:-1] - 4 * grey[1:-1, 1:-1]
    return float(laplacian.var())


def _upright(frame: VideoFrame) -> Image.Image:
    image = frame.to_image()
    return image.rotate(frame.rotation, expand=True) if frame.rotation % 360 else image


def write_video(frames: Iterable[Float[Tensor, "3 H W"]], path: Path, *, fps: int = 30, crf: int = 18) -> None:
    """Write frames as H.264 video that browsers play, one by one as they come; whole or not at all.

    Args:
        frames: sRGB in [0, 1], all of one size; an odd row or column at the end is dropped, as the format demands.
        path: An ``.mp4`` file.
        fps: Frames a second.
        crf: Quality: smaller is better and larger in bytes; 18 is visually lossless.

    Raises:
        ValueError: There is no frame.
    """
    with atomic_path(path) as temporary, av.open(str(temporary), "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=fps, options={"crf": str(crf), "preset": "veryfast"})
        stream.pix_fmt = "yuv420p"
        empty = True
        for image in frames:
            height, width = (side // 2 * 2 for side in image.shape[1:])
            if empty:
                stream.width, stream.height, empty = width, height, False
            container.mux(stream.encode(VideoFrame.from_image(to_pil(image[:, :height, :width]))))
        if empty:
            raise ValueError(f"there are no frames to write to {path}")
        container.mux(stream.encode())
