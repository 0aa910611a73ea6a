"""Metrics where people use those of torchmetrics."""

import warnings

import lightning.pytorch as pl
import pytest
import torch
from torch import nn
from torchmetrics import MetricCollection
from torchmetrics.wrappers import BootStrapper, MetricTracker, MinMaxMetric

from anystyle.metrics import PSNR, SSIM, ArtFID

STEPS = [(torch.full((8, 3, 16, 16), step / 10), torch.zeros(8, 3, 16, 16)) for step in (1, 2)]
DECIBELS = 20.0, 13.9794  # of each step


class Validated(pl.LightningModule):
    """Logs a metric, a collection of some and one with several scores."""

    def __init__(self):
        super().__init__()
        self.layer, self.psnr = nn.Linear(1, 1), PSNR()
        self.several = MetricCollection({"psnr": PSNR(), "ssim": SSIM()}, prefix="val/")
        self.fid = ArtFID(weights="stand_in")

    def validation_step(self, batch):
        preds, target = (images[0] for images in batch)
        self.psnr.update(preds, target)
        self.log("psnr", self.psnr)
        self.several.update(preds=preds, target=target)
        self.log_dict(self.several)
        self.fid.update(preds, target, target)

    def on_validation_epoch_end(self):
        self.log_dict(self.fid.scores())


@pytest.mark.filterwarnings("ignore")
def test_lightning_logs_them():
    off = dict.fromkeys(("logger", "enable_checkpointing", "enable_progress_bar", "enable_model_summary"), False)
    trainer = pl.Trainer(accelerator="cpu", **off)
    (logged,) = trainer.validate(Validated(), torch.utils.data.DataLoader(STEPS), verbose=False)
    assert set(logged) == {"psnr", "val/psnr", "val/ssim", *ArtFID(weights="stand_in").better}
    assert logged["psnr"] == logged["val/psnr"] == pytest.approx(sum(DECIBELS) / 2, abs=1e-4)


def test_wrappers_take_them(tmp_path):
    torch.manual_seed(0)
    extremes, bootstrap, tracker = MinMaxMetric(PSNR()), BootStrapper(PSNR(), num_bootstraps=4), MetricTracker(PSNR())
    for step, expected in zip(STEPS, DECIBELS, strict=True):
        tracker.increment()
        for metric in (bootstrap, tracker):
            metric.update(*step)
        assert extremes(*step)["raw"] == pytest.approx(expected, abs=1e-4)
    assert 13 < bootstrap.compute()["mean"] < 21
    assert tracker.best_metric(return_step=True) == (pytest.approx(20, abs=1e-4), 0)
    with warnings.catch_warnings(action="ignore"):  # of matplotlib
        figure, _ = tracker.plot()
        figure.savefig(tmp_path / "plot.png")
        MetricCollection([PSNR(), SSIM()]).plot(val=[{"PSNR": torch.tensor(1.0), "SSIM": torch.tensor(0.5)}])
        PSNR().plot(torch.tensor(1.0))
    assert {"max", "min"} < extremes.compute().keys()
