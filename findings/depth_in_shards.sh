#!/usr/bin/env bash
# webdataset 1.0.2: depth of 16 bits comes out of its shards as white, and views with a point in their names as one.
#
# Depth of 0.5, 1.5, 3 and 60 m in millimetres, a PNG of 16 bits. Written by TarWriter the file is right, of bytes and
# of an array. As read:
#   .decode("l8"), ("rgb8"), ("pil"), ("pill")     255 255 255 255
#   .decode("l"), ("rgb")                          1.0 1.0 1.0 1.0
#   a function that opens the bytes                500 1500 3000 60000
# Samples `view_0.25` and `view_0.50`, each a PNG and a text: one sample `view_0`, with 25.png, 50.png, and so on.
# Floats of 0.2, 0.5 and 0.999 as a .png: 51, 127 and 254: cut, not rounded.
# No warning of any of this. Keep depth as .npy, or give `decode` a function for it, and names without points.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet webdataset==1.0.2 pillow==13.0.0 numpy==2.4.6
env/bin/python -W error::UserWarning - <<'PYTHON'
import io
import tarfile

import numpy as np
import webdataset
from PIL import Image

depth = np.array([[500, 1500], [3000, 60000]], np.uint16)


def png(array):
    file = io.BytesIO()
    Image.fromarray(array).save(file, "png")
    return file.getvalue()


def write(*samples):
    with webdataset.TarWriter("shard.tar") as archive:
        for sample in samples:
            archive.write(sample)


def read(*decoders):
    samples = webdataset.WebDataset("shard.tar", shardshuffle=False)
    return list(samples.decode(*decoders) if decoders else samples)


def stored(name):
    with tarfile.open("shard.tar") as archive:
        return np.array(Image.open(io.BytesIO(archive.extractfile(name).read())))


def opened(key, data):
    return np.array(Image.open(io.BytesIO(data))) if key.endswith("depth.png") else None


write({"__key__": "000", "depth.png": png(depth)}, {"__key__": "001", "depth.png": depth})
assert np.array_equal(stored("000.depth.png"), depth) and np.array_equal(stored("001.depth.png"), depth)
for decoder in ("l8", "rgb8", "pil", "pill", "l", "rgb", opened):
    for sample in read(decoder):
        found = np.asarray(sample["depth.png"])
        values = found.reshape(2, 2, -1)[..., 0].ravel().tolist()
        print(getattr(decoder, "__name__", decoder), values)
        if decoder is opened:
            assert np.array_equal(found, depth)
        else:
            assert (found == (1 if decoder in ("l", "rgb") else 255)).all()

write(*({"__key__": f"view_{time}", "png": png(depth), "txt": time} for time in ("0.25", "0.50")))
samples = [{name: value for name, value in sample.items() if name[0] != "_"} for sample in read()]
print([sorted(sample) for sample in samples])
assert [sorted(sample) for sample in samples] == [["25.png", "25.txt", "50.png", "50.txt"]]

write({"__key__": "000", "png": np.array([[0.2, 0.5, 0.999]], np.float32)})
print(stored("000.png").tolist())
assert stored("000.png").tolist() == [[51, 127, 254]]
PYTHON
echo "as described"
