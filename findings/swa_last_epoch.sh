#!/usr/bin/env bash
# Lightning 2.6.6, `StochasticWeightAveraging`: the last epoch is trained and thrown away; stopped early, all averaging.
#
# A weight that each epoch makes one larger, so that after epoch n it is n; 10 epochs, swa_lrs equal to the rate. What
# the model has after `fit`, and the mean of what the epochs in question end with:
#   swa_epoch_start=0.8           8.0: the mean of 7, 8, 9      8, 9, 10 by torch.optim.swa_utils: 9.0
#   swa_epoch_start=9             8.5: of 8 and 9               9 and 10: 9.5
#   swa_epoch_start=1             4.5: of 0 to 9: the untrained model is one of ten
#   0.8, stopped by a callback (`trainer.should_stop`, as EarlyStopping does) after epoch 9     9.0, the last weights:
#                                 nothing is averaged
# The callback adds the weights at the beginning of an epoch. No warning. Take `WeightAveraging` with a
# `should_update` that is true for epoch_idx >= 7: it averages what epochs end with, 9.0 here.
# Seen with PyTorch 2.13.0, SGD, one batch an epoch.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 lightning==2.6.6 numpy==2.4.6 setuptools==80.9.0
env/bin/python - <<'PYTHON'
import logging
import warnings

import lightning
import torch
from lightning.pytorch.callbacks import Callback, StochasticWeightAveraging
from torch.optim.swa_utils import AveragedModel
from torch.utils.data import DataLoader

for name in ("lightning.pytorch", "lightning.fabric"):
    logging.getLogger(name).setLevel(logging.WARNING)


class Counting(lightning.LightningModule):
    def __init__(self):
        super().__init__()
        self.weight = torch.nn.Parameter(torch.zeros(1))

    def training_step(self, batch, index):
        return -self.weight.sum()

    def configure_optimizers(self):
        return torch.optim.SGD(self.parameters(), 1.0)


class Watched(Callback):
    def __init__(self, stop):
        self.stop, self.ends = stop, []

    def on_train_epoch_end(self, trainer, module):
        self.ends.append(module.weight.item())
        trainer.should_stop = trainer.current_epoch + 1 == self.stop


def fit(start, stop=None):
    model, watched = Counting(), Watched(stop)
    averaging = StochasticWeightAveraging(swa_lrs=1.0, swa_epoch_start=start, annealing_epochs=1)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        trainer = lightning.Trainer(
            logger=False, enable_checkpointing=False, enable_progress_bar=False, enable_model_summary=False,
            accelerator="cpu", max_epochs=10, callbacks=[watched, averaging],
        )
        trainer.fit(model, DataLoader(torch.zeros(1, 1)))
    told = [str(warning.message) for warning in caught if "averag" in str(warning.message).lower()]
    return model.weight.item(), watched.ends, told


for start, stop, expected, first in ((0.8, None, 8.0, 8), (9, None, 8.5, 9), (1, None, 4.5, 1), (0.8, 9, 9.0, 8)):
    found, ends, told = fit(start, stop)
    averaged = AveragedModel(torch.nn.Linear(1, 1, bias=False))
    for value in ends[first - 1 :]:
        model = torch.nn.Linear(1, 1, bias=False)
        model.weight.data.fill_(value)
        averaged.update_parameters(model)
    right = averaged.module.weight.item()
    print(f"swa_epoch_start={start}, stopped after {stop}: epochs end with {ends}; {found}, right {right}; {told}")
    assert found == expected and not told and ends == [float(n) for n in range(1, (stop or 10) + 1)]
    assert abs(right - sum(ends[first - 1 :]) / len(ends[first - 1 :])) < 1e-5
PYTHON
echo "as described"
