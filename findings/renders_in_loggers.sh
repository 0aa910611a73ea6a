#!/usr/bin/env bash
# A render as floats in seven loggers of pictures: black by two, and by three wrong once a pixel is too bright.
#
# A ramp of 0 to 1, as a renderer gives it, 32x32, and the same with two pixels that are 1.002 and 1.2, as colours of
# harmonics are. What is logged for 0.5, and for these two:
#                                                            0.5, of the ramp     of the other      1.002     1.2
#   torch.utils.tensorboard (2.13.0)                         127                  127               255       255
#   wandb 0.31.0, array or tensor                            0 (the ramp: 0, 1)   0                 1         1
#   swanlab 0.10.3, array                                    0 (the ramp: 0, 1)   0                 1         1
#   comet_ml 3.58.8                                          127                  63                127       153
#   tensorboardX 2.6.5; aim 3.29.1, tensor                   127                  127               255       50
#   mlflow 3.17.2                                            127                  105, and warns    212       255
# wandb took its scaling out and casts to bytes, as its docstring says: floats of 0 to 1 are black, a level of 256 is 0,
# one of -1 is 255. comet_ml scales from and to whole numbers: one bright pixel halves the whole picture. tensorboardX
# and aim multiply by 255 and cast: what is brighter than 1 wraps. None of these says so, nor does swanlab.
# Give every logger bytes: (render.clip(0, 1) * 255 + 0.5).astype(uint8); all agree on those, but comet_ml, which
# stretches them to their range without image_minmax=(0, 255).
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 tensorboard==2.21.0 tensorboardX==2.6.5 wandb==0.31.0 swanlab==0.10.3 \
    comet_ml==3.58.8 aim==3.29.1 mlflow-skinny==3.17.2 matplotlib==3.11.2 pillow==12.3.0 numpy==2.4.6 \
    setuptools==80.9.0
export COMET_DISABLE_AUTO_LOGGING=1 HOME="$PWD"
env/bin/python - 2> log.txt <<'PYTHON'
import io
import warnings
import zipfile
from pathlib import Path

import aim
import comet_ml
import mlflow
import numpy as np
import swanlab
import tensorboardX.summary
import torch
import torch.utils.tensorboard.summary
import wandb
from PIL import Image

ramp = np.linspace(0, 1, 32 * 32, dtype=np.float32).reshape(32, 32, 1).repeat(3, 2)
bright = ramp.copy()
bright[0, 0], bright[0, 1] = 1.002, 1.2


def opened(data):
    return Image.open(io.BytesIO(data))


def by_comet(picture, number=iter(range(99)), **options):
    folder = Path(f"comet{next(number)}")
    experiment = comet_ml.OfflineExperiment(offline_directory=str(folder), log_code=False, log_env_details=False)
    experiment.log_image(picture, name="render", **options)
    experiment.end()
    with zipfile.ZipFile(next(folder.glob("*.zip"))) as archive:
        files = [archive.read(name) for name in archive.namelist()]
    return opened(next(data for data in files if data.startswith(b"\x89PNG")))


def tensor(picture):
    return torch.tensor(picture).permute(2, 0, 1)


def by_summary(module):
    return lambda picture: opened(module.image("a", picture, dataformats="HWC").value[0].image.encoded_image_string)


LOGGERS = {
    "torch": (by_summary(torch.utils.tensorboard.summary), 127, 127, 255, 255),
    "tensorboardX": (by_summary(tensorboardX.summary), 127, 127, 255, 50),
    "wandb": (lambda picture: wandb.Image(picture).image, 0, 0, 1, 1),
    "wandb, tensor": (lambda picture: wandb.Image(tensor(picture)).image, 0, 0, 1, 1),
    "swanlab": (lambda picture: opened(swanlab.Image(picture).buffer.getvalue()), 0, 0, 1, 1),
    "comet_ml": (by_comet, 127, 63, 127, 153),
    "aim, tensor": (lambda picture: aim.Image(tensor(picture)).to_pil_image(), 127, 127, 255, 50),
    "mlflow": (lambda picture: mlflow.Image(picture).to_pil(), 127, 105, 212, 255),
}
middle = np.unravel_index(np.abs(ramp[..., 0] - 0.4999).argmin(), (32, 32))
for name, (logged, *expected) in LOGGERS.items():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        first, second = (np.asarray(logged(picture))[..., 0] for picture in (ramp, bright))
    found = [int(first[middle]), int(second[middle]), int(second[0, 0]), int(second[0, 1])]
    print(f"{name:14}", found, "ramp up to", first.max(), [str(warning.message)[:60] for warning in caught])
    assert found == expected and first.max() == (1 if expected[0] == 0 else 255), name
    assert bool([warning for warning in caught if "range" in str(warning.message)]) == (name == "mlflow"), name
levels = np.full((8, 8, 3), 100, np.int32)
levels[0, 0], levels[0, 1] = 256, -1
assert np.asarray(wandb.Image(levels).image)[0, :2, 0].tolist() == [0, 255]
data = (ramp * 100 + 50.5).astype(np.uint8)
for name, (logged, *_) in LOGGERS.items():
    same = np.array_equal(np.asarray(aim.Image(data).to_pil_image() if "aim" in name else logged(data)), data)
    assert same == (name != "comet_ml"), name
assert np.array_equal(np.asarray(by_comet(data, image_minmax=(0, 255))), data)
PYTHON
! grep -iE "normal|range|clip|scal" log.txt
echo "as described"
