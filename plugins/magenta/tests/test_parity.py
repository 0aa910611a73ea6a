"""The two networks against numbers that the published graphs gave, run by onnxruntime without quantised activations."""

import json
from pathlib import Path

import numpy as np
import torch

from anystyle_magenta.networks import StylePrediction, StyleTransfer
from anystyle_magenta.pretrained import load_prediction, load_transfer
from tests.support.oracle import stripes_and_rings

GOLDEN = Path(__file__).parents[3] / "tests" / "goldens" / "golden_magenta.json"
SIDE, CONTENT_SIDE = 256, 384
"""Sides that the published graphs are fixed to."""
STEP = 32
"""Of the stylized picture every ``STEP``-th pixel is kept, from half a step on."""


@torch.no_grad()
def test_the_networks_give_the_published_graphs_numbers():
    prediction, transfer = StylePrediction(), StyleTransfer()
    load_prediction(prediction)
    load_transfer(transfer)
    style = prediction(stripes_and_rings(SIDE, 0.3))
    stylized = transfer(stripes_and_rings(CONTENT_SIDE, 1.1)[None], style)[0, 0]
    golden = json.loads(GOLDEN.read_text())
    assert 5 < np.linalg.norm(golden["style"]) < 15 and np.ptp(golden["stylized"]) > 0.5
    # A style vector has a norm of about 10, pixels are in [0, 1].
    np.testing.assert_allclose(style[0], golden["style"], rtol=0, atol=5e-6)
    sampled = stylized[:, STEP // 2 :: STEP, STEP // 2 :: STEP]
    np.testing.assert_allclose(sampled, golden["stylized"], rtol=0, atol=3e-5)
