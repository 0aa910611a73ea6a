"""What a reconstruction learns from its renders."""

from dataclasses import replace

import pytest
import torch

from anystyle.contracts import Backbone, Renderer
from anystyle.registry.build import build
from anystyle.registry.compose import compose
from anystyle_tiny.procedural.scenes import ProceduralScenes
from anystyle_tiny.training.reconstruction import ReconstructionTraining, reference_view_first
from anystyle_tiny.training.supervision import canonical
from tests.support.training_cases import RECONSTRUCTION


@pytest.fixture(scope="module")
def training() -> ReconstructionTraining:
    config = compose("train", list(RECONSTRUCTION))
    backbone, renderer = build(Backbone, config.backbone), build(Renderer, config.renderer)
    return ReconstructionTraining(backbone=backbone, renderer=renderer, predicted_camera_weight=2.0)


def test_renders_from_predicted_cameras_are_those_from_true_ones_where_both_agree(training):
    views = canonical(ProceduralScenes(size=28, num_scenes=1).read(0, [0, 1, 2]), 2)
    inputs = views.select([0, 1])
    scene = training.backbone.encode(inputs)
    assert views.cameras is not None and inputs.cameras is not None
    exact = replace(scene.geometry, cameras=inputs.cameras)
    right = training.render_losses(scene.features, exact, views, [1])
    torch.testing.assert_close(right["predicted_render"], right["render"])
    torch.testing.assert_close(right["predicted_ssim"], right["ssim"])
    pose = inputs.cameras.world_from_camera.clone()
    pose[:, 1, 0, 3] += 0.2
    wrong = replace(exact, cameras=replace(inputs.cameras, world_from_camera=pose))
    losses = training.render_losses(scene.features, wrong, views, [1])
    torch.testing.assert_close(losses["render"], right["render"])
    assert float(losses["predicted_render"].detach()) != pytest.approx(
        float(right["predicted_render"].detach()), rel=1e-3
    )
    assert training.weights["predicted_render"] == 2 * training.weights["render"]


def test_scenes_are_in_the_frame_of_the_view_that_the_backbone_chooses():
    """The tokens, reordered, are those of the reordered photographs; targets stay behind the context views."""
    config = compose("train", [*RECONSTRUCTION, "backbone.reference=middle"])
    embedder = build(Backbone, config.backbone).embedder
    views = ProceduralScenes(size=28, num_scenes=1, views=4).read(0, [0, 1, 2, 3])
    ordered, stem = reference_view_first(views, embedder(views.images[:, :3]))
    assert ordered.cameras is not None and views.cameras is not None
    assert torch.equal(ordered.images, views.images[:, [1, 0, 2, 3]])
    assert torch.equal(ordered.cameras.world_from_camera, views.cameras.world_from_camera[:, [1, 0, 2, 3]])
    config.backbone.reference = "first"
    first = build(Backbone, config.backbone).embedder
    first.load_state_dict(embedder.state_dict())
    torch.testing.assert_close(stem.data, first(ordered.images[:, :3]).data)
    assert stem.reference is not None and not stem.reference.any()
