"""What a metric promises: see :class:`anystyle.contracts.Metric`."""

import copy
import pickle
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache

import torch
import torch.nn.functional as F
from torch import Tensor

from anystyle.contracts import Metric
from anystyle.testing import asserts
from anystyle.testing.inputs import SIZE, comparison, generator, style_encoder
from anystyle.testing.subject import Subject
from anystyle.testing.toy.correspondence import ToyCorrespondence
from anystyle.testing.toy.scenes import ToyScenes
from anystyle.types import Comparison, Views


def test_scores_are_declared(plugin: Subject[Metric]) -> None:
    """``better`` says of each score whether higher or lower is better; ``compute`` returns one, or these by name."""
    better = getattr(plugin.cls, "better", None)
    declared = isinstance(better, Mapping) and better and set(better.values()) <= {"higher", "lower"}
    assert declared, f"better={better!r}; declare a class attribute such as {{'art_fid': 'lower'}}"
    scores = _scores(plugin)
    with warnings.catch_warnings(action="ignore"):  # of too few images
        several = isinstance(build(plugin).compute(), dict)
    assert several == (len(scores) > 1), "`compute` of one score returns a tensor, for `self.log(name, metric)`"
    assert sorted(scores) == sorted(better or ()), f"`compute` returned {sorted(scores)}, not {sorted(better or ())}"
    for name, value in scores.items():
        scalar = isinstance(value, Tensor) and value.shape == () and value.is_floating_point()
        assert scalar, f"`{name}` is {value!r}, not a floating-point tensor without axes"


def test_too_little_is_not_an_error(plugin: Subject[Metric]) -> None:
    """Before any update the scores are ``nan``; after one image they are ``nan`` or numbers, never an error."""
    scores = _computed(build(plugin), [])
    assert all(bool(value.isnan()) for value in scores.values()), f"{scores} before any update, not nan"
    _computed(build(plugin), _rows(batch=1, number=1))


def test_order_does_not_matter(plugin: Subject[Metric]) -> None:
    """Taking in scenes in another order, or in batches of any sizes, gives the same scores."""
    rows, unequal = _rows(), "in batches of two and one"
    batches = {"in another order": rows[::-1], "as one batch": [comparison(3)], unequal: [comparison(2), rows[2]]}
    for what, given in batches.items():
        asserts.close(_computed(build(plugin), given), _scores(plugin), f"the scores of the same scenes {what}")


def test_copies_and_processes_can_be_merged(plugin: Subject[Metric]) -> None:
    """A clone or pickled copy continues from where it is, and two metrics merged give what one gives."""
    rows, metric, other = _rows(), build(plugin), build(plugin)
    _computed(metric, rows[:2])  # which is a look at the scores so far, and changes nothing
    _update(other, rows[2:])
    for make in (copy.deepcopy, lambda given: pickle.loads(pickle.dumps(given))):
        copied: Metric = make(metric)
        asserts.close(_computed(copied, rows[2:]), _scores(plugin), "the scores of a copy that took in the rest")
    metric.merge_state(other)
    asserts.close(_computed(metric, []), _scores(plugin), "the scores of two merged metrics; see `add_state`")


def test_inputs_are_left_alone(plugin: Subject[Metric]) -> None:
    """What was compared is left as it was, and after ``reset`` nothing of it counts."""
    given, metric = comparison(2), build(plugin)
    before = given.map(Tensor.clone)
    scores = _computed(metric, [given])
    asserts.same(given, before, "the comparison after `update`")
    _computed(metric, _rows())
    metric.reset()
    asserts.same(_computed(metric, [given]), scores, "the scores of a metric that was reset against a new one's")


def test_the_ideal_is_not_the_worst(plugin: Subject[Metric]) -> None:
    """By ``better`` a result that is the style image, or the photograph, is not the worst for what reads that.

    Nor are photographs of other views the best.
    """
    given, scenes = comparison(2), ToyScenes(size=SIZE)
    assert given.style is not None and given.style.image is not None
    world = Views.cat([scenes.read(scene, range(3)) for scene in range(2)])
    style = F.interpolate(given.style.image, SIZE)[:, None].expand_as(world.images)
    noise = torch.rand(world.images.shape, generator=generator(3))
    slow = replace(given, content=world.images, cameras=world.cameras, depth=world.depth, seconds=torch.full((2,), 9.0))
    photographs, noisy = replace(slow, stylized=world.images, seconds=torch.zeros(2)), replace(slow, stylized=noise)
    results = {
        "style image": replace(slow, stylized=style),
        "photographs": photographs,
        "photographs of other views": replace(photographs, stylized=world.images.roll(1, dims=1)),
        "inverse": replace(slow, stylized=1 - world.images.roll(1, dims=1)),
        "noise": noisy,
        "noise in another style": replace(noisy, style=replace(given.style, image=given.style.image.flip(1, 3))),
        "noise of another scene": replace(photographs, stylized=noise, content=noise.flip(1), cameras=given.cameras),
    }
    scores = {what: _computed(build(plugin), [result]) for what, result in results.items()}
    for name, better in build(plugin).better.items():
        merit = {what: float(each[name]) * (1 if better == "higher" else -1) for what, each in scores.items()}
        style, scene = merit.pop("noise in another style"), merit.pop("noise of another scene")
        mixed = merit.pop("photographs of other views") > max(merit.values()) + 1e-5
        assert not mixed, f"`{name}` is best where each view is the photograph of another one"
        ideal = "style image" if style != merit["noise"] else "photographs" if scene != merit["noise"] else "noise"
        worst = ideal != "noise" and merit.pop(ideal) < min(merit.values())
        assert not worst, f"of all results the {ideal} has the worst `{name}`, for {better} is better; is it reversed?"


def build(plugin: Subject[Metric]) -> Metric:
    """A new metric, with what the framework passes to it."""
    return plugin.build(style_encoder=style_encoder(), correspondence=ToyCorrespondence())


def _rows(batch: int = 3, number: int = 3) -> list[Comparison]:
    """The scenes of a batch one by one, with names and texts of their own."""
    together, style = comparison(batch, number), comparison(batch, number).style
    assert style is not None and style.text is not None
    rows: list[Comparison] = []
    for row in range(batch):
        scene, name, text = ((names[row],) for names in (together.scenes, together.styles, style.text))
        given = replace(style.row(row), names=name, text=text)
        rows.append(replace(together.row(row), scenes=scene, styles=name, style=given))
    return rows


@cache
def _scores(plugin: Subject[Metric]) -> dict[str, Tensor]:
    return _computed(build(plugin), _rows())


@torch.no_grad()
def _update(metric: Metric, rows: Sequence[Comparison]) -> None:
    with warnings.catch_warnings(action="ignore"):  # of too few images for a score
        for row in rows:
            metric.update(row)


@torch.no_grad()
def _computed(metric: Metric, rows: Sequence[Comparison]) -> dict[str, Tensor]:
    _update(metric, rows)
    with warnings.catch_warnings(action="ignore"):
        value = metric.compute()
    return value if isinstance(value, dict) else dict.fromkeys(metric.better, value)
