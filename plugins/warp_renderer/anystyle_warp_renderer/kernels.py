# type: ignore  # the language is Warp's: a part of Python with other types
"""One thread per pixel: blending of the Gaussians that its tile lists, and the gradients of that.

Warp does not differentiate loops that overwrite what they read, so that both directions are written out.
"""

import math

import warp as wp

from anystyle.geometry.projection import MIN_ALPHA
from anystyle.renderers.torch import MIN_TRANSMITTANCE
from anystyle_warp_renderer.tiles import TILE

Shape = wp.types.vector(length=6, dtype=wp.float32)
"""A Gaussian in the image: its position x, y in pixels, its inverse covariance xx, xy, yy, its opacity."""

_TILE, _MIN_ALPHA, _MIN_TRANSMITTANCE = wp.constant(TILE), wp.constant(MIN_ALPHA), wp.constant(MIN_TRANSMITTANCE)
_MAX_SIGMA = wp.constant(-math.log(MIN_ALPHA) + 0.01)  # beyond it nothing is seen, whatever its opacity


@wp.func
def pixel_of(tile: int, thread: int, width: int) -> wp.vec2i:
    """Column and row of a thread's pixel."""
    columns = (width + _TILE - 1) // _TILE
    return wp.vec2i(tile % columns * _TILE + thread % _TILE, tile // columns * _TILE + thread // _TILE)


@wp.func
def offset_of(pixel: wp.vec2i, shape: Shape) -> wp.vec2:
    """From a Gaussian's position to the centre of a pixel."""
    return wp.vec2(float(pixel[0]) + 0.5 - shape[0], float(pixel[1]) + 0.5 - shape[1])


@wp.func
def covered(offset: wp.vec2, shape: Shape) -> float:
    """The share of a pixel that a Gaussian covers, before it is capped; 0 where that is too little to be seen."""
    x, y = offset[0], offset[1]
    sigma = 0.5 * (shape[2] * x * x + shape[4] * y * y) + shape[3] * x * y
    if sigma < 0.0 or sigma > _MAX_SIGMA:
        return 0.0
    share = shape[5] * wp.exp(-sigma)
    return wp.where(share >= _MIN_ALPHA, share, 0.0)


@wp.kernel(enable_backward=False)
def blend(
    shapes: wp.array[Shape],
    payload: wp.array[wp.vec4],
    entries: wp.array[int],
    starts: wp.array[int],
    cap: float,
    image: wp.array3d[float],
    last: wp.array2d[int],
) -> None:
    """Write an image ``[5, H, W]``, the payload over black and the transmittance, and each pixel's last entry.

    The Gaussians of tile ``i`` are ``entries[starts[i]:starts[i + 1]]``, nearest first.
    """
    tile, thread = wp.tid()
    pixel = pixel_of(tile, thread, last.shape[1])
    if pixel[0] >= last.shape[1] or pixel[1] >= last.shape[0]:
        return
    total, passing, final = wp.vec4(), wp.float32(1.0), wp.int32(-1)
    for entry in range(starts[tile], starts[tile + 1]):
        shape = shapes[entries[entry]]
        alpha = wp.min(covered(offset_of(pixel, shape), shape), cap)
        if alpha > 0.0:
            after = passing * (1.0 - alpha)
            if after <= _MIN_TRANSMITTANCE:
                break
            total += alpha * passing * payload[entries[entry]]
            passing, final = after, entry
    for channel in range(4):
        image[channel, pixel[1], pixel[0]] = total[channel]
    image[4, pixel[1], pixel[0]] = passing
    last[pixel[1], pixel[0]] = final


@wp.kernel(enable_backward=False)
def blend_backward(
    shapes: wp.array[Shape],
    payload: wp.array[wp.vec4],
    entries: wp.array[int],
    starts: wp.array[int],
    cap: float,
    image: wp.array3d[float],
    last: wp.array2d[int],
    d_image: wp.array3d[float],
    d_shapes: wp.array[Shape],
    d_payload: wp.array[wp.vec4],
) -> None:
    """Add the gradients of shapes and payload, given that of the image; the rest is as :func:`blend` wrote it."""
    tile, thread = wp.tid()
    pixel = pixel_of(tile, thread, last.shape[1])
    if pixel[0] >= last.shape[1] or pixel[1] >= last.shape[0]:
        return
    d_pixel = wp.vec4()
    for channel in range(4):
        d_pixel[channel] = d_image[channel, pixel[1], pixel[0]]
    passing = image[4, pixel[1], pixel[0]]
    behind = passing * d_image[4, pixel[1], pixel[0]]  # what is behind the current Gaussian, times its gradient
    for entry in range(last[pixel[1], pixel[0]], starts[tile] - 1, -1):
        index = entries[entry]
        shape = shapes[index]
        offset = offset_of(pixel, shape)
        share = covered(offset, shape)
        alpha = wp.min(share, cap)
        if alpha > 0.0:
            passing /= 1.0 - alpha  # the transmittance in front of it
            value = wp.dot(payload[index], d_pixel)
            wp.atomic_add(d_payload, index, alpha * passing * d_pixel)
            if share <= cap:
                slope = share * (passing * value - behind / (1.0 - alpha))  # by the logarithm of its share
                x, y = offset[0], offset[1]
                d_shape = Shape(
                    slope * (shape[2] * x + shape[3] * y),
                    slope * (shape[3] * x + shape[4] * y),
                    -0.5 * slope * x * x,
                    -slope * x * y,
                    -0.5 * slope * y * y,
                    slope / shape[5],
                )
                wp.atomic_add(d_shapes, index, d_shape)
            behind += alpha * passing * value
