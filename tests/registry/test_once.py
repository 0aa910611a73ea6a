"""What is composed to be looked at is what runs: once each, and the same as when Hydra composes it twice."""

import pytest
from hydra._internal import config_loader_impl
from hydra._internal.defaults_list import create_defaults_list
from hydra._internal.hydra import Hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import OmegaConf

from anystyle.commands._compose import launch
from anystyle.registry import once

WORDS = ["hydra.run.dir=one", "hydra.sweep.dir=many", "hydra.output_subdir=null"]


def composed(words, monkeypatch):
    """What runs by some words: its configurations, Hydra's own part too, and how often anything was composed."""
    counted, configs = [], []
    with monkeypatch.context() as patch:
        patch.setattr(
            config_loader_impl, "create_defaults_list", lambda **kw: (counted.append(1), create_defaults_list(**kw))[1]
        )
        launch("stylize", lambda config: configs.append(everything(config)), words)
    return configs, len(counted)


def everything(config):
    hydra = OmegaConf.to_container(HydraConfig.instance().cfg, resolve=False, enum_to_str=True)
    return OmegaConf.to_yaml(config), hydra


@pytest.mark.parametrize(
    ("words", "runs", "times"),
    [
        (WORDS, 1, 1),
        (["-m", *WORDS], 1, 3),  # to look, for the sweep as a whole, and for its job
        (["-m", *WORDS, "views.short_side=56,70"], 2, 4),
    ],
)
def test_it_is_composed_once_and_the_same(words, runs, times, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    configs, counted = composed(words, monkeypatch)
    monkeypatch.setattr(Hydra, "get_mode", once._get_mode)
    monkeypatch.setattr(once, "_MOST", 0)
    assert composed(words, monkeypatch) == (configs, counted + runs)
    assert (len(configs), counted) == (runs, times)
    assert not once._looked_at


def test_a_mode_that_is_asked_for_is_heard(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    configs, _ = composed([*WORDS, "hydra.mode=MULTIRUN"], monkeypatch)
    assert [hydra["hydra"]["mode"] for _, hydra in configs] == ["MULTIRUN"]
