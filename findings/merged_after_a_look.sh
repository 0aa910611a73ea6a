#!/usr/bin/env bash
# torchmetrics 1.9.0, `merge_state`: shards of an evaluation merged into a metric that was looked at are left out.
#
# Three shards of pictures, of 4, 2 and 6, each judged by a metric of its own, as workers do, and merged. PSNR in dB:
#   all pictures in one metric                                   20.25
#   the second and third merged into the first                   20.25
#   the same after `compute` of the first, as for a line of progress      20.49, the first shard's alone
#   all three merged into a new metric                           NaN, where a `data_range` is given
# So it is with SSIM, UQI, VIF, MSE, R2 and 7 more: `compute` keeps its result, which `update` and `reset` forget and
# `merge_state` does not; only PSNR is NaN in a new metric, whose range is a state that is averaged over no update.
# `CatMetric` has the merged values first. Nothing is said; `compute` of a new metric warns that nothing was taken in.
# Set `compute_with_cache=False`, or merge into the first shard's metric before any score is asked for.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 torchmetrics==1.9.0 numpy==2.4.6
env/bin/python - <<'PYTHON'
import copy
import warnings

import torch
from torchmetrics.aggregation import CatMetric
from torchmetrics.image import (
    PeakSignalNoiseRatio,
    StructuralSimilarityIndexMeasure,
    UniversalImageQualityIndex,
    VisualInformationFidelity,
)
from torchmetrics.regression import (
    ExplainedVariance,
    LogCoshError,
    MeanAbsoluteError,
    MeanAbsolutePercentageError,
    MeanSquaredError,
    R2Score,
    RelativeSquaredError,
    SpearmanCorrCoef,
    WeightedMeanAbsolutePercentageError,
)

generator = torch.Generator().manual_seed(0)
targets = [torch.rand(number, 3, 64, 64, generator=generator) for number in (4, 2, 6)]
noise = [torch.randn(target.shape, generator=generator) for target in targets]
pictures = [((t + 0.1 * s * n).clamp(0, 1), t) for t, n, s in zip(targets, noise, (1, 2, 0.5), strict=True)]
vectors = [(result.flatten(), target.flatten()) for result, target in pictures]


def scores(make, shards):
    """Of all at once, of merged shards, of shards merged after a look, and of shards merged into a new metric."""
    whole, parts = make(), [make() for _ in shards]
    for metric, shard in zip(parts, shards, strict=True):
        whole.update(*shard)
        metric.update(*shard)
    merged, looked, new = copy.deepcopy(parts[0]), copy.deepcopy(parts[0]), make()
    looked.compute()
    for metric, number in ((merged, 1), (looked, 1), (new, 0)):
        for part in parts[number:]:
            metric.merge_state(part)
    found = [float(metric.compute()) for metric in (whole, merged, looked, new)]
    return [*found, float(parts[0].compute())]


def ssim():
    return StructuralSimilarityIndexMeasure(data_range=1.0)


def psnr():
    return PeakSignalNoiseRatio(data_range=1.0)


of_pictures = [psnr, ssim, UniversalImageQualityIndex, VisualInformationFidelity]
of_vectors = [MeanSquaredError, R2Score, MeanAbsoluteError, MeanAbsolutePercentageError, ExplainedVariance, LogCoshError]
of_vectors += [RelativeSquaredError, SpearmanCorrCoef, WeightedMeanAbsolutePercentageError]
with warnings.catch_warnings(record=True) as told:
    warnings.simplefilter("always")
    for make in (*of_pictures, *of_vectors):
        whole, merged, looked, new, first = scores(make, pictures if make in of_pictures else vectors)
        print(f"{make.__name__:36} {whole:9.4f} {merged:9.4f} {looked:9.4f} {new:9.4f}")
        assert abs(merged - whole) < 1e-4 * abs(whole)
        assert looked == first and abs(looked - whole) > 5e-4 * abs(whole)
        assert new != new if make is psnr else abs(new - whole) < 1e-4 * abs(whole)
about = {str(warning.message) for warning in told if "was called before the ``update``" in str(warning.message)}
others = {str(warning.message) for warning in told} - about
assert about and not [text for text in others if "merge" in text or "cache" in text], others

one, two = CatMetric(), CatMetric()
one.update(torch.tensor([1.0, 2.0]))
two.update(torch.tensor([3.0]))
one.merge_state(two)
assert one.compute().tolist() == [3.0, 1.0, 2.0]

whole, shards = psnr(), [psnr() for _ in pictures]
for metric, shard in zip(shards, pictures, strict=True):
    whole.update(*shard)
    metric.update(*shard)
    metric.compute_with_cache = False
shards[0].compute()
shards[0].merge_state(shards[1])
shards[0].merge_state(shards[2])
assert abs(float(shards[0].compute() - whole.compute())) < 1e-4
print("as described")
PYTHON
