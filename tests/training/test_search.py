"""`anystyle train -m hydra/sweeper=optuna`: what a job returns, and jobs that return nothing."""

import pytest
import yaml

from anystyle.cli.launch import launch
from anystyle.commands.train import run
from anystyle.errors import UserError
from anystyle.training.run import Outcome

pytestmark = pytest.mark.filterwarnings("ignore")  # Optuna 2.10 uses what later libraries deprecate


@pytest.fixture
def searched(tmp_path, monkeypatch):
    """Search by Optuna, with trainings that take no time: some stop early, some are pruned, some fail."""
    import optuna

    monkeypatch.chdir(tmp_path)
    tried = []

    def train(config, out, on_begin):
        rate = config.training.learning_rate
        if rate > 0.6:
            raise UserError("the loss is nan")
        if rate > 0.4:
            raise optuna.TrialPruned
        tried.append(rate)
        return Outcome(1, rate > 0.2, {"train/loss": (rate - 0.1) ** 2, "val/psnr": rate}, ())

    def search(*words: str, trials: int = 2):
        launch("train", run, [
            "-m", "training=reconstruction", "loss=[]", "hydra/sweeper=optuna", "hydra.sweeper.n_jobs=1",
            f"hydra.sweeper.n_trials={trials}", "hydra.sweeper.sampler.seed=0", "hydra.sweep.dir=search", *words,
        ])  # fmt: skip
        return yaml.safe_load((tmp_path / "search/optimization_results.yaml").read_text()), tried

    monkeypatch.setattr("anystyle.training.run.train", train)
    return search


def test_a_search_finds_the_least_objective_past_jobs_that_fail_stop_early_or_are_pruned(searched, capsys):
    interval = ("training.learning_rate=interval(0.01,0.9)", "hydra.sweeper.max_failure_rate=1")
    found, tried = searched(*interval, "objective=train/loss", trials=12)
    assert 2 <= len(tried) < 12 and max(tried) > 0.2
    assert found["best_value"] == min((rate - 0.1) ** 2 for rate in tried)
    assert "job 12 of 12: training.learning_rate=" in capsys.readouterr().err


def test_a_search_may_have_several_objectives(searched):
    words = "objective=[train/loss,val/psnr]", "hydra.sweeper.direction=[minimize,maximize]"
    found, _ = searched("training.learning_rate=interval(0.21,0.4)", *words)
    assert all(one["values"][1] == one["params"]["training.learning_rate"] for one in found["solutions"])


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (
            ["objective=train/los"],
            r"objective: no value is named 'train/los'\. Did you mean 'train/loss'\? Available: train/loss, val/psnr",
        ),
        ([], "hydra/sweeper=optuna compares its jobs by a value; name one that they log, such as objective=train/loss"),
    ],
)
def test_a_search_without_a_value_to_compare_ends_in_one_line(searched, words, told):
    with pytest.raises(UserError, match=told):
        searched("training.learning_rate=interval(0.01,0.2)", *words, trials=1)
