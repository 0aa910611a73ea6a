"""What the tests of contracts share."""

import os
from functools import cache
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from anystyle.testing.run import one_thread
from anystyle.vision import weights
from anystyle.vision.networks import NETWORKS


@pytest.fixture(autouse=True)
def _on_one_thread():
    with one_thread():
        yield


@pytest.fixture(scope="session")
def untrained_weights(tmp_path_factory) -> Path:
    """A folder with an untrained network for each that this checkout lacks the weights of: contracts hold for any."""
    folder = tmp_path_factory.mktemp("weights")
    for name, make in NETWORKS.items():
        if _is_there(name):
            continue
        torch.manual_seed(0)
        file = folder / weights.row(name).file
        state = make().state_dict()
        save_file(state, file) if file.suffix == ".safetensors" else torch.save(state, file)
    return folder


@pytest.fixture
def any_weights(untrained_weights: Path, monkeypatch) -> None:
    """Let plugins find weights of every perceptual network."""
    named = [folder for folder in os.environ.get(weights.FOLDERS, "").split(os.pathsep) if folder]
    monkeypatch.setenv(weights.FOLDERS, os.pathsep.join([*named, str(untrained_weights)]))


@cache
def _is_there(name: str) -> bool:
    try:
        weights.find(name)
    except FileNotFoundError:
        return False
    return True
