#!/usr/bin/env bash
# torchmetrics 1.9.0, `MetricCollection`: two metrics that agree on the first update are one metric from then on.
#
# To save time, a collection compares the states of its metrics after the first update, and from then on updates one of
# those whose states are equal for all of them (`compute_groups=True`, the default). A first batch of pictures against
# themselves, as of a sanity check or an untrained branch that changes nothing, has SSIM 1 for any window: of two SSIMs,
# narrow and wide, the second then returns the first one's score to the end.
# Seen: 0.9736 and 0.9769 apart, 0.9736 and 0.9736 in a collection; without that batch, 0.9605 and 0.9654 in both. States
# are compared by their names and values, so that it goes for any two whose sums start alike. No warning; with
# `compute_groups=False` each is updated.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 torchmetrics==1.9.0 numpy==2.4.6
env/bin/python -W error - <<'PYTHON'
import torch
from torchmetrics import MetricCollection
from torchmetrics.image import StructuralSimilarityIndexMeasure

generator = torch.Generator().manual_seed(1)
picture = torch.rand(2, 3, 64, 64, generator=generator)
noisy = (picture + 0.2 * torch.rand(2, 3, 64, 64, generator=generator)).clamp(0, 1)


def scores(batches, **options):
    narrow, wide = (StructuralSimilarityIndexMeasure(sigma=sigma, data_range=1.0) for sigma in (0.8, 2.5))
    metrics = MetricCollection({"narrow": narrow, "wide": wide}, **options)
    for batch in batches:
        metrics.update(*batch)
    return {name: round(float(value), 4) for name, value in metrics.compute().items()}


others = [(picture, noisy), (noisy, picture)]
batches = {"first batch unlike": others, "first batch alike": [(picture, picture.clone()), *others]}
found = {name: (scores(given, compute_groups=False), scores(given)) for name, given in batches.items()}
for name, (apart, together) in found.items():
    print(f"{name}: apart {apart}, in a collection {together}")
apart, together = found["first batch unlike"]
assert apart == together and apart["wide"] - apart["narrow"] > 0.003
apart, together = found["first batch alike"]
assert apart["wide"] - apart["narrow"] > 0.003 and together["wide"] == together["narrow"] == apart["narrow"]
PYTHON
echo "as described"
