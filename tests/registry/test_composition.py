"""Every command and every experiment composes, on each version of Hydra that is allowed, without a warning."""

import pytest

from anystyle.registry.compose import compose
from anystyle.registry.packages import presets

EXPERIMENTS = [f"experiment={name}" for name in presets("experiment")]


@pytest.mark.parametrize(
    "words", [["name=x"], *([word] for word in EXPERIMENTS), ["experiment=paper_head", "recipe=none"]]
)
def test_every_training_composes(words):
    assert compose("train", [*words, "out=x"]).checkpoint.every_steps > 0


@pytest.mark.parametrize("command", ["stylize", "evaluate"])
def test_every_command_composes(command):
    assert compose(command).seed == 0


def test_options_that_one_plugin_has_choose_it_where_no_configuration_does():
    chosen = compose("stylize", ["reconstruction.quality=draft"])
    assert chosen == compose("stylize", ["reconstruction=fit", "reconstruction.quality=draft"])
    assert compose("stylize", ["reconstruction=feedforward"]).reconstruction.keys() == {"_target_"}
