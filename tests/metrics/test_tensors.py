"""Metrics as torchmetrics' own are used: with tensors, in collections, by their names."""

import copy
import inspect
import pickle
import subprocess
import sys
import warnings
from typing import Any

import pytest
import torch
import torchmetrics

import anystyle.metrics
from anystyle.metrics import KID, LPIPS, PSNR, SSIM, ArtFID, ColorMatch, StyleRetrieval, WarpConsistency
from anystyle.registry.catalog import catalog
from anystyle.testing.inputs import comparison, images
from anystyle.testing.metric import build
from anystyle.testing.subject import subject
from anystyle.testing.toy.metric import ToyMetric
from anystyle.types import Comparison, Style
from anystyle.vision.feature_cache import CACHE

PREDS, TARGET, STYLE = (images(3, (48, 40), seed=seed) for seed in (1, 2, 3))


def given():
    """All that a comparison of two scenes holds, by the names of ``Comparison.from_images``."""
    whole = comparison(2, 2)
    seconds = torch.tensor([1.0, 2.0])
    known = {"cameras": whole.cameras, "depth": whole.depth, "scenes": ("room",) * 2, "numbers": (3, 4)}
    return {"preds": whole.stylized, "target": whole.content, "style": whole.style.image, "seconds": seconds, **known}


def computed(metric):
    with warnings.catch_warnings(action="ignore"):  # of few images
        return metric.compute() if isinstance(metric, torchmetrics.MetricCollection) else metric.scores()


@pytest.mark.parametrize("name", catalog().names("metric"))
def test_tensors_are_a_comparison(name, tmp_path):
    with warnings.catch_warnings(record=True, action="always") as reasons:
        values = _of_tensors(name, tmp_path)
    assert reasons or any(not value.isnan() for value in values)


def _of_tensors(name, tmp_path):
    cls = catalog().find("metric", name).load()
    assert getattr(anystyle.metrics, cls.__name__) is cls
    tensors, metric = given(), build(subject("metric", cls, cls.example(tmp_path)))
    metric.update(Comparison.from_images(**tensors))
    expected = computed(metric)
    metric.reset()
    CACHE.clear()
    with torch.autocast("cpu"):
        metric.update(**{name: tensors[name] for name in inspect.signature(cls.update).parameters if name != "self"})
        torch.testing.assert_close(computed(metric), expected, rtol=0, atol=0, equal_nan=True)
    return expected.values()


def test_the_door_is_cheap_and_says_what_it_lacks():
    code = "import sys, anystyle.metrics; print('torch' in sys.modules, 'CSD' in dir(anystyle.metrics))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "True"]
    with pytest.raises(AttributeError, match="has no attribute 'Nothing'"):
        _ = anystyle.metrics.Nothing
    every = dict[str, Any]()
    exec("from anystyle.metrics import *", every)
    assert every["PSNR"] is PSNR and "CSD" in every


def test_one_update_of_a_collection_serves_all():
    metrics = [PSNR(), SSIM(), ColorMatch(), KID(weights="stand_in", size=75), StyleRetrieval(), ToyMetric()]
    together = torchmetrics.MetricCollection(metrics)
    together.update(preds=PREDS, target=TARGET, style=STYLE)
    for copied in (together.clone(), copy.deepcopy(together), pickle.loads(pickle.dumps(together))):
        found = computed(copied)
        for metric in metrics:
            alone = copy.deepcopy(metric)
            alone.reset()
            names = inspect.signature(type(metric).update).parameters
            rest = {"style": STYLE} if "style" in names else {}
            alone.update(PREDS, **({"target": TARGET} if "target" in names else {}), **rest)
            scores = computed(alone)
            for name, value in scores.items():
                torch.testing.assert_close(found[name if len(scores) > 1 else type(metric).__name__], value)


def test_metrics_that_agree_at_first_are_not_one():
    """The state of each is 0 after equal images; torchmetrics would update one of them only from then on."""
    nets = {"alex": LPIPS(size=None, weights="stand_in"), "small": LPIPS(size=32, weights="stand_in")}
    together = torchmetrics.MetricCollection(nets)
    together.update(preds=PREDS, target=PREDS)
    together.update(preds=PREDS, target=TARGET)
    assert len(together.compute_groups) == 2
    alone = LPIPS(size=32, weights="stand_in")
    alone.update(PREDS, PREDS)
    alone.update(PREDS, TARGET)
    assert float(together.compute()["small"]) == pytest.approx(float(alone.compute()))


def test_a_call_gives_the_scores_of_what_it_took_in():
    metric = PSNR()
    black = torch.zeros(2, 3, 8, 8)
    assert metric(black, black + 0.1) == pytest.approx(20) and metric(black, black + 0.01) == pytest.approx(40)
    assert metric.compute() == pytest.approx(30)


def test_one_style_is_of_all_and_texts_are_styles():
    one, each = ColorMatch(), ColorMatch()
    assert one(PREDS, STYLE[:1]) == each(PREDS, STYLE[:1].repeat(3, 1, 1, 1))
    assert Comparison.from_images(PREDS, style=("waves", "stone", "ink")).style.text == ("waves", "stone", "ink")
    with pytest.raises(ValueError, match="style has 2 names; expected one for each of 3 scenes"):
        Comparison.from_images(PREDS, style=("waves", "stone"))


@pytest.mark.parametrize(
    ("metric", "tensors", "message"),
    [
        (PSNR(), {"preds": 255 * PREDS, "target": TARGET}, r"preds with values from .* \[0, 1\]; preds / 255"),
        (PSNR(), {"preds": PREDS, "target": 2 * TARGET - 1}, r"target with values from -.*\(target \+ 1\) / 2"),
        (PSNR(), {"preds": (255 * PREDS).byte(), "target": TARGET}, r"preds is uint8 .* \.float\(\) / 255"),
        (PSNR(), {"preds": PREDS.movedim(1, -1), "target": TARGET}, r"preds is .*movedim\(-1, -3\)"),
        (PSNR(), {"preds": PREDS[0], "target": TARGET}, r"preds is .*\[None\]"),
        (PSNR(), {"preds": PREDS, "target": torch.full_like(TARGET, torch.nan)}, "target with values from nan"),
        (PSNR(), {"preds": PREDS, "target": TARGET[:2]}, "target is .*expected the shape of preds"),
        (PSNR(), {"preds": PREDS[:0], "target": TARGET}, "preds is .*expected at least one image"),
        (PSNR(), {"preds": PREDS}, r"PSNR\.update\(self, preds, target\): missing a required argument: 'target'"),
        (ColorMatch(), {"preds": PREDS}, "missing a required argument: 'style'"),
        (ColorMatch(), {"preds": PREDS, "style": STYLE[None]}, r"style is .*\[B, 3, h, w\]"),
        (ColorMatch(), {"preds": PREDS, "style": STYLE[:2]}, r"Style\.image is .*\[B=3, 3, h, w\]"),
        (StyleRetrieval(), {"preds": PREDS, "style": STYLE, "scenes": ("room",)}, "scenes has 1 names"),
        (ToyMetric(), {"preds": PREDS}, "missing a required argument: 'target'"),
        (
            ToyMetric(),
            {"preds": PREDS, "target": TARGET, "numbers": (0, 1)},
            "numbers has 2 numbers; .* each of 1 views",
        ),
        (ColorMatch(), {"preds": PREDS, "style": Style(STYLE * torch.nan)}, "style with values from nan"),
    ],
)
def test_what_is_wrong_is_named(metric, tensors, message):
    with pytest.raises((ValueError, TypeError), match=message):
        metric.update(**tensors)


def test_what_each_takes_is_its_signature():
    assert list(inspect.signature(ArtFID.update).parameters) == ["self", "preds", "target", "style"]
    assert list(inspect.signature(WarpConsistency.update).parameters)[:4] == ["self", "preds", "target", "cameras"]
