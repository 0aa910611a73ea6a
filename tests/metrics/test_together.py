"""All metrics: two processes say what one does, and each draws itself."""

import warnings
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import pytest
import torch

from anystyle.registry.catalog import catalog
from anystyle.testing.inputs import comparison
from anystyle.testing.metric import build
from anystyle.testing.subject import subject
from anystyle.types.seeds import seeded
from tests.support.processes import new

pytestmark = pytest.mark.slow
METRICS = catalog().names("metric")
BY_ONE = ("art_fid", "kid", "style_retrieval")
"""Of these, which keep lists, what two processes say of which one has taken in nothing."""
ROWS = 3


def made(name, folder):
    """A metric of its own, on stand-ins."""
    cls = catalog().find("metric", name).load()
    with seeded(0):
        return build(subject("metric", cls, cls.example(Path(folder))))


def rows():
    """A comparison for each style of one scene."""
    whole = replace(comparison(ROWS, 2), seconds=torch.tensor([1.0, 2.0, 6.0]))
    found = []
    for one in (slice(row, row + 1) for row in range(ROWS)):
        style = whole.style.map(lambda tensor, one=one: tensor[one])
        style = replace(style, names=whole.styles[one], text=whole.style.text and whole.style.text[one])
        row = whole.map(lambda tensor, one=one: tensor[one])
        found.append(replace(row, scenes=("scene",), styles=whole.styles[one], style=style))
    return found


def scores(metric):
    with warnings.catch_warnings(action="ignore"):  # of few images, which is no matter here
        return {name: float(value) for name, value in metric.scores().items()}


def _process(rank, count, folder):
    torch.set_num_threads(1)
    torch.distributed.init_process_group("gloo", f"file://{folder}/meeting", rank=rank, world_size=count)
    mine = rows()[rank::count]  # the processes have unequal shares
    found = {}
    for key, name, taken in [
        *((name, name, mine) for name in METRICS),
        *((f"{name} by one", name, [] if rank else rows()) for name in BY_ONE),
    ]:
        metric = made(name, folder)
        with torch.no_grad(), warnings.catch_warnings(action="ignore"):
            for row in taken:
                metric.update(row)
        found[key] = scores(metric)
    torch.save(found, Path(folder) / f"{rank}.pt")
    torch.distributed.destroy_process_group()


@pytest.fixture(scope="module")
def by_two(tmp_path_factory):
    """What each of two processes says that share the rows."""
    folder = tmp_path_factory.mktemp("processes")
    processes = [new.Process(target=_process, args=(rank, 2, folder), daemon=True) for rank in range(2)]
    for process in processes:
        process.start()
    for process in processes:
        process.join(240)
    assert [process.exitcode for process in processes] == [0, 0]
    return [torch.load(folder / f"{rank}.pt") for rank in range(2)]


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """Every metric, with all rows taken in by this process."""
    metrics = {name: made(name, tmp_path_factory.mktemp(name)) for name in METRICS}
    with torch.no_grad(), warnings.catch_warnings(action="ignore"):
        for metric in metrics.values():
            for row in rows():
                metric.update(row)
    return metrics


@pytest.mark.parametrize("name", METRICS)
def test_two_processes_say_what_one_does(name, by_two, alone):
    expected = scores(alone[name])
    # The sum over processes has another order.
    for found in by_two:
        assert found[name] == pytest.approx(expected, rel=1e-5, abs=1e-7, nan_ok=True)
        if name in BY_ONE:
            assert found[f"{name} by one"] == pytest.approx(expected, rel=1e-5, abs=1e-7, nan_ok=True)
    known = [value for value in expected.values() if value == value]
    assert known, f"{name} has nothing to compare"


@pytest.mark.parametrize("name", METRICS)
def test_a_metric_draws_itself(name, alone):
    plt.switch_backend("agg")
    with warnings.catch_warnings(action="ignore"):
        score, axes = alone[name].plot()
    assert {line.get_label() for line in axes.get_lines()} >= set(alone[name].better)
    plt.close(score)
