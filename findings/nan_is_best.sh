#!/usr/bin/env bash
# torchmetrics 1.9.0, `MetricTracker`: an epoch that diverged is the best one, whether more is better or less.
#
# Four epochs, of PSNR 10.5, 20.0, NaN and 14.0: `best_metric(return_step=True)` is NaN and epoch 2 with maximize=True
# and with maximize=False, by itself and in a collection. Losses of 0.3, 0.2 and then NaN, of which less is better:
#   MeanMetric of NaN alone          NaN, epoch 2
#   MeanMetric of NaN, NaN, 0.1      0.1, epoch 2: NaN is dropped, and one good batch of three is the epoch
#   MaxMetric of NaN alone           -inf, epoch 2
# The tracker does not warn; the aggregations say "Encountered `nan` values in tensor. Will be removed." Lightning
# 2.6.6's ModelCheckpoint takes epochs 1 and 0 for the four scores. Look at `compute_all()` before `best_metric`.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 torchmetrics==1.9.0 lightning==2.6.6 numpy==2.4.6 setuptools==80.9.0
env/bin/python - 2> log.txt <<'PYTHON'
import math
import warnings
from pathlib import Path

import torch
from lightning import LightningModule, Trainer
from lightning.pytorch.callbacks import ModelCheckpoint
from torch.utils.data import DataLoader
from torchmetrics import MetricCollection
from torchmetrics.aggregation import MaxMetric, MeanMetric
from torchmetrics.image import PeakSignalNoiseRatio
from torchmetrics.wrappers import MetricTracker

nan = float("nan")
errors = [0.3, 0.1, nan, 0.2]
picture = torch.full((1, 3, 8, 8), 0.5)
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    for maximize in (True, False):
        alone = MetricTracker(PeakSignalNoiseRatio(data_range=1.0), maximize=maximize)
        both = {"psnr": PeakSignalNoiseRatio(data_range=1.0), "again": PeakSignalNoiseRatio(data_range=1.0).clone()}
        among = MetricTracker(MetricCollection(both, compute_groups=False), maximize=[maximize, maximize])
        for error in errors:
            for tracker in (alone, among):
                tracker.increment()
                tracker.update(picture + error, picture)
        scores, (best, epoch) = alone.compute_all(), alone.best_metric(return_step=True)
        values, epochs = among.best_metric(return_step=True)
        print(f"maximize={maximize}: {scores.tolist()}, best {best}, epoch {epoch}; {values} {epochs}")
        assert torch.allclose(scores, torch.tensor([10.46, 20.0, nan, 13.98]), atol=0.01, equal_nan=True)
        assert math.isnan(best) and epoch == 2
        assert all(math.isnan(value) for value in values.values()) and set(epochs.values()) == {2}
assert not caught

with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    found = {}
    losses = ("mean", MeanMetric, [nan]), ("mixed", MeanMetric, [nan, nan, 0.1]), ("max", MaxMetric, [nan])
    for name, metric, values in losses:
        tracker = MetricTracker(metric(), maximize=False)
        for epoch in ([0.3], [0.2], values):
            tracker.increment()
            for value in epoch:
                tracker.update(value)
        found[name] = tracker.compute_all().tolist(), tracker.best_metric(return_step=True)
said = {str(warning.message) for warning in caught}
print(found, said)
assert len(said) == 1 and "nan" in said.pop()
assert math.isnan(found["mean"][1][0]) and found["mean"][1][1] == 2
assert abs(found["mixed"][1][0] - 0.1) < 1e-6 and found["mixed"][1][1] == 2
assert found["max"][1] == (-math.inf, 2)


class Model(LightningModule):
    def __init__(self):
        super().__init__()
        self.weight = torch.nn.Parameter(torch.zeros(1))

    def training_step(self, batch, number):
        return self.weight.sum()

    def validation_step(self, batch, number):
        self.log("score", scores[self.current_epoch])

    def configure_optimizers(self):
        return torch.optim.SGD(self.parameters(), lr=1.0)


for mode, expected in (("max", "epoch=1.ckpt"), ("min", "epoch=0.ckpt")):
    keep = ModelCheckpoint(monitor="score", mode=mode, dirpath=mode, filename="{epoch}")
    options = {"max_epochs": 4, "accelerator": "cpu", "callbacks": [keep], "num_sanity_val_steps": 0}
    quiet = dict.fromkeys(("logger", "enable_progress_bar", "enable_model_summary"), False)
    Trainer(**options, **quiet).fit(Model(), DataLoader(torch.zeros(2, 1)), DataLoader(torch.zeros(2, 1)))
    print(f"ModelCheckpoint, {mode}: {Path(keep.best_model_path).name}")
    assert Path(keep.best_model_path).name == expected
PYTHON
echo "as described"
