"""What the viewer opens: photographs, a folder of results or a PLY file, all ready for new styles where a model can."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.data.folder import SourceImage
from anystyle.inference.controlled import Controlled
from anystyle.inference.encoding import EncodedCapture
from anystyle.inference.groups import Capture, Group
from anystyle.inference.saved import UNSTYLED, SavedScene
from anystyle.methods.contract import Method
from anystyle.stylizer import Stylizer
from anystyle.types import Cameras, Gaussians, Views

SHORT_SIDE = 224
"""Of the renders that a saved scene takes new styles by, at most."""
MOST_VIEWS = 24


@dataclass(frozen=True)
class OpenScene:
    """A scene to look at.

    Args:
        unstyled: The scene itself; of a lone file, what it shows.
        cameras: To look from, a batch of one scene.
        names: Of the cameras.
        pictures: What each camera saw, or a render.
        saved: Styles that are there already, by title.
        controlled: Gives new styles; ``None`` where nothing can.
    """

    unstyled: Gaussians
    cameras: Cameras
    names: tuple[str, ...]
    pictures: Float[Tensor, "V 3 H W"]
    saved: Mapping[str, Gaussians]
    controlled: Controlled | None


def of_capture(encoded: EncodedCapture, method: Method | None = None) -> OpenScene:
    """Photographs that were encoded."""
    controlled = Controlled(encoded, method)
    pictures = encoded.views.images[0]
    return OpenScene(controlled.unstyled, encoded.cameras, tuple(encoded.names), pictures, {}, controlled)


def of_saved(saved: SavedScene, stylizer: Stylizer, method: Method | None = None) -> OpenScene:
    """A scene that was saved: it takes new styles by its own renders where the model styles colours alone."""
    styles = dict(saved.styles)
    unstyled = styles.pop(UNSTYLED, saved.styles[-1][1]).to(stylizer.device)
    cameras = saved.cameras.select(_evenly(len(saved.names))).to(stylizer.device)
    names = tuple(saved.names[index] for index in _evenly(len(saved.names)))
    height, width = cameras.size
    multiple = stylizer.backbone.patch_size
    factor = min(1.0, SHORT_SIDE / min(height, width))
    size = (max(1, round(height * factor / multiple)) * multiple, max(1, round(width * factor / multiple)) * multiple)
    cameras = cameras.resized(size)
    with torch.no_grad():
        chosen = [cameras.select([view]) for view in range(len(names))]
        pictures = torch.cat([stylizer.render(unstyled, camera).color[0] for camera in chosen])
    views = Views(pictures[None], cameras=cameras, names=names)
    controlled = None
    if stylizer.branch.gaussian_head is None:
        controlled = Controlled(_as_capture(unstyled, views, stylizer), method)
    return OpenScene(unstyled, cameras, names, pictures.cpu(), styles, controlled)


def _as_capture(unstyled: Gaussians, views: Views, stylizer: Stylizer) -> EncodedCapture:
    """Given Gaussians and their renders, as if the renders had been photographs."""
    scene = replace(stylizer.encode_colors(views), gaussians=unstyled)
    sources = tuple(SourceImage.unchanged(name, views.size) for name in views.names)
    capture = Capture((Group(scene, tuple(range(len(sources))), None, len(sources)),))
    return EncodedCapture(stylizer, views.to("cpu"), sources, capture, {"kind": "saved"})


def _evenly(count: int) -> list[int]:
    """At most :data:`MOST_VIEWS` of so many, evenly spaced."""
    if count <= MOST_VIEWS:
        return list(range(count))
    return [round(index * (count - 1) / (MOST_VIEWS - 1)) for index in range(MOST_VIEWS)]
