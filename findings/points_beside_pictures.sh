#!/usr/bin/env bash
# Points augmented with their picture, as of matches: kornia leaves some where they were, albumentations rounds some.
#
# A soft blob in a picture of 64 x 96 pixels, and its centre as a point. How far the point lies from the blob after both
# went through one augmentation, in pixels:
#                                           albumentations 2.0.8                kornia 0.9.0
#   flips, crops, rotation, affine          0                                   0
#   made 4 times larger                     2.1: half a pixel is left out       0
#   bent elastically                        2.3: a whole number of pixels       the point does not move, 1.6
#   thin-plate spline                       0.5: a whole number of pixels       the point does not move, 1.1
#   distortion of a lens, fisheye           1.0: a whole number of pixels       the point does not move, 6.0
# kornia turns by 30 degrees counterclockwise in RandomRotation, and clockwise in RandomAffine, points with pictures, so
# that one configuration's `degrees` is not another's. Its pages say both; a run says nothing, by either package. Check
# each augmentation with a blob as here, or move a picture of coordinates through it; beside albumentations' larger
# pictures, take (x + 0.5) * 4 - 0.5.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet albumentations==2.0.8 albucore==0.0.24 opencv-python-headless==5.0.0.93 torch==2.13.0 \
    kornia==0.9.0 scipy==1.17.1 numpy==2.4.6 setuptools==80.9.0
export NO_ALBUMENTATIONS_UPDATE=1
env/bin/python -W error::UserWarning - <<'PYTHON'
import albumentations
import kornia.augmentation
import numpy as np
import torch

HEIGHT, WIDTH = 64, 96
PLACE = np.array([60.0, 20.0])  # of a pixel's centre, counted from 0
x, y = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
BLOB = np.exp(-((x - PLACE[0]) ** 2 + (y - PLACE[1]) ** 2) / 32).astype(np.float32)


def centre(picture):
    rows, columns = np.mgrid[: picture.shape[0], : picture.shape[1]]
    return np.array([(columns * picture).sum(), (rows * picture).sum()]) / picture.sum()


def by_albumentations(augmentation):
    points = albumentations.KeypointParams(format="xy", remove_invisible=False)
    both = albumentations.Compose([augmentation], keypoint_params=points, seed=1)
    result = both(image=np.repeat(BLOB[..., None], 3, 2), keypoints=[tuple(PLACE)])
    return centre(result["image"][..., 0].astype(float)), np.asarray(result["keypoints"][0], float)[:2]


def by_kornia(augmentation):
    torch.manual_seed(1)
    both = kornia.augmentation.AugmentationSequential(augmentation, data_keys=["input", "keypoints"])
    picture, points = both(torch.tensor(BLOB)[None, None], torch.tensor(PLACE)[None, None].float())
    return centre(picture[0, 0].numpy().astype(float)), points[0, 0].numpy()


A, K = albumentations, kornia.augmentation
same = torch.tensor
cases = [  # name, way, augmentation, the least and the largest error, and whether the point is whole or unmoved
    ("flip", by_albumentations, A.HorizontalFlip(p=1), 0, 0.01, ""),
    ("flip", by_kornia, K.RandomHorizontalFlip(p=1.0), 0, 0.01, ""),
    ("crop", by_albumentations, A.Crop(10, 0, 90, 60, p=1), 0, 0.01, ""),
    ("rotation", by_albumentations, A.Rotate((30, 30), p=1), 0, 0.01, ""),
    ("rotation", by_kornia, K.RandomRotation((30.0, 30.0), p=1.0), 0, 0.01, ""),
    ("affine", by_albumentations, A.Affine(rotate=(30, 30), p=1), 0, 0.01, ""),
    ("affine", by_kornia, K.RandomAffine((30.0, 30.0), p=1.0), 0, 0.01, ""),
    ("four times larger", by_albumentations, A.Resize(4 * HEIGHT, 4 * WIDTH, p=1), 2.1, 2.15, ""),
    ("four times larger", by_kornia, K.Resize((4 * HEIGHT, 4 * WIDTH)), 0, 0.01, ""),
    ("elastic", by_albumentations, A.ElasticTransform(alpha=300, sigma=10, p=1), 0.3, 3, "whole"),
    ("elastic", by_kornia, K.RandomElasticTransform((33, 33), (8.0, 8.0), (2.0, 2.0), p=1.0), 1, 2.5, "unmoved"),
    ("thin plate", by_albumentations, A.ThinPlateSpline(p=1), 0.3, 3, "whole"),
    ("thin plate", by_kornia, K.RandomThinPlateSpline(p=1.0), 0.7, 1.6, "unmoved"),
    ("lens", by_albumentations, A.OpticalDistortion((0.5, 0.5), p=1), 0.3, 3, "whole"),
    ("lens", by_kornia, K.RandomFisheye(same([0.0, 0.1]), same([0.0, 0.1]), same([0.5, 0.6]), p=1.0), 4, 8, "unmoved"),
]
turned = {}
for name, way, augmentation, least, most, kind in cases:
    picture, point = way(augmentation)
    error = np.linalg.norm(picture - point)
    turned[name, way] = point - [(WIDTH - 1) / 2, (HEIGHT - 1) / 2]
    print(f"{name:18} {way.__name__:17} blob {picture.round(2)}, point {point.round(2)}, apart {error:.2f}")
    assert least <= error <= most, name
    assert kind != "whole" or np.allclose(point, np.round(point))
    assert kind != "unmoved" or np.allclose(point, PLACE)

start = PLACE - [(WIDTH - 1) / 2, (HEIGHT - 1) / 2]
for (name, way), end in turned.items():
    if name in ("rotation", "affine"):
        angle = -np.degrees(np.angle(complex(*end) / complex(*start)))  # y is down
        print(f"30 degrees, {name}, {way.__name__}: turned counterclockwise by {angle:.1f}")
        assert np.isclose(angle, -30 if (name, way) == ("affine", by_kornia) else 30, atol=0.1)
PYTHON
echo "as described"
