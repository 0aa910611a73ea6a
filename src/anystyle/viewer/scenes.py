"""What the viewer opens: photographs, a folder of results or a PLY file, all ready for new styles."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from jaxtyping import Float
from torch import Tensor

from anystyle.inference.controlled import Controlled
from anystyle.inference.encoding import EncodedCapture
from anystyle.inference.saved import UNSTYLED, SavedScene
from anystyle.methods.contract import Method
from anystyle.types import Cameras, Gaussians

KEPT = 8
"""Scenes in styles that are kept, so that going back to one is instant."""


@dataclass(frozen=True)
class OpenScene:
    """A scene to look at.

    Args:
        unstyled: The scene itself; of a lone file, what it shows.
        cameras: To look from, a batch of one scene.
        names: Of the cameras.
        pictures: What each camera saw, or a render.
        controlled: Gives new styles.
        saved: Styles that are there already, by title.
        notes: Lines on where it comes from, such as licences.
    """

    unstyled: Gaussians
    cameras: Cameras
    names: tuple[str, ...]
    pictures: Float[Tensor, "V 3 H W"]
    controlled: Controlled
    saved: Mapping[str, Gaussians] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def opened_scene(
    encoded: EncodedCapture,
    method: Method | None = None,
    saved: SavedScene | None = None,
    notes: Sequence[str] = (),
) -> OpenScene:
    """What was encoded: photographs, or the renders of a scene that was saved.

    Args:
        encoded: The capture.
        method: How it takes styles; ``None`` for the single pass.
        saved: The scene, where one was saved.
        notes: Of the model, such as licences.
    """
    controlled = Controlled(encoded, method, keep=KEPT)
    pictures, cameras = encoded.views.images[0], encoded.cameras
    styles = {title: scene for title, scene in saved.styles if title != UNSTYLED} if saved else {}
    lines = tuple(dict.fromkeys((*(saved.notes if saved else ()), *notes)))
    return OpenScene(controlled.unstyled, cameras, tuple(encoded.names), pictures, controlled, styles, lines)
