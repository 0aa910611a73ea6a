"""The bundled tiny weights: what reconstruction and style they are good for, on scenes that training never saw."""

import pytest
import torch

from anystyle.pipeline.load import assemble
from anystyle.registry.compose import compose
from anystyle.stylizer import Stylizer
from anystyle.types import Geometry, Views
from anystyle.vision import weights
from anystyle_tiny.procedural.scenes import ProceduralScenes
from anystyle_tiny.training.reconstruction import geometry_errors, psnr
from anystyle_tiny.training.supervision import canonical

NAMES = tuple(name for name in weights.files() if name.startswith("depth_anything_tiny"))
SCENES = 6
INPUTS = [0, 2, 3, 5]
MEGABYTES = 8.0


@pytest.fixture(scope="module")
def tiny() -> Stylizer:
    return assemble(compose("stylize", ["~model", "backbone=depth_anything_tiny", "style_encoder=tiny"]))[0]


@pytest.fixture(scope="module")
def heldout() -> list[Views]:
    source = ProceduralScenes(size=112, num_scenes=SCENES, split="heldout")
    return [canonical(source.read(scene, INPUTS), len(INPUTS)) for scene in range(SCENES)]


def test_the_preset_lies_in_the_plugin_and_is_small() -> None:
    assert NAMES
    files = [weights.find(name) for name in NAMES]
    assert {file.parent.parent.name for file in files} == {"anystyle_tiny"}
    assert sum(file.stat().st_size for file in files) <= MEGABYTES * 1e6


def test_unseen_scenes_come_out_nearer_than_the_mean(tiny: Stylizer, heldout: list[Views]) -> None:
    """Against a plane for depth, no motion for cameras, and the mean colour for renders."""
    found, plain = [], []
    for views in heldout:
        assert views.cameras is not None
        with torch.no_grad():
            scene = tiny.encode(Views(views.images))
            gaussians = tiny.backbone.adapter(scene.attributes, scene.geometry, scene.clusters)
            renders = tiny.render(gaussians, scene.geometry.cameras)
        found.append(scores(geometry_errors(scene.geometry, views), renders.color, views.images))
        still = views.cameras.select([0, 0, 0, 0])
        plane = Geometry(still, torch.ones_like(scene.geometry.depth), torch.ones_like(scene.geometry.depth))
        mean = views.images.mean((1, 3, 4), keepdim=True).expand_as(views.images)
        plain.append(scores(geometry_errors(plane, views), mean, views.images))
    depth, turn, color = torch.tensor(found).mean(0)
    plain_depth, plain_turn, plain_color = torch.tensor(plain).mean(0)
    assert depth < 0.7 * plain_depth and turn < 0.85 * plain_turn
    assert color > plain_color + 1.5


def scores(errors: dict[str, torch.Tensor], drawn: torch.Tensor, seen: torch.Tensor) -> list[float]:
    return [float(errors["depth_abs_rel"]), float(errors["rotation_error_median_deg"]), float(psnr(drawn, seen).mean())]
