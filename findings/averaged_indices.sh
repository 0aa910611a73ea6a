#!/usr/bin/env bash
# Moving averages of weights, PyTorch 2.13.0 and Lightning 2.6.6: tables of indices in the model change, by one each.
#
# With `use_buffers=True`, the default of Lightning's `EMAWeightAveraging`, buffers of integers are averaged as weights
# are: decay * a + (1 - decay) * a is a little less than a for some a, and is cut to an integer. A buffer of the numbers
# 0 to 4095 that never changes, such as the indices of relative positions in windows, after one training:
#   decay 0.9: 1144 of them are one less, among them 3, 6 and 7      0.95: 774, 13 and up      0.99, 0.999: none
#         0.9995: 1216, 3 and up                                     0.9999: 846, 11 and up    0.98, 0.998: none
# The model that `fit` leaves has them. BatchNorm's `num_batches_tracked` is 1 after 20 steps (10 with 0.9), and a mask
# of booleans that changes ends as True everywhere. No warning. `use_buffers=False` takes all buffers as they are at the
# last step, BatchNorm's means among them.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 lightning==2.6.6 numpy==2.4.6 setuptools==80.9.0
env/bin/python - 2> log.txt <<'PYTHON'
import warnings

import torch
from lightning import LightningModule, Trainer
from lightning.pytorch.callbacks import EMAWeightAveraging
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from torch.utils.data import DataLoader, TensorDataset

numbers = torch.arange(4096)


class Model(LightningModule):
    def __init__(self):
        super().__init__()
        self.layer = torch.nn.Linear(4, 2)
        self.norm = torch.nn.BatchNorm1d(2)
        self.register_buffer("indices", numbers.clone())
        self.register_buffer("mask", torch.tensor([True, False]))

    def training_step(self, batch, number):
        self.mask.logical_not_()
        return self.norm(self.layer(batch[0])).square().mean()

    def configure_optimizers(self):
        return torch.optim.SGD(self.parameters(), lr=0.01)


def trained(**options):
    torch.manual_seed(0)
    model = Model()
    quiet = ("logger", "enable_checkpointing", "enable_progress_bar", "enable_model_summary")
    options = {"callbacks": [EMAWeightAveraging(**options)], **dict.fromkeys(quiet, False)}
    trainer = Trainer(max_steps=20, accelerator="cpu", **options)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        trainer.fit(model, DataLoader(TensorDataset(torch.randn(200, 4)), batch_size=10))
    assert not [warning for warning in caught if "buffer" in str(warning.message)]
    return model


expected = {0.9: (1144, 3), 0.95: (774, 13), 0.98: (0, None), 0.99: (0, None), 0.998: (0, None), 0.999: (0, None)}
expected |= {0.9995: (1216, 3), 0.9999: (846, 11)}
for decay, (count, first) in expected.items():
    model = trained(decay=decay)
    changed = (model.indices != numbers).nonzero().flatten()
    print(f"decay {decay}: {len(changed)} changed, {changed[:6].tolist()}, by {(model.indices - numbers).min()}")
    print(f"    batches {model.norm.num_batches_tracked}, mask {model.mask.tolist()}")
    assert len(changed) == count and (not count or (changed[0] == first and (model.indices - numbers).min() == -1))
    assert model.norm.num_batches_tracked == (10 if decay == 0.9 else 1) and model.mask.all()
    plain = Model()
    averaged = AveragedModel(plain, multi_avg_fn=get_ema_multi_avg_fn(decay), use_buffers=True)
    for _ in range(2):
        averaged.update_parameters(plain)
    assert torch.equal(averaged.module.indices, model.indices)
model = trained(decay=0.9999, use_buffers=False)
print(f"without: {(model.indices != numbers).sum()} changed, batches {model.norm.num_batches_tracked}")
assert torch.equal(model.indices, numbers) and model.norm.num_batches_tracked == 20
PYTHON
echo "as described"
