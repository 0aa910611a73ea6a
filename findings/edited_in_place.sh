#!/usr/bin/env bash
# A photograph changed in place by Pillow, then put into a data set: three packages store the file as it was before.
#
# A photograph of 256x192 is opened, and made smaller by `thumbnail`, or a face in it painted over by `paste`. Stored:
#                                                 of a JPEG                  of a PNG
#   datasets 5.2.0, feature Image                 256x192, with the face     256x192, with the face
#   litdata 0.2.76, serializer of JPEG            256x192, with the face     as changed
#   mosaicml-streaming 0.13.0, encoding "jpeg"    256x192, with the face     as changed
#   its encodings "png" and "pil"                 as changed                 as changed
#   webdataset 1.0.2                              as changed                 as changed
# What is opened knows its file's name, and these read that file again, to spare a second loss by JPEG; methods that
# return another picture (`resize`, `convert`, `copy`) forget the name. Thumbnails are then as large as photographs,
# and what was masked is published. No warning. Store `picture.copy()`.
#
# Of a picture with a palette, as a GIF or a PNG of 256 colours, litdata and "pil" keep the numbers and not the palette:
# it comes back black. "png", datasets and webdataset keep it.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 datasets==5.2.0 webdataset==1.0.2 pillow==13.0.0 numpy==2.4.6 \
    boto3==1.44.8 obstore==0.12.1 lightning-utilities==0.15.3 tifffile==2026.3.3 requests==2.34.2
env/bin/pip install --quiet --no-deps litdata==0.2.76  # it reads pictures with torchvision, which is not needed here
env/bin/pip install --quiet --no-deps --target streaming mosaicml-streaming==0.13.0  # one module of it, alone
export HF_HOME="$PWD/cache" HF_HUB_OFFLINE=1 HF_DATASETS_DISABLE_PROGRESS_BARS=1
env/bin/python -W error::UserWarning - <<'PYTHON'
import importlib.util
import io
import tarfile

import datasets
import numpy as np
import webdataset
from litdata.streaming.serializers import JPEGSerializer, PILSerializer
from PIL import Image

place = importlib.util.spec_from_file_location("encodings", "streaming/streaming/base/format/mds/encodings.py")
streaming = importlib.util.module_from_spec(place)
place.loader.exec_module(streaming)

random = np.random.default_rng(0)
grid = np.kron(random.integers(0, 256, (6, 8, 3)), np.ones((32, 32, 1))).astype(np.uint8)
grid[:64, :64] = 200
photograph = Image.fromarray(grid)
photograph.save("photograph.jpg", quality=95)
photograph.save("photograph.png")
photograph.quantize(16).save("palette.png")
FEATURES = datasets.Features({"image": datasets.Image()})


def changed(path, method, *arguments):
    picture = Image.open(path)
    getattr(picture, method)(*arguments)
    return picture


def smaller(path):
    return changed(path, "thumbnail", (64, 64))


def masked(path):
    return changed(path, "paste", (0, 0, 0), (0, 0, 64, 64))


def opened(data):
    return Image.open(io.BytesIO(data))


def by_datasets(picture):
    return datasets.Dataset.from_dict({"image": [picture]}, features=FEATURES)[0]["image"]


def by_litdata(picture):
    if JPEGSerializer().can_serialize(picture):
        return opened(JPEGSerializer().serialize(picture)[0])
    return PILSerializer().deserialize(PILSerializer().serialize(picture)[0])


def by_streaming(encoding):
    return lambda picture: streaming.mds_decode(encoding, streaming.mds_encode(encoding, picture))


def by_webdataset(picture):
    file = io.BytesIO()
    with webdataset.TarWriter(file) as writer:
        writer.write({"__key__": "0", "png": picture})
    with tarfile.open(fileobj=io.BytesIO(file.getvalue())) as archive:
        return opened(archive.extractfile("0.png").read())


PACKAGES = {"datasets": (by_datasets, 2), "litdata": (by_litdata, 1), "webdataset": (by_webdataset, 0)}
PACKAGES |= {f"streaming, {name}": (by_streaming(name), int(name == "jpeg")) for name in ("jpeg", "png", "pil")}
for name, (stored, wrong) in PACKAGES.items():
    for number, file in enumerate(("photograph.jpg", "photograph.png")):
        size, face = stored(smaller(file)).size, int(np.asarray(stored(masked(file)))[32, 32, 0])
        print(f"{name:16} {file}: thumbnail {size}, face {face}")
        assert (size, face) == (((256, 192), 200) if number < wrong else ((64, 48), 0)), name
        assert stored(smaller(file).copy()).size == (64, 48) and stored(Image.open(file).resize((9, 9))).size == (9, 9)
    if name == "streaming, jpeg":
        continue  # raises for a picture with a palette
    colours = np.asarray(stored(Image.open("palette.png")).convert("RGB"))
    right = np.array_equal(colours, np.asarray(Image.open("palette.png").convert("RGB")))
    print(f"{name:16} palette: levels up to {colours.max()}")
    assert right == (name not in ("litdata", "streaming, pil")) and (right or colours.max() == 0), name
PYTHON
echo "as described"
