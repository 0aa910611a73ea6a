"""A given scene to begin a fit with, in place of depths by stereo."""

import logging
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path, PurePosixPath

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import pad

from anystyle.data.images import SUFFIXES
from anystyle.errors import UserError
from anystyle.geometry.transforms import similarity_of_cameras
from anystyle.pipeline.beside import with_stored_cameras
from anystyle.pipeline.export import in_axes
from anystyle.pipeline.request import file_of
from anystyle.pipeline.saved import read_unturned, unstyled_of
from anystyle.types import Gaussians, Value, Views
from anystyle_captures.pixels import pixels_of
from anystyle_captures.poses import difference

logger = logging.getLogger(__name__)
SEEN = 1 / 3
"""Fraction of the Gaussians that cameras must see, or else they are of another scene or in another frame."""


@dataclass(frozen=True)
class GivenGaussians(Value):
    """A batch of one scene, and how large a pixel of the nearest camera is there."""

    given: Gaussians
    footprints: Float[Tensor, " N"]

    def gaussians(self, degree: int) -> Gaussians:
        """The same with harmonics of a degree."""
        given, count = self.given.harmonics, (degree + 1) ** 2
        return replace(self.given, harmonics=pad(given[:, :, :count], (0, 0, 0, max(0, count - given.shape[2]))))


@torch.no_grad()
def read_start(path: Path, views: Views) -> GivenGaussians:
    """The scene of a folder of results or a file of Gaussians, in the frame of the cameras of the views.

    It is brought there by its own cameras, of results or beside the file, where at least two have the names of views.

    Raises:
        UserError: No scene can be read, its cameras move otherwise than those of the same photographs, or these see
            less than :data:`SEEN` of it.
    """
    assert views.cameras is not None
    path, cameras = file_of(path), views.cameras.to("cpu")
    given = read_unturned(path)
    saved = with_stored_cameras(in_axes("opencv", given), path, own_up=given.up)
    gaussians, frame = unstyled_of(saved).marked(False), "in the frame of the photographs' cameras"
    own, named = ({_stem(name): view for view, name in enumerate(names)} for names in (saved.names, views.names))
    if len(both := [name for name in named if name in own]) > 1:
        there, here = saved.cameras.select([own[name] for name in both]), cameras.select([named[name] for name in both])
        change = similarity_of_cameras(there.world_from_camera[0].double(), here.world_from_camera[0].double())
        if not change.scale > 0:
            told = "its cameras do not move as the photographs' cameras do; give a scene of the same photographs"
            raise UserError(f"reconstruction.start={path}: {told}")
        poses = change.poses(there.world_from_camera.double())
        turned, moved = difference(here, replace(there, world_from_camera=poses))
        change = type(change)(*(part.to(gaussians.means) for part in change))
        gaussians = change.gaussians(gaussians)
        frame = f"aligned by {len(both)} cameras, which differ by {turned:.2f}° and {100 * moved:.1f}% of their radius"
    means, seen = gaussians.means[0], torch.zeros_like(gaussians.opacities[0], dtype=torch.bool)
    distance = torch.full_like(gaussians.opacities[0], inf)
    for view, center in enumerate(cameras.world_from_camera[0, :, :3, 3]):
        seen |= pixels_of(means, cameras, view).within
        distance = distance.minimum((means - center).norm(dim=1))
    share = float(seen.double().mean())
    if share < SEEN:
        raise UserError(
            f"reconstruction.start={path}: the photographs' cameras see {share:.0%} of its Gaussians: it is of another "
            "scene or in another frame; give a folder of results, or a file with its cameras beside it"
        )
    told = f"the fit begins with the {len(means)} Gaussians of {path}, {frame}"
    logger.warning("%s; photographs held out may have been seen by them", told)
    return GivenGaussians(gaussians, distance / cameras.intrinsics[0, :, 0, 0].mean()).to(views.images.device)


def _stem(name: str) -> str:
    """The name of a photograph without the suffix of an image, which some programs leave out."""
    path = PurePosixPath(name)
    return str(path.with_suffix("") if path.suffix.lower() in SUFFIXES else path)
