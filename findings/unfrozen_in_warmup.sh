#!/usr/bin/env bash
# Layers unfrozen during a warm-up, PyTorch 2.13.0 and Lightning 2.6.6: their rate becomes a multiple of what was given.
#
# Most schedulers go on from the rate that a group has, by the ratio of two steps. A group that is added at step 10 of
# `LinearLR` from 0.001 to 1 over 100 steps, where the factor is 0.011, has all of what is left of the warm-up put on
# it. Head and backbone, rates of 1e-2 and 1e-3 given, after the warm-up:
#   Lightning, `BaseFinetuning.unfreeze_and_add_param_group(..., lr=1e-3)`, epoch 1     0.010 and 0.0099, ten times 1e-3
#   the same without `lr`: a tenth of the head's rate, in all steps                     0.010 and 0.0010
#   PyTorch alone, a warm-up of 1000 steps, added at step 10                            0.010 and 0.0910, 91 times
#   `ConstantLR(factor=0.1)`, added before its end                                      0.010 and 0.0100, ten times
# `LambdaLR`, `MultiplicativeLR`, `OneCycleLR`, `CyclicLR` and `CosineAnnealingWarmRestarts` raise. `StepLR`,
# `ExponentialLR` and `CosineAnnealingLR` begin with the rate that was given.
# No warning. Add all groups before the scheduler, with frozen parameters: those without a gradient are left alone.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 lightning==2.6.6 numpy==2.4.6 setuptools==80.9.0
env/bin/python - 2> log.txt <<'PYTHON'
import warnings

import torch
from lightning import LightningModule, Trainer
from lightning.pytorch.callbacks import BaseFinetuning
from torch.optim import lr_scheduler
from torch.utils.data import DataLoader, TensorDataset


class Model(LightningModule):
    def __init__(self):
        super().__init__()
        self.backbone, self.head = torch.nn.Linear(4, 4), torch.nn.Linear(4, 1)
        self.rates = []

    def training_step(self, batch, number):
        self.rates.append([group["lr"] for group in self.optimizers().param_groups])
        return self.head(self.backbone(batch[0])).square().mean()

    def configure_optimizers(self):
        optimizer = torch.optim.SGD(self.head.parameters(), lr=1e-2)
        scheduler = lr_scheduler.LinearLR(optimizer, 0.001, 1.0, total_iters=100)
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": scheduler, "interval": "step"}}


class Unfreeze(BaseFinetuning):
    def __init__(self, **options):
        super().__init__()
        self.options = options

    def freeze_before_training(self, model):
        self.freeze(model.backbone)

    def finetune_function(self, model, epoch, optimizer):
        if epoch == 1:
            self.unfreeze_and_add_param_group(model.backbone, optimizer, **self.options)


for options, expected in (({"lr": 1e-3}, 0.0099), ({}, 0.0010)):
    torch.manual_seed(0)
    model = Model()
    quiet = ("logger", "enable_checkpointing", "enable_progress_bar", "enable_model_summary")
    trainer = Trainer(max_epochs=12, accelerator="cpu", callbacks=[Unfreeze(**options)], **dict.fromkeys(quiet, False))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        trainer.fit(model, DataLoader(TensorDataset(torch.randn(100, 4)), batch_size=10))
    assert not [warning for warning in caught if "rate" in str(warning.message) or "group" in str(warning.message)]
    print(f"Lightning, {options}: step 10 {model.rates[10]}, at the end {model.rates[-1]}")
    assert len(model.rates[9]) == 1 and len(model.rates[10]) == 2
    assert abs(model.rates[-1][0] - 0.01) < 1e-9 and abs(model.rates[-1][1] - expected) < 1e-4


def parameter():
    return [torch.nn.Parameter(torch.zeros(1))]


def run(make, before, after):
    """Rates of a group that is there from the start, and of one that is added after some steps."""
    optimizer = torch.optim.Adam(parameter(), lr=1e-2)
    scheduler = make(optimizer)
    for _ in range(before):
        optimizer.step()
        scheduler.step()
    optimizer.add_param_group({"params": parameter(), "lr": 1e-3})
    try:
        for _ in range(after):
            optimizer.step()
            scheduler.step()
    except (ValueError, KeyError):
        return "raises"
    return [group["lr"] for group in optimizer.param_groups]


with warnings.catch_warnings():
    warnings.simplefilter("error")
    long = run(lambda optimizer: lr_scheduler.LinearLR(optimizer, 0.001, 1.0, total_iters=1000), 10, 1000)
    constant = run(lambda optimizer: lr_scheduler.ConstantLR(optimizer, 0.1, total_iters=5), 3, 5)
    print(f"LinearLR {long}, ConstantLR {constant}")
    assert abs(long[0] - 1e-2) < 1e-9 and 0.0900 < long[1] < 0.0920
    assert all(abs(rate - 1e-2) < 1e-9 for rate in constant)
    loud = {
        "LambdaLR": lambda optimizer: lr_scheduler.LambdaLR(optimizer, lambda step: 0.5**step),
        "MultiplicativeLR": lambda optimizer: lr_scheduler.MultiplicativeLR(optimizer, lambda step: 0.5),
        "OneCycleLR": lambda optimizer: lr_scheduler.OneCycleLR(optimizer, 1e-2, total_steps=20),
        "CyclicLR": lambda optimizer: lr_scheduler.CyclicLR(optimizer, 1e-3, 1e-2, cycle_momentum=False),
        "CosineAnnealingWarmRestarts": lambda optimizer: lr_scheduler.CosineAnnealingWarmRestarts(optimizer, 10),
    }
    found = {name: run(make, 3, 1) for name, make in loud.items()}
    print(found)
    assert set(found.values()) == {"raises"}
    for name, make in {
        "StepLR": lambda optimizer: lr_scheduler.StepLR(optimizer, 5, 0.5),
        "ExponentialLR": lambda optimizer: lr_scheduler.ExponentialLR(optimizer, 0.999),
        "CosineAnnealingLR": lambda optimizer: lr_scheduler.CosineAnnealingLR(optimizer, 1000),
    }.items():
        rates = run(make, 2, 1)
        print(name, rates)
        assert abs(rates[1] - 1e-3) < 2e-6
    optimizer = torch.optim.Adam([{"params": parameter()}, {"params": parameter(), "lr": 1e-3}], lr=1e-2)
    scheduler = lr_scheduler.LinearLR(optimizer, 0.001, 1.0, total_iters=100)
    for _ in range(100):
        optimizer.step()
        scheduler.step()
    print("both from the start:", [group["lr"] for group in optimizer.param_groups])
    assert [round(group["lr"], 9) for group in optimizer.param_groups] == [1e-2, 1e-3]
    assert not optimizer.state and float(optimizer.param_groups[1]["params"][0].detach()) == 0
PYTHON
echo "as described"
