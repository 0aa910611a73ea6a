"""The training of the style branch, step by step."""

import pytest
import torch

from anystyle.testing.oracle import hashed
from anystyle.training.collate import stack_styles
from anystyle.training.scene_cache import EncodedScenes, stack_scenes
from anystyle.training.stylization import branch_groups, style_vectors
from anystyle.types import Scene, Style
from tests.support.training_cases import parts


def test_parameter_groups_are_the_published_ones():
    training, _ = parts("placement=full")
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


def test_text_steps_are_a_function_of_the_step():
    training, _ = parts("training.text_ratio=0.25")
    coin = [training.is_text_step(step) for step in range(4000)]
    assert coin == [training.is_text_step(step) for step in range(4000)] and abs(sum(coin) / 4000 - 0.25) < 0.03
    strict, _ = parts("training.text_ratio=0.25", "training.alternation=strict")
    assert [step for step in range(12) if strict.is_text_step(step)] == [3, 7, 11]


def test_a_style_that_lacks_one_modality_comes_as_the_other():
    training, _ = parts()
    encoder = training.stylizer.style_encoder
    image = hashed(1, (1, 3, 28, 28))
    style = stack_styles([Style(image=image, text=("red dots",)), Style(text=("blue stripes",)), Style(image=image)])
    seen = encoder.embed_images(image)[0]
    dots, stripes = encoder.embed_texts(["red dots"])[0], encoder.embed_texts(["blue stripes"])[0]
    for as_text, expected in ((True, (dots, stripes, seen)), (False, (seen, stripes, seen))):
        torch.testing.assert_close(style_vectors(training.stylizer, style, as_text=as_text), torch.stack(expected))
    with pytest.raises(ValueError, match="neither an image nor a text"):
        style_vectors(training.stylizer, Style(text=("",)), as_text=True)


def test_remembered_scenes_change_nothing():
    training, source = parts()
    batch = source.batch(0)
    first, remembered = (training.encoded(batch.inputs, batch.keys) for _ in range(2))
    for scene in (remembered, EncodedScenes(training.encoded.encode, 0)(batch.inputs, batch.keys)):
        assert torch.equal(scene.geometry.depth, first.geometry.depth)
        assert torch.equal(scene.attributes.color, first.attributes.color)
        assert torch.equal(scene.clusters.index, first.clusters.index)


def test_stacked_scenes_render_as_each_alone():
    training, source = parts()
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
