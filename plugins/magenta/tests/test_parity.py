"""The two networks against the published graphs: numbers written down, and the graphs themselves where they can run."""

import json

import numpy as np
import pytest
import torch

from anystyle_magenta.networks import StylePrediction, StyleTransfer
from anystyle_magenta.pretrained import load_prediction, load_transfer
from tests.support.magenta_oracle import CONTENT_SIDE, GOLDEN, SIDE, picture, run_graphs, sampled

STYLE_TOLERANCE, PIXEL_TOLERANCE = 5e-6, 3e-5
"""Absolute: style vectors have a norm of 10, pixels are in [0, 1]."""


@pytest.fixture(scope="module")
def result() -> dict[str, np.ndarray]:
    prediction, transfer = StylePrediction(), StyleTransfer()
    load_prediction(prediction)
    load_transfer(transfer)
    with torch.no_grad():
        style = prediction(torch.from_numpy(picture(SIDE, 0.3))[None])
        stylized = transfer(torch.from_numpy(picture(CONTENT_SIDE, 1.1))[None, None], style)
    return {"style": style[0].numpy(), "stylized": stylized[0, 0].numpy()}


def test_the_networks_give_the_published_graphs_numbers(result):
    golden = json.loads(GOLDEN.read_text())
    assert 5 < np.linalg.norm(golden["style"]) < 15
    assert np.ptp(golden["stylized"]) > 0.5
    np.testing.assert_allclose(result["style"], golden["style"], rtol=0, atol=STYLE_TOLERANCE)
    np.testing.assert_allclose(sampled(result["stylized"]), golden["stylized"], rtol=0, atol=PIXEL_TOLERANCE)


def test_the_networks_equal_the_graphs_in_onnxruntime(result):
    pytest.importorskip("onnx", reason="the graphs without quantised activations are made by onnx")
    pytest.importorskip("onnxruntime", reason="the graphs are run by onnxruntime")
    graphs = run_graphs()
    np.testing.assert_allclose(result["style"], graphs["style"], rtol=0, atol=STYLE_TOLERANCE)
    np.testing.assert_allclose(result["stylized"], graphs["stylized"], rtol=0, atol=PIXEL_TOLERANCE)
