"""RAFT against the published implementation, and what it computes with less work against the same as published."""

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from scipy.ndimage import map_coordinates

from anystyle.testing.oracle import assert_matches, hashed
from anystyle_metrics.optical_flow import network
from anystyle_metrics.optical_flow.network import RADIUS, WINDOW, correlation_pyramid, look_up
from tests.support.judging_cases import ALIASES
from tests.support.oracle import fill_sorted, golden


def with_aliases(state: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """The original's state dict: one module under two names."""
    return {**state, **{key: state[key.replace(".norm3.", ".downsample.1.")] for key in ALIASES}}


def test_raft_matches_the_reference() -> None:
    record = golden("anystyle_golden")["raft"]
    net = network.RaftNetwork().eval()
    published = with_aliases(net.state_dict())
    assert len(published) == record["n_keys"]
    filled = {f"module.{key}": value for key, value in fill_sorted(published).items()}
    net.load_state_dict(network.original_keys(filled))
    source, target = (hashed(index, (1, 3, 128, 160), 0, 255) / 255 for index in (1110, 1111))
    with torch.no_grad():
        described = net.describe(source), net.describe(target)
        flow = net.flow(*described, net.context(source), iterations=record["iters"])
    assert_matches(flow, record["flow_up"], rtol=1e-4, atol=1e-4)


def test_loading_is_strict(tmp_path) -> None:
    state = with_aliases(network.RaftNetwork().state_dict())
    torch.save({f"module.{key}": value for key, value in state.items()}, tmp_path / "right.pth")
    network.load(path=tmp_path / "right.pth")
    del state["fnet.conv1.bias"]
    torch.save(state, tmp_path / "wrong.pth")
    with pytest.raises(ValueError, match=r"wrong.pth does not fit this RaftNetwork: 1 missing \(fnet"):
        network.load(path=tmp_path / "wrong.pth")


@torch.no_grad()
def test_windows_of_correlations_are_scipys_linear_interpolation():
    source, target = hashed(5, (2, 2, 8, 16, 20), -1, 1)
    pyramid = correlation_pyramid(source, target)
    coords = hashed(6, (2, 2, 16, 20), -14, 34)
    # On whole pixels, on the border, and far outside.
    coords[0, :, 0, :4] = torch.tensor([[3, 0, 19, 1e6], [5, 15, -5, -1e6]])
    windows = look_up(pyramid, coords).unflatten(1, (4, WINDOW, WINDOW))
    steps = np.arange(-RADIUS, RADIUS + 1)
    for image, row, column in ((0, 0, 0), (0, 0, 1), (0, 0, 2), (0, 0, 3), (1, 9, 4), (0, 15, 19)):
        x, y = coords[image, :, row, column].double().numpy()
        for index, level in enumerate(pyramid):
            correlation = level[(image * 16 + row) * 20 + column, 0].double().numpy()
            ys, xs = np.meshgrid(y / 2**index + steps, x / 2**index + steps)  # the first axis is x
            expected = map_coordinates(correlation, [ys, xs], order=1, mode="grid-constant")
            np.testing.assert_allclose(windows[image, index, :, :, row, column], expected, rtol=0, atol=2e-5)
    assert bool((windows != 0).any()) and bool((windows[0, ..., 0, 3] == 0).all())


@torch.no_grad()
def test_the_recurrent_unit_is_the_published_one():
    """Three convolutions of state, context and motion together in each half, one for each gate."""
    unit = network.Recurrent()
    for index, parameter in enumerate(unit.parameters()):
        parameter.copy_(hashed(10 + index, parameter.shape, -1, 1) / 30)
    start, context, motion = hashed(7, (3, 1, 128, 9, 14), -1, 1)
    state = start
    for half in (1, 2):
        z, r, q = (unit.get_submodule(f"conv{gate}{half}") for gate in "zrq")
        inputs = torch.cat([state, context, motion], dim=1)
        update, reset = z(inputs).sigmoid(), r(inputs).sigmoid()
        state = (1 - update) * state + update * q(torch.cat([reset * state, context, motion], dim=1)).tanh()
    torch.testing.assert_close(unit(start, unit.prepare(context), motion), state, rtol=0, atol=1e-5)


@torch.no_grad()
def test_upsampling_is_the_published_one():
    """With all nine neighbours of each new pixel side by side."""
    flow, logits = hashed(8, (2, 2, 5, 7), -9, 9), hashed(9, (2, 576, 5, 7), -3, 3)
    share = logits.reshape(2, 1, 9, 8, 8, 5, 7).softmax(dim=2)
    around = F.unfold(8 * flow, 3, padding=1).reshape(2, 2, 9, 1, 1, 5, 7)
    expected = (share * around).sum(2).permute(0, 1, 4, 2, 5, 3).reshape(2, 2, 40, 56)  # from M 2 8 8 h w
    torch.testing.assert_close(network.upsample(flow, logits), expected, rtol=0, atol=2e-5)
