"""The two networks against numbers that the published graphs gave, run by onnxruntime without quantised activations."""

import json
from pathlib import Path

import numpy as np
import torch

from anystyle_magenta.networks import StylePrediction, StyleTransfer
from anystyle_magenta.pretrained import load_prediction, load_transfer

GOLDEN = Path(__file__).parents[3] / "tests" / "goldens" / "golden_magenta.json"
SIDE, CONTENT_SIDE = 256, 384
"""Sides that the published graphs are fixed to."""
STEP = 32
"""Of the stylized picture every ``STEP``-th pixel is kept, from half a step on."""


def picture(side: int, phase: float) -> np.ndarray:
    """Stripes and rings in closed form, (3, side, side) in [0, 1]."""
    y, x = np.meshgrid(np.linspace(-1, 1, side), np.linspace(-1, 1, side), indexing="ij")
    radius = np.hypot(x - 0.2, y + 0.1)
    waves = [np.sin(9 * x + 5 * y + phase), np.sin(14 * radius + 2 * phase), np.sin(7 * x * y - 3 * y + 3 * phase)]
    return (0.5 + 0.5 * np.stack(waves)).astype(np.float32)


@torch.no_grad()
def test_the_networks_give_the_published_graphs_numbers():
    prediction, transfer = StylePrediction(), StyleTransfer()
    load_prediction(prediction)
    load_transfer(transfer)
    style = prediction(torch.from_numpy(picture(SIDE, 0.3))[None])
    stylized = transfer(torch.from_numpy(picture(CONTENT_SIDE, 1.1))[None, None], style)[0, 0]
    golden = json.loads(GOLDEN.read_text())
    assert 5 < np.linalg.norm(golden["style"]) < 15 and np.ptp(golden["stylized"]) > 0.5
    # A style vector has a norm of about 10, pixels are in [0, 1].
    np.testing.assert_allclose(style[0], golden["style"], rtol=0, atol=5e-6)
    sampled = stylized[:, STEP // 2 :: STEP, STEP // 2 :: STEP]
    np.testing.assert_allclose(sampled, golden["stylized"], rtol=0, atol=3e-5)
