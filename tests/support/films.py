"""Films of given pixels, by any codec."""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import av
import numpy as np


def write_film(
    path: Path,
    frames: Iterable[np.ndarray],
    codec: str = "libx264",
    *,
    rate: int = 25,
    pixels: str = "yuv420p",
    options: Mapping[str, str] | None = None,
    container: Mapping[str, str] | None = None,
    prepare: Callable[[av.VideoStream], None] = lambda stream: None,
) -> None:
    """Encode 8-bit frames ``H W 3`` or, with alpha, ``H W 4``; options are those of the codec and of the container."""
    first, *others = frames
    with av.open(str(path), "w", options=dict(container or {})) as file:
        stream = file.add_stream(codec, rate=rate, options=dict(options or {}))
        stream.height, stream.width, stream.pix_fmt = *first.shape[:2], pixels
        prepare(stream)
        for frame in (first, *others):
            file.mux(
                stream.encode(av.VideoFrame.from_ndarray(frame, format="rgba" if frame.shape[2] == 4 else "rgb24"))
            )
        file.mux(stream.encode())
