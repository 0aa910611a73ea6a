"""A run on another device mixes in no tensor of the CPU: on that of ``elsewhere`` this is an error, as on a graphics
card. Encoding runs on PyTorch's meta device, which computes no values.
"""

import pytest
import torch

import anystyle
from anystyle.contracts import Loss, Metric
from anystyle.registry.build import build
from anystyle.registry.catalog import catalog
from anystyle.testing import inputs
from anystyle.testing.toy.correspondence import ToyCorrespondence
from tests.support.elsewhere import There, elsewhere, sent


def test_encoding_and_restyling():
    torch.manual_seed(0)
    stylizer = anystyle.load("tiny", ["renderer=torch"])
    with torch.no_grad():
        scene = stylizer.encode(inputs.views(1, 2, (56, 56)))
        embedding = stylizer.embed(image=inputs.images(1, (32, 32)))
        meta = stylizer.to("meta")
        stem = meta.backbone.embedder(scene.views.images.to("meta"))
        attributes = meta.backbone.gaussian_head(meta.backbone.aggregator(stem), scene.views.images.to("meta"))
        assert stem.data.is_meta and attributes.color.is_meta
        assert meta.branch(scene.to("meta"), embedding.to("meta")).color.is_meta


@pytest.mark.parametrize("name", catalog().names("loss"))
def test_losses(name):
    given = inputs.stylization()
    try:
        loss = build(Loss, name, style_encoder=inputs.style_encoder())
    except FileNotFoundError as error:
        pytest.skip(str(error)[:80])
    with torch.no_grad(), elsewhere() as device:
        sent(loss)
        assert isinstance(loss(given.to(device)), There)


@pytest.mark.filterwarnings("ignore::UserWarning")  # of metrics that find nothing in these images to judge
@pytest.mark.parametrize("name", catalog().names("metric"))
def test_metrics(name):
    given = inputs.comparison()
    metric = build(Metric, name, style_encoder=inputs.style_encoder(), correspondence=ToyCorrespondence())
    with torch.no_grad(), elsewhere() as device:
        sent(metric)
        for key, value in metric.metric_state.items():
            if isinstance(value, torch.Tensor):
                setattr(metric, key, There(value))
        try:
            metric.update(given.to(device))
        except RuntimeError as error:
            if "unsupported scalarType" in str(error):
                pytest.skip("a compiled function in it takes tensors apart by itself")
            raise
        except FileNotFoundError as error:  # weights that nothing stands in for
            pytest.skip(str(error)[:80])
        held = [
            value for state in metric.metric_state.values() for value in (state if isinstance(state, list) else [state])
        ]
        assert held and all(isinstance(value, There) for value in held)


def test_that_device_has_values_and_mixes_with_no_other():
    ramp = torch.arange(6.0).reshape(2, 3)
    with elsewhere() as device:
        there = ramp.to(device)
        assert there[[1, 0]].tolist() == ramp[[1, 0]].tolist()
        assert (2 * there + torch.tensor(1.0)).mean(0).tolist() == (2 * ramp + 1).mean(0).tolist()
        assert isinstance(torch.zeros(3, device=there.device), There) and not isinstance(there.cpu(), There)
        with pytest.raises(RuntimeError, match="tensors of two devices"):
            there + torch.ones(3)
