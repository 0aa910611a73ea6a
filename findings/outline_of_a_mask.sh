#!/usr/bin/env bash
# A mask through its outline, a polygon, and back, by other packages: it loses or gains a row and a column each time.
#
# Masks of a rectangle, 20 x 10 pixels, and of a line, 1 x 20. Pixels that are left after their outline, as written by
# one package (rows), was filled by another (columns); in brackets after five times:
#   the rectangle, 200                    OpenCV, supervision    Pillow        scikit-image    pycocotools, rasterio
#   OpenCV 5.0.0.93 findContours          200 (200)              200 (200)     200 (200)       171 (75)
#   supervision 0.31.2 mask_to_polygons   200 (200)              200 (200)     200 (200)       171 (75)
#   scikit-image 0.26.0 find_contours     230 (231)              230 (360)     200 (200)       199 (185)
#   rasterio 1.4.4 features.shapes        231 (375)              231 (375)     231 (375)       200 (200)
#   the line, 20
#   OpenCV                                20                     20            20              0
#   supervision                           0 by all: there is no polygon
#   scikit-image                          21                     41 (135)      20              19
#   rasterio                              42 (150)               42 (150)      42 (150)        20
# Outlines go through the centres of pixels (OpenCV), half a pixel outside of them (scikit-image), or along their sides
# with (0, 0) in the corner of the picture (rasterio; COCO's annotations), and a fill takes them for one of these. No
# polygon says which. (That pycocotools has one less is reported publicly.) Fill an outline by the package that wrote
# it; for COCO take rasterio's, or better its RLE, and keep masks of thin things as pictures.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet numpy==2.4.6 opencv-python-headless==5.0.0.93 supervision==0.31.2 scikit-image==0.26.0 \
    rasterio==1.4.4 pycocotools==2.0.11 pillow==12.3.0
env/bin/python -W error::UserWarning - <<'PYTHON'
import cv2
import numpy as np
import pycocotools.mask
import rasterio.features
import supervision
from PIL import Image, ImageDraw
from skimage.draw import polygon2mask
from skimage.measure import find_contours

SHAPE = 60, 80
IDENTITY = rasterio.Affine.identity()


def opencv_outlines(mask):
    found, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return [points[:, 0] for points in found]


def rasterio_outlines(mask):
    return [
        np.array(shape["coordinates"][0][:-1])
        for shape, _ in rasterio.features.shapes(mask.astype(np.uint8), mask=mask, transform=IDENTITY)
    ]


def filled_by_opencv(polygons):
    mask = np.zeros(SHAPE, np.uint8)
    cv2.fillPoly(mask, [polygon.round().astype(np.int32) for polygon in polygons], 1)
    return mask


def filled_by_supervision(polygons):
    masks = [supervision.polygon_to_mask(polygon.round().astype(int), SHAPE[::-1]) for polygon in polygons]
    return np.any(masks, axis=0)


def filled_by_pillow(polygons):
    image = Image.new("L", SHAPE[::-1])
    for polygon in polygons:
        ImageDraw.Draw(image).polygon([tuple(point) for point in polygon], fill=1)
    return np.asarray(image)


def filled_by_pycocotools(polygons):
    polygons = [polygon.ravel().tolist() for polygon in polygons]
    return pycocotools.mask.decode(pycocotools.mask.merge(pycocotools.mask.frPyObjects(polygons, *SHAPE)))


def filled_by_rasterio(polygons):
    rings = [[*polygon.tolist(), polygon[0].tolist()] for polygon in polygons]
    shapes = [{"type": "Polygon", "coordinates": [ring]} for ring in rings]
    return rasterio.features.rasterize(shapes, SHAPE, transform=IDENTITY)


writers = {
    "OpenCV": opencv_outlines,
    "supervision": supervision.mask_to_polygons,
    "scikit-image": lambda mask: [points[:-1, ::-1] for points in find_contours(mask.astype(float), 0.5)],
    "rasterio": rasterio_outlines,
}
fills = {
    "OpenCV": filled_by_opencv,
    "supervision": filled_by_supervision,
    "Pillow": filled_by_pillow,
    "scikit-image": lambda polygons: np.any([polygon2mask(SHAPE, polygon[:, ::-1]) for polygon in polygons], axis=0),
    "pycocotools": filled_by_pycocotools,
    "rasterio": filled_by_rasterio,
}
rectangle, line = np.zeros((2, *SHAPE), bool)
rectangle[8:18, 5:25] = True
line[6:26, 30] = True
expected = {
    "rectangle": {
        "OpenCV": ([200, 200, 200, 200, 171, 171], [200, 200, 200, 200, 75, 75]),
        "supervision": ([200, 200, 200, 200, 171, 171], [200, 200, 200, 200, 75, 75]),
        "scikit-image": ([230, 230, 230, 200, 199, 199], [231, 231, 360, 200, 185, 185]),
        "rasterio": ([231, 231, 231, 231, 200, 200], [375, 375, 375, 375, 200, 200]),
    },
    "line": {
        "OpenCV": ([20, 20, 20, 20, 0, 0], [20, 20, 20, 20, 0, 0]),
        "supervision": ([0] * 6, [0] * 6),
        "scikit-image": ([21, 21, 41, 20, 19, 19], [21, 21, 135, 20, 15, 15]),
        "rasterio": ([42, 42, 42, 42, 20, 20], [150, 150, 150, 150, 20, 20]),
    },
}
for name, mask in (("rectangle", rectangle), ("line", line)):
    for writer, outlines in writers.items():
        once, often = [], []
        for fill in fills.values():
            there, sizes = mask, []
            for _ in range(5):
                polygons = [np.asarray(polygon, float) for polygon in outlines(there)] if there.any() else []
                there = np.asarray(fill(polygons)) > 0 if polygons else np.zeros(SHAPE, bool)
                sizes.append(int(there.sum()))
            once.append(sizes[0])
            often.append(sizes[-1])
        print(f"{name}, outline by {writer}: {dict(zip(fills, once))}, after five times {often}")
        assert (once, often) == expected[name][writer]
assert supervision.mask_to_polygons(line) == []
PYTHON
echo "as described"
