"""The training of the style branch, step by step."""

import pytest
import torch

from anystyle.training.collate import stack_styles
from anystyle.training.data import Batch
from anystyle.training.run import make_data, make_training
from anystyle.training.scene_cache import EncodedScenes, stack_scenes
from anystyle.training.stylization import branch_groups, style_vectors
from anystyle.types import Scene, Style
from tests.support.oracle import hashed
from tests.support.training_cases import STYLIZATION, configuration


def parts(tmp_path, *overrides):
    config = configuration((*STYLIZATION, *overrides), tmp_path)
    torch.manual_seed(0)
    training = make_training(config)
    return training, make_data(config, training).train


def test_at_step_0_a_styled_render_is_the_unstyled_one(tmp_path):
    training, source = parts(tmp_path)
    batch = source.batch(0)
    result = training.stylize(batch, training.embed(batch.style, 0))
    stylizer = training.stylizer
    unstyled = stylizer.render(stylizer.unstyled(result.scene), result.scene.cameras)
    assert torch.equal(result.renders.color, unstyled.color)


@pytest.mark.parametrize("placement", ["head", "full"])
def test_by_the_second_step_every_parameter_has_a_gradient(tmp_path, placement):
    training, source = parts(tmp_path, f"placement={placement}", "branch.styled=[opacity,scale,rotation,color]")
    groups = branch_groups(training.stylizer, lr=1e-3, aggregator_rate=0.3)
    optimizer = torch.optim.Adam(groups)
    for step in range(2):
        batch = source.batch(step)
        result = training.stylize(batch, training.embed(batch.style, step))
        loss = (result.renders.color * hashed(step, result.renders.color.shape)).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    branch = training.stylizer.branch
    frozen = [p for p in training.stylizer.backbone.parameters() if p.grad is not None]
    without = [name for name, p in branch.named_parameters() if p.grad is None or not p.grad.any()]
    assert not without and not frozen


def test_parameter_groups_are_the_published_ones(tmp_path):
    training, _ = parts(tmp_path, "placement=full")
    groups = branch_groups(training.stylizer, lr=1e-4, aggregator_rate=0.3)
    assert [group["lr"] for group in groups] == [1e-4, 1e-4, pytest.approx(3e-5), pytest.approx(3e-5)]
    branch = training.stylizer.branch
    count = sum(p.numel() for group in groups for p in group["params"])
    assert count == sum(p.numel() for p in branch.parameters())
    slow = {id(p) for group in groups[2:] for p in group["params"]}
    assert {id(p) for p in branch.aggregator.parameters()} <= slow
    assert all(
        (id(p) in slow) == name.startswith("aggregator/")
        for name, injector in branch.injectors.items()
        for p in injector.parameters()
    )


def test_text_steps_are_a_function_of_the_step(tmp_path):
    training, _ = parts(tmp_path, "training.text_ratio=0.25")
    coin = [training.is_text_step(step) for step in range(4000)]
    assert coin == [training.is_text_step(step) for step in range(4000)]
    assert abs(sum(coin) / 4000 - 0.25) < 0.03
    strict, _ = parts(tmp_path, "training.text_ratio=0.25", "training.alternation=strict")
    assert [step for step in range(12) if strict.is_text_step(step)] == [3, 7, 11]


def test_a_style_that_lacks_one_modality_comes_as_the_other(tmp_path):
    training, _ = parts(tmp_path)
    encoder = training.stylizer.style_encoder
    image = hashed(1, (1, 3, 28, 28))
    style = stack_styles([Style(image=image, text=("red dots",)), Style(text=("blue stripes",)), Style(image=image)])
    seen = encoder.embed_images(image)[0]
    dots, stripes = encoder.embed_texts(["red dots"])[0], encoder.embed_texts(["blue stripes"])[0]
    for as_text, expected in ((True, (dots, stripes, seen)), (False, (seen, stripes, seen))):
        torch.testing.assert_close(style_vectors(training.stylizer, style, as_text=as_text), torch.stack(expected))
    with pytest.raises(ValueError, match="neither an image nor a text"):
        style_vectors(training.stylizer, Style(text=("",)), as_text=True)


def test_remembered_scenes_change_nothing(tmp_path):
    training, source = parts(tmp_path)
    batch = source.batch(0)
    again = Batch(batch.views, batch.context, batch.style, batch.keys)
    first = training.encoded(batch.inputs, batch.keys)
    remembered = training.encoded(again.inputs, again.keys)
    fresh = EncodedScenes(training.encoded.encode, 0)(batch.inputs, batch.keys)
    for scene in (remembered, fresh):
        assert torch.equal(scene.geometry.depth, first.geometry.depth)
        assert torch.equal(scene.attributes.color, first.attributes.color)
        assert torch.equal(scene.clusters.index, first.clusters.index)


def test_stacked_scenes_render_as_each_alone(tmp_path):
    training, source = parts(tmp_path)
    stylizer = training.stylizer
    batch = source.batch(1)
    both: Scene = training.encoded(batch.inputs, batch.keys)
    together = stylizer.render(stylizer.unstyled(both), both.cameras).color
    for row in range(2):
        alone = stylizer.encode(batch.inputs.map(lambda tensor, row=row: tensor[row : row + 1]))
        torch.testing.assert_close(
            together[row], stylizer.render(stylizer.unstyled(alone), alone.cameras).color[0], atol=1e-5, rtol=1e-4
        )
    assert stack_scenes([both]) is both
