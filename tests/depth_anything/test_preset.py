"""The tiny preset: the same code, at a size that a processor trains."""

from pathlib import Path

import pytest
import torch

import training_cases
from anystyle.contracts import Backbone
from anystyle.inference.assemble import assemble
from anystyle.io.checkpoint import load_part
from anystyle.registry.build import build
from anystyle.registry.compose import compose
from anystyle.training.run import train
from anystyle.types import Views
from anystyle_depth_anything import DepthAnything
from oracle import smooth_image


@pytest.fixture(scope="module")
def tiny() -> Backbone:
    torch.manual_seed(0)
    return build(Backbone, compose("stylize", ["backbone=depth_anything_tiny"]).backbone).eval()


def test_it_is_the_network_at_a_four_hundredth_of_the_size(tiny: Backbone) -> None:
    assert type(tiny) is DepthAnything
    assert 3e6 < sum(parameter.numel() for parameter in tiny.parameters()) <= 4e6


def test_photographs_of_its_size_become_one_gaussian_a_pixel(tiny: Backbone) -> None:
    views = Views(smooth_image(1, (1, 3, 3, tiny.resolution, tiny.resolution + 2 * tiny.patch_size)))
    with torch.no_grad():
        scene = tiny.encode(views)
        gaussians = tiny.adapter(scene.attributes, scene.geometry, scene.clusters)
    assert scene.clusters is None
    assert gaussians.means.shape == (1, 3 * tiny.resolution * (tiny.resolution + 28), 3)
    assert scene.geometry.depth.mean().item() == pytest.approx(1, abs=0.05)


SMALLER = (
    "backbone.resolution=28",
    "backbone.native_resolution=28",
    "backbone.dim=16",
    "backbone.heads=2",
    "backbone.depth_features=8",
    "backbone.depth_channels=[8,8,8,8]",
    "backbone.gaussian_features=24",
    "backbone.gaussian_channels=[8,8,8,8]",
)


def test_the_reconstruction_recipe_trains_it(tmp_path: Path) -> None:
    words = [
        "experiment=tiny_reconstruction",
        "backbone=depth_anything_tiny",
        *SMALLER,
        "scenes.size=28",
        "scenes.num_scenes=4",
        "scenes.samples=1",
        "validation_scenes=null",
        "training.batch_size=2",
        "training.context_views=[3,3]",
        "training.render_every=1",
        "training.warmup=1",
        "trainer.max_steps=3",
        "trainer.precision=32-true",
        "trainer.val_check_interval=1000",
        "name=test",
        "fast_dev_run=false",
    ]
    config = training_cases.configuration(words, tmp_path / "run")
    outcome = train(config, tmp_path / "run")
    assert outcome.finished and [file.name for file in outcome.weights] == ["backbone.safetensors"]

    trained, fresh = (build(Backbone, config.backbone) for _ in range(2))
    load_part(outcome.weights[0], trained, "backbone")
    before = fresh.state_dict()
    moved = [key for key, tensor in trained.state_dict().items() if not torch.equal(tensor, before[key])]
    # All of it learns: norms and LayerScales start alike in both.
    assert {"aggregator.norm.weight", "embedder.blocks.0.ls1.gamma", "gaussian_head.dpt.output.2.bias"} <= set(moved)


def test_a_sentence_restyles_what_it_encodes() -> None:
    words = [
        "model=tiny",
        "backbone=depth_anything_tiny",
        *SMALLER,
        "placement=full",
        "weights.backbone=null",
        "weights.branch=null",
    ]
    stylizer, _ = assemble(compose("stylize", [*words, "weights.style_encoder=null"]))
    views = Views(smooth_image(1, (1, 2, 3, 28, 42)))
    with torch.no_grad():
        scene = stylizer.encode(views)
        renders = stylizer.render(stylizer.restyle(scene, stylizer.embed(text="red dots")), scene.cameras)
    assert renders.color.shape == views.images.shape and bool(renders.color.isfinite().all())


def test_options_are_checked_where_they_are_written() -> None:
    with pytest.raises(ValueError, match="saddle"):
        compose("stylize", ["backbone=depth_anything_tiny", "backbone.reference=last"])
    with pytest.raises(ValueError, match="deph"):
        compose("stylize", ["backbone=depth_anything_tiny", "backbone.deph=3"])
