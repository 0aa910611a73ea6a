#!/usr/bin/env bash
# Lightning 2.6.6: the mean that `self.log` makes of pictures of several sizes is weighted by their height, silently.
#
# A picture a batch, as of a DataLoader with `batch_size=None`, for sizes differ; `self.log("score", value)` in
# `validation_step`, or with `on_epoch=True` in `training_step`. Scores 0.2 and 0.8 of pictures of 400 and 100 rows:
#   a batch                                          mean of the epoch
#   a tensor, 3 x H x W                              0.5
#   a tensor, H x W x 3                              0.32: 400 and 100 are taken for sizes of batches
#   {"name": "chair", "image": H x W x 3}            0.32
#   {"points": 900 x 3, then 100 x 3}                0.26
#   {"points": 900 x 3, "image": 3 x H x W}          0.26, with a warning of an ambiguous collection
#   a torchmetrics 1.9.0 metric that is logged       0.5
# The first number of a batch's first tensor counts for its size. Give `batch_size=1` to `self.log`.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 lightning==2.6.6 torchmetrics==1.9.0 numpy==2.4.6 setuptools==80.9.0
env/bin/python - <<'PYTHON'
import logging
import warnings

import lightning
import torch
from torch.utils.data import DataLoader
from torchmetrics import MeanMetric

logging.getLogger("lightning.pytorch").setLevel(logging.ERROR)
SCORES, ROWS, POINTS = (0.2, 0.8), (400, 100), (900, 100)


class Scored(lightning.LightningModule):
    def __init__(self, size=None, metric=False):
        super().__init__()
        self.weight = torch.nn.Parameter(torch.zeros(1))
        self.size = size
        self.means = torch.nn.ModuleDict({name: MeanMetric() for name in ("fit", "valid")} if metric else {})

    def scored(self, name, index):
        value = torch.tensor(SCORES[index])
        if self.means:
            self.means[name](value)
            value = self.means[name]
        self.log(name, value, on_step=False, on_epoch=True, batch_size=self.size)

    def training_step(self, batch, index):
        self.scored("fit", index)
        return self.weight.sum()

    def validation_step(self, batch, index):
        self.scored("valid", index)

    def configure_optimizers(self):
        return torch.optim.SGD(self.parameters(), 0.1)


def epoch(batches, size=None, metric=False):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        trainer = lightning.Trainer(
            logger=False, enable_checkpointing=False, enable_progress_bar=False, enable_model_summary=False,
            accelerator="cpu", max_epochs=1,
        )
        loader = DataLoader(batches, batch_size=None)
        trainer.fit(Scored(size, metric), loader, loader)
    found = {name: value.item() for name, value in trainer.callback_metrics.items()}
    assert abs(found["fit"] - found["valid"]) < 1e-6
    return found["valid"], any("batch_size" in str(warning.message) for warning in caught)


first = [torch.zeros(3, rows, 300) for rows in ROWS]
last = [torch.zeros(rows, 300, 3) for rows in ROWS]
named = [{"name": "chair", "image": picture} for picture in last]
points = [{"points": torch.zeros(count, 3)} for count in POINTS]
both = [{**cloud, "image": picture} for cloud, picture in zip(points, first)]
for title, batches, options, expected in (
    ("3 x H x W", first, {}, (0.5, False)),
    ("H x W x 3", last, {}, (0.32, False)),
    ("name and image", named, {}, (0.32, False)),
    ("points", points, {}, (0.26, False)),
    ("points and image", both, {}, (0.26, True)),
    ("a metric", last, {"metric": True}, (0.5, False)),
    ("batch_size=1", both, {"size": 1}, (0.5, False)),
):
    mean, warned = epoch(batches, **options)
    print(f"{title:17} {mean:.3f}, {'a warning' if warned else 'no warning'}")
    assert abs(mean - expected[0]) < 1e-5 and warned == expected[1]
PYTHON
echo "as described"
