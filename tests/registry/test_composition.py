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


def test_a_date_is_a_name_and_no_number():
    words = ["root=2024_10_05", "seed=10_000", "protocol=captures", "protocol.captures=[24_10,./24_11]"]
    dated = compose("evaluate", words)
    assert (dated.root, dated.seed, dated.protocol.captures) == ("2024_10_05", 10_000, ["24_10", "./24_11"])
