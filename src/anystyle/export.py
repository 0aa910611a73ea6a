"""Writing videos."""

from collections.abc import Iterable
from pathlib import Path

import av
import numpy as np
from jaxtyping import Float
from torch import Tensor

from anystyle.files import atomic_path


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
        count = 0
        for image in frames:
            height, width = (side // 2 * 2 for side in image.shape[1:])
            if count == 0:
                stream.width, stream.height = width, height
            pixels = (image.detach().clamp(0, 1) * 255).round().byte().permute(1, 2, 0).cpu().numpy()
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels[:height, :width]), format="rgb24")
            for packet in stream.encode(frame):
                container.mux(packet)
            count += 1
        if not count:
            raise ValueError(f"there are no frames to write to {path}")
        for packet in stream.encode():
            container.mux(packet)
