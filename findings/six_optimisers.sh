#!/usr/bin/env bash
# Lightning 2.6.6 with an optimiser for each of six properties, as trainers of Gaussians have: its steps are sixths.
#
# `global_step` counts calls of optimisers, not batches. With `automatic_optimization=False` and six of them, in place
# of one with six groups:
#                                                            one           six
#   Trainer(max_steps=3000)                                  3000 batches  500 batches
#   ModelCheckpoint(every_n_train_steps=500), up to there    6 files       2, of batches 250 and 500: it looks after
#                                                                          each batch, at multiples of 6
#   EMAWeightAveraging(update_every_n_steps=100)             30 updates    none: it asks at 5, 11, 17, ..., never at a
#                                                                          multiple of 100. What `fit` leaves, as the
#                                                                          average, are the weights it began with
#   rows of CSVLogger                                        by batches in both
# No warning of this. Give multiples of six for steps and files, and groups of one optimiser to whatever averages.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 lightning==2.6.6 numpy==2.4.6 setuptools==80.9.0
env/bin/python - 2> log.txt <<'PYTHON'
import csv
import logging

import lightning
import torch
from lightning.pytorch.callbacks import EMAWeightAveraging, ModelCheckpoint
from lightning.pytorch.loggers import CSVLogger

logging.getLogger("lightning.pytorch").setLevel(logging.WARNING)


class Scene(lightning.LightningModule):
    def __init__(self, optimisers):
        super().__init__()
        self.automatic_optimization = False
        self.properties = torch.nn.ParameterList(torch.ones(4) for _ in range(6))
        self.count, self.batches = optimisers, 0

    def configure_optimizers(self):
        groups = [{"params": [values]} for values in self.properties]
        return [torch.optim.Adam(part) for part in ([groups] if self.count == 1 else [[group] for group in groups])]

    def training_step(self, batch, index):
        optimisers = self.optimizers()
        optimisers = optimisers if self.count > 1 else [optimisers]
        loss = sum((values**2).sum() for values in self.properties)
        self.manual_backward(loss)
        for optimiser in optimisers:
            optimiser.step()
            optimiser.zero_grad()
        self.batches += 1
        self.log("loss", loss)

    def train_dataloader(self):
        return torch.utils.data.DataLoader(torch.zeros(5000, 1))


class Checkpoints(ModelCheckpoint):
    def _save_checkpoint(self, trainer, path):
        super()._save_checkpoint(trainer, path)
        self.saved = [*getattr(self, "saved", []), trainer.lightning_module.batches]


class Average(EMAWeightAveraging):
    updates = 0

    def should_update(self, **counts):
        due = super().should_update(**counts)
        self.updates += due
        return due


seen = {}
for count in (1, 6):
    scene, files = Scene(count), Checkpoints(f"files{count}", every_n_train_steps=500, save_top_k=-1)
    average = Average(decay=0.9, update_every_n_steps=100)
    logger = CSVLogger(".", name=f"log{count}")
    quiet = {"enable_progress_bar": False, "enable_model_summary": False}
    trainer = lightning.Trainer(max_steps=3000, callbacks=[files, average], logger=logger, accelerator="cpu", **quiet)
    trainer.fit(scene)
    with open(f"{logger.log_dir}/metrics.csv") as table:
        steps = [int(row["step"]) for row in csv.DictReader(table)][:2]
    mean = float(torch.cat(list(scene.properties)).detach().mean())
    seen[count] = scene.batches, trainer.global_step, files.saved, average.updates, steps
    print(f"{count}: batches, global_step, files at, updates, rows: {seen[count]}; weights {mean:.3f}")
    assert (mean == 1) == (count == 6)
assert seen[1] == (3000, 3000, [500, 1000, 1500, 2000, 2500, 3000], 30, [49, 99])
assert seen[6] == (500, 3000, [250, 500], 0, [49, 99])
PYTHON
cat log.txt
! grep -i -E "global_step|optimizers|max_steps|average" log.txt
echo "as described"
