"""Cycles of flows with known answers."""

import torch

from anystyle_metrics.optical_flow.visibility import cycle_visible


def test_a_constant_flow_and_its_negative_are_consistent_inside():
    forward = torch.full((1, 2, 8, 8), 2.0)
    visible = cycle_visible(forward, -forward)
    assert visible[0, :6, :6].all() and not visible[0, 6:].any() and not visible[0, :, 6:].any()
    assert not cycle_visible(forward, forward).any()
