"""A run on another device mixes in no tensor of the CPU, as far as tensors without memory can show.

On the meta device an operation of a tensor there and one on the CPU is an error, as on a graphics card, and no value is
computed. What asks for values cannot be followed there; each such case is named.
"""

import pytest
import torch

import anystyle
from anystyle.contracts import Loss
from anystyle.registry.build import build
from anystyle.registry.catalog import catalog
from anystyle.testing import inputs, samples

ASKS_FOR_VALUES = (
    "is on the meta device",
    "meta tensors",
    "Cannot copy out of meta",
    "unsupported scalarType",
    "aten::",
)


def followed(call):
    """What a call gives on the meta device; skips where it asks for values."""
    try:
        return call()
    except (NotImplementedError, RuntimeError) as error:
        if "not on the expected device" in str(error) or "same device" in str(error):
            raise
        if any(words in str(error) for words in ASKS_FOR_VALUES):
            pytest.skip(f"asks for values: {str(error)[:80]}")
        raise


def test_tensors_of_two_devices_do_not_mix_here():
    with pytest.raises(RuntimeError, match="not on the expected device"):
        torch.empty(3, device="meta") + torch.ones(3)


def test_encoding_and_restyling():
    torch.manual_seed(0)
    stylizer = anystyle.load("tiny", ["renderer=torch"])
    with torch.no_grad():
        scene = stylizer.encode(inputs.views(1, 2, (56, 56)))
        embedding = stylizer.embed(image=inputs.images(1, (32, 32)))
        meta = stylizer.to("meta")
        stem = meta.backbone.embedder(scene.views.images.to("meta"))
        features = meta.backbone.aggregator(stem)
        attributes = meta.backbone.gaussian_head(features, scene.views.images.to("meta"))
        assert stem.data.is_meta and attributes.color.is_meta
        assert meta.branch(scene.to("meta"), embedding.to("meta")).color.is_meta


@pytest.mark.parametrize("name", catalog().names("loss"))
def test_losses(name):
    given = samples.stylization()
    try:
        loss = build(Loss, name, style_encoder=samples.runtime()["style_encoder"])
    except FileNotFoundError as error:
        pytest.skip(str(error)[:80])
    assert followed(lambda: loss.to("meta")(given.to("meta"))).is_meta
