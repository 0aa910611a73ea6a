"""Frames of films in RGB, and colours of high dynamic range in sRGB, by FFmpeg."""

from fractions import Fraction
from functools import cache

import numpy as np
from av.filter import Graph
from av.video.frame import VideoFrame
from av.video.reformatter import ColorRange
from jaxtyping import UInt
from PIL import Image, ImageFilter

CURVES = {16: "PQ", 18: "HLG"}
"""Transfer functions of high dynamic range, by their number in ITU-T H.273."""

CLIPPED = "brought to sRGB, where what is brighter than white (203 cd/m²) is clipped"

_GRID = 65
"""The finest grid of colours that Pillow interpolates in."""


def scaled(frame: VideoFrame, options: str, pixels: str = "rgb24") -> UInt[np.ndarray, "H W 3"]:
    """A frame by FFmpeg's filter ``scale``; ``reformat`` of PyAV lays the colours of 4:2:0 half a pixel aside."""
    graph = Graph()
    given = graph.add_buffer(width=frame.width, height=frame.height, format=frame.format, time_base=Fraction(1))
    graph.link_nodes(given, *map(graph.add, ("scale", "format", "buffersink"), (options, pixels, None))).configure()
    graph.vpush(frame)
    return graph.vpull().to_ndarray()


def to_image(frame: VideoFrame, width: int) -> Image.Image:
    """A frame as RGB, scaled to ``width`` pixels; of high dynamic range in sRGB.

    By default FFmpeg truncates, and frames are a level too dark.
    """
    # FFmpeg refuses a frame whose tags are reserved numbers; they are of no use to this step.
    primaries, curve, frame.color_primaries, frame.color_trc = frame.color_primaries, frame.color_trc, 2, 2
    image = Image.fromarray(scaled(frame, f"{width}:{frame.height}:flags=bicubic+accurate_rnd+full_chroma_int"))
    return to_sdr(image, primaries, curve) if curve in CURVES else image


def to_sdr(image: Image.Image, primaries: int, curve: int) -> Image.Image:
    """An RGB image of high dynamic range in sRGB; primaries and transfer function are numbers of ITU-T H.273.

    Diffuse white, 203 cd/m² (ITU-R BT.2408), becomes white; what is brighter, or more saturated than sRGB, is clipped.
    """
    return image.filter(_table(primaries if primaries in (1, 9, 12) else 9, curve))  # others are taken for BT.2020's


@cache
def _table(primaries: int, curve: int) -> ImageFilter.Color3DLUT:
    """What becomes of a grid of colours: FFmpeg takes seconds to prepare this, whatever the number of pixels."""
    levels = np.linspace(0, 65535, _GRID).round().astype(np.uint16)
    colors = np.stack(np.meshgrid(levels, levels, levels, indexing="ij")[::-1], axis=-1)  # red changes fastest
    frame = VideoFrame.from_ndarray(colors.reshape(_GRID, -1, 3), format="rgb48le")
    frame.color_primaries, frame.color_trc, frame.color_range = primaries, curve, ColorRange.JPEG
    converted = scaled(frame, "out_transfer=iec61966-2-1:out_primaries=bt709:out_range=full", "rgb48le")
    return ImageFilter.Color3DLUT(_GRID, (converted.ravel() / 65535).astype(np.float32))
