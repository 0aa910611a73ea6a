"""Collation of views and styles: resized, mirrored and stacked into a batch."""

from collections.abc import Sequence
from dataclasses import replace

import torch
import torch.nn.functional as F

from anystyle.errors import UserError
from anystyle.types import Cameras, Style, Views


def fit_views(views: Views, size: tuple[int, int]) -> Views:
    """Views resized (bicubic) to cover ``size`` and centre-cropped; cameras and depth follow.

    Depth is taken from the nearest pixel, because a mean across an edge lies on no surface.
    """
    if views.size == size:
        return views
    (height, width), (source_height, source_width) = size, views.size
    scale = max(height / source_height, width / source_width)
    cover = max(height, round(source_height * scale)), max(width, round(source_width * scale))
    top, left = (cover[0] - height) // 2, (cover[1] - width) // 2
    flat = F.interpolate(views.images.flatten(0, 1), size=cover, mode="bicubic", antialias=True, align_corners=False)
    images = flat[..., top : top + height, left : left + width].unflatten(0, views.images.shape[:2])
    depth = views.depth
    if depth is not None:
        depth = F.interpolate(depth, size=cover, mode="nearest-exact")[..., top : top + height, left : left + width]
    cameras = views.cameras
    if cameras is not None:
        intrinsics = cameras.resized(cover).intrinsics.clone()
        intrinsics[..., 0, 2] -= left
        intrinsics[..., 1, 2] -= top
        cameras = Cameras(cameras.world_from_camera, intrinsics, size)
    return replace(views, images=images.clamp(0, 1), depth=depth, cameras=cameras)


def blurred_views(views: Views, scale: float) -> Views:
    """Views whose images are shrunk by ``scale`` and enlarged again; cameras and depth stay as they are."""
    height, width = views.size
    small = max(1, round(scale * height)), max(1, round(scale * width))
    flat = F.interpolate(views.images.flatten(0, 1), size=small, mode="bicubic", antialias=True, align_corners=False)
    flat = F.interpolate(flat, size=(height, width), mode="bilinear", align_corners=False)
    return replace(views, images=flat.unflatten(0, views.images.shape[:2]).clamp(0, 1))


def mirror_views(views: Views) -> Views:
    """Views of the mirrored scene."""
    cameras = views.cameras
    if cameras is not None:
        mirror = torch.diag(cameras.world_from_camera.new_tensor([-1.0, 1.0, 1.0, 1.0]))
        intrinsics = cameras.intrinsics.clone()
        intrinsics[..., 0, 2] = views.size[1] - intrinsics[..., 0, 2]
        cameras = Cameras(mirror @ cameras.world_from_camera @ mirror, intrinsics, cameras.size)
    depth = None if views.depth is None else views.depth.flip(-1)
    return replace(views, images=views.images.flip(-1), depth=depth, cameras=cameras)


def stack_views(rows: Sequence[Views]) -> Views:
    """A batch of scenes with equally many views of one size; cameras and depth only where all scenes have them."""
    sizes = {row.size for row in rows}
    if len(sizes) > 1:
        raise UserError(f"scenes of sizes {sorted(sizes)} cannot be one batch; set heights and width")
    cameras = [row.cameras for row in rows if row.cameras is not None]
    depth = [row.depth for row in rows if row.depth is not None]
    return Views(
        images=torch.cat([row.images for row in rows]),
        cameras=Cameras.cat(cameras) if len(cameras) == len(rows) else None,
        depth=torch.cat(depth) if len(depth) == len(rows) else None,
    )


def stack_styles(rows: Sequence[Style]) -> Style:
    """One batch of styles; a row without an image gets a black one that ``has_image`` denies."""
    shape = next((row.image.shape[1:] for row in rows if row.image is not None), None)
    image = has_image = None
    if shape is not None:
        image = torch.cat([torch.zeros(1, *shape) if row.image is None else row.image for row in rows])
        has_image = torch.cat(
            [torch.tensor([row.image is not None]) if row.has_image is None else row.has_image for row in rows]
        )
    texts = tuple(text for row in rows for text in (row.text or ("",)))
    names = tuple(name for row in rows for name in row.names)
    return Style(image=image, text=texts if any(texts) else None, has_image=has_image, names=names)
