"""What a metric promises: see :class:`anystyle.contracts.Metric`."""

import pickle
import warnings
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from anystyle.contracts import Metric
from anystyle.testing.check import Check, attempt, expect
from anystyle.testing.comparing import expect_close, expect_same, expect_untouched
from anystyle.testing.inputs import comparison
from anystyle.testing.subject import Subject
from anystyle.types import Comparison

Plugin = Subject[Metric]


def figures_are_declared(plugin: Plugin) -> None:
    """``better`` says of each figure whether higher or lower is better, and ``compute`` returns exactly these."""
    better = getattr(plugin.cls, "better", None)
    expect(
        isinstance(better, Mapping) and bool(better) and set(better.values()) <= {"higher", "lower"},
        given=f"better = {better!r}",
        expected="a class attribute such as {'art_fid': 'lower'}",
        change="name each figure, and say `higher` or `lower`",
    )
    figures = _figures(plugin)
    expect(
        isinstance(figures, dict) and sorted(figures) == sorted(better or ()),
        given=f"`compute` returned {sorted(figures) if isinstance(figures, dict) else figures!r}",
        expected=f"a figure for each of {sorted(better or ())}",
        change="make `compute` and `better` name the same figures",
    )
    for name, value in figures.items():
        expect(
            isinstance(value, Tensor) and value.shape == () and value.is_floating_point(),
            given=f"`{name}` is {value!r}",
            expected="a floating-point tensor without axes",
            change="return torch tensors, one number each",
        )


def too_little_is_not_an_error(plugin: Plugin) -> None:
    """Before any update the figures are ``nan``; figures from too little are ``nan`` or numbers, never an error."""
    figures = _computed(plugin, [])
    known = [name for name, value in figures.items() if not bool(torch.isnan(value))]
    expect(
        not known,
        given=f"a number for {', '.join(known)} although nothing was taken in",
        change="return `torch.tensor(float('nan'))` where there is nothing to average",
    )
    _computed(plugin, _rows(batch=1, number=1))


def reset_forgets(plugin: Plugin) -> None:
    """After ``reset`` it gives what a new one gives."""
    metric = plugin.build()
    _update(metric, [comparison(1, 2)])
    _compute(metric)
    metric.reset()
    _update(metric, _rows())
    expect_close(
        _compute(metric),
        _figures(plugin),
        what="the figures after `reset`",
        change="register everything it remembers with `self.add_state`",
    )


def order_does_not_matter(plugin: Plugin) -> None:
    """Taking in scenes in another order, or as one batch, gives the same figures."""
    rows, figures = _rows(), _figures(plugin)
    for what, given in (("in another order", rows[::-1]), ("as one batch", [comparison(3)])):
        expect_close(
            _computed(plugin, given),
            figures,
            what=f"the figures of the same scenes {what}",
            change="sum over all that was taken in, weighted by count; do not average averages of batches",
        )


def copies_go_on(plugin: Plugin) -> None:
    """A clone, and a pickled copy, go on from where it is."""
    rows, figures = _rows(), _figures(plugin)
    for what in ("a clone", "a pickled copy"):
        metric = plugin.build()
        _update(metric, rows[:2])
        with attempt(f"making {what}", change="keep no handles, lambdas or generators in the metric"):
            copied: Any = metric.clone() if what == "a clone" else pickle.loads(pickle.dumps(metric))
        _update(copied, rows[2:])
        expect_close(
            _compute(copied),
            figures,
            what=f"the figures of {what} that took in the rest",
            change="register everything it remembers with `self.add_state`",
        )


def processes_can_be_merged(plugin: Plugin) -> None:
    """Two metrics that took in a part each give, merged, what one gives that took in everything."""
    rows = _rows()
    one, other = plugin.build(), plugin.build()
    _update(one, rows[:2])
    _update(other, rows[2:])
    with attempt("`merge_state`", change="give each state a `dist_reduce_fx` of 'sum' or 'cat' in `add_state`"):
        one.merge_state(other)
    expect_close(
        _compute(one),
        _figures(plugin),
        what="the figures of two merged metrics",
        change="keep sums and counts, or lists of rows, and divide in `compute`",
    )


def inputs_are_left_alone(plugin: Plugin) -> None:
    """What was compared is left as it was, and computing twice gives the same bits."""
    given = comparison(2)
    kept = given.map(Tensor.clone)
    metric = plugin.build()
    _update(metric, [given])
    expect_untouched(given, kept, "the comparison after `update`")
    figures = _compute(metric)
    _update(metric, [comparison(1, 2)])
    metric.reset()
    _update(metric, [given])
    change = "look for random numbers, or draw them from a generator with a seed"
    expect_same(_compute(metric), figures, what="the same figures again", change=change)


def _rows(batch: int = 3, number: int = 3) -> list[Comparison]:
    together = comparison(batch, number)
    rows: list[Comparison] = []
    for row in range(batch):
        one = together.row(row)
        scenes, styles = together.scenes[row : row + 1], together.styles[row : row + 1]
        rows.append(_renamed(one, scenes, styles))
    return rows


def _renamed(given: Comparison, scenes: tuple[str, ...], styles: tuple[str, ...]) -> Comparison:
    assert given.style is not None
    index = int(styles[0].rpartition("_")[2])
    text = given.style.text[index : index + 1] if given.style.text else None
    return replace(given, scenes=scenes, styles=styles, style=replace(given.style, names=styles, text=text))


def _figures(plugin: Plugin) -> dict[str, Tensor]:
    """Those of :func:`_rows`, computed once."""
    return plugin.once("figures", lambda: _computed(plugin, _rows()))


def _computed(plugin: Plugin, rows: list[Comparison]) -> dict[str, Tensor]:
    metric = plugin.build()
    _update(metric, rows)
    return _compute(metric)


def _update(metric: Metric, rows: list[Comparison]) -> None:
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")  # of too few images for a figure, which is the point here
        for row in rows:
            batch, number, _, height, width = row.content.shape
            what = f"`update` with {batch} scene(s), {number} view(s) of {height}x{width} pixels"
            with attempt(what, change="make it work for any number of scenes, views and pixels"):
                metric.update(row)


def _compute(metric: Metric) -> dict[str, Tensor]:
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")
        with attempt("`compute`", change="return nan with a warning where there is too little"):
            return metric.compute()


CHECKS: tuple[Check, ...] = (
    Check(figures_are_declared, needed=True),
    Check(too_little_is_not_an_error),
    Check(reset_forgets),
    Check(order_does_not_matter),
    Check(copies_go_on),
    Check(processes_can_be_merged),
    Check(inputs_are_left_alone),
)
