"""Files as programs write them and people have them hold what their specifications say, or are refused in a line."""

import logging
import warnings

import numpy as np
import pytest

from anystyle.contracts import Format
from anystyle.errors import UserError
from anystyle.registry.build import build
from tests.support.refusals import raises_line
from tests.support.strange_splats import Held, cases

CASES = cases()


def unit(quaternions):
    """Of norm 1; one of 0 turns nothing."""
    norms = np.linalg.norm(quaternions, axis=1, keepdims=True)
    return np.where(norms > 0, quaternions / np.maximum(norms, 1e-30), (1.0, 0.0, 0.0, 0.0))


@pytest.mark.parametrize("name", CASES)
def test_a_strange_file(name, tmp_path, caplog):
    """Every number, which rows are left out, and the exact lines that say so; nothing else is said."""
    caplog.set_level(logging.WARNING)
    if "version 4" in name:
        pytest.importorskip("zstandard", reason='pip install "anystyle[spz]"')
    case, path = CASES[name](), tmp_path / name
    path.write_bytes(case.data)
    reader = build(Format, path.suffix[1:], activated=case.activated)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        if not isinstance(case.held, Held):
            with raises_line(UserError, match=case.held, naming=name):
                reader.read(path)
            return
        scene = reader.read(path)
    assert [line.removeprefix(f"{path}: ") for line in caplog.messages] == list(case.lines)
    assert scene.offset == case.held.offset
    found = {name: tensor[0].double().numpy() for name, tensor in vars(scene.styles[-1][1]).items()}
    rotations = found.pop("rotations")
    for name, values in found.items():
        np.testing.assert_allclose(values, getattr(case.held, name), rtol=3e-6, atol=3e-6)
    assert rotations.shape == case.held.rotations.shape
    assert np.abs((unit(rotations) * unit(case.held.rotations)).sum(1)).min() > 1 - 1e-6


def test_the_corpus_has_every_format_of_one_file():
    assert {name.rpartition(".")[2] for name in CASES} == {"ksplat", "ply", "sog", "spz"}
