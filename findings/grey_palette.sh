#!/usr/bin/env bash
# An ink drawing as the palette of a photograph: a transfer of colours that should end in greys, by three libraries.
#
# The drawing's covariance of colours has rank one. For a colourful picture and a drawing of two greys (20 and 235):
#   color-matcher 0.6.0   mkl            grey, -102 to 325: to be clipped
#                         mvgd           values of 1e14 and more, no warning: it multiplies by pseudo-inverses of covariances
#                         reinhard       nearly grey, up to 633
#                         hm             the drawing's greys in each channel by itself: colours remain, 143 off grey
#                         hm-mvgd-hm     likewise, its middle step is hidden by the last;  hm-mkl-hm   nearly grey
#   scikit-image 0.26.0 match_histograms, channels by themselves    colours remain, 143 off grey
#   POT 0.9.7.post1 LinearTransport                                 grey, -102 to 325
# The other way round, a grey photograph and a colourful painting: reinhard has values from -90 to 635, for it divides by
# the deviation of chroma, which is 0 but for rounding; mkl stays grey but for 27 levels.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet color-matcher==0.6.0 scikit-image==0.26.0 POT==0.9.7.post1 numpy==2.4.6 scipy==1.17.1
env/bin/python -W error::RuntimeWarning - <<'PYTHON'
import numpy as np
import ot
from color_matcher import ColorMatcher
from skimage.exposure import match_histograms

y, x = np.mgrid[:64, :64] / 63
colours = np.stack([x, y, 0.5 + 0.5 * np.sin(6 * x * y)], 2) * 0.8 + 0.1
picture = (255 * colours).round().astype(np.uint8)
drawing = np.where(((y * 9) % 1 < 0.25)[..., None], 20, 235).astype(np.uint8).repeat(3, 2)
wash = (51 + 153 * x[..., None]).round().astype(np.uint8).repeat(3, 2)


def matched(photograph, painting, method):
    return ColorMatcher(src=photograph, ref=painting, method=method).main()


def transported(photograph, painting):
    source, target = (image.reshape(-1, 3) / 255 for image in (photograph, painting))
    return 255 * ot.da.LinearTransport().fit(Xs=source, Xt=target).transform(Xs=source).reshape(photograph.shape)


def told(name, image):
    image = np.asarray(image, float)
    off = float(np.abs(image - image.mean(2, keepdims=True)).max())
    print(f"{name}: {image.min():.0f} to {image.max():.0f}, {off:.0f} off grey")
    return image.min(), image.max(), off


found = {method: told(method, matched(picture, drawing, method)) for method in ("mkl", "mvgd", "reinhard", "hm")}
found |= {method: told(method, matched(picture, drawing, method)) for method in ("hm-mkl-hm", "hm-mvgd-hm")}
found["scikit-image"] = told("scikit-image", match_histograms(picture, drawing, channel_axis=2))
found["POT"] = told("POT", transported(picture, drawing))
assert found["mvgd"][1] > 1e12
assert all(found[name][2] < 1 and -110 < found[name][0] and found[name][1] < 330 for name in ("mkl", "POT"))
assert found["reinhard"][1] > 600 and found["hm-mkl-hm"][2] < 5
assert all(found[name][2] > 140 for name in ("hm", "hm-mvgd-hm", "scikit-image"))
low, high, _ = told("reinhard, a grey photograph", matched(wash, picture, "reinhard"))
assert low < -80 and high > 600
assert told("mkl, a grey photograph", matched(wash, picture, "mkl"))[2] < 30
PYTHON
echo "as described"
