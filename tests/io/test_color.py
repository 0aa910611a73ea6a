from pathlib import Path

import av
import numpy as np
import pillow_heif
import pytest
from av.video.frame import VideoFrame
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from anystyle.data.folder import read_originals
from anystyle.data.images import hdr_codes, open_image
from anystyle.io.video import read_frames

COLORS = np.array([[200, 80, 40], [60, 120, 200], [128, 128, 128], [20, 60, 30]]).repeat(16, 0)[None].repeat(32, 0)
WIDE = np.array([[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0114], [0.0164, 0.0880, 0.8956]])
"""Linear BT.709 in BT.2020 (ITU-R BT.2087)."""


def stored(curve: int) -> np.ndarray:
    """Levels that show :data:`COLORS` with white at 203 cd/m², by ITU-R BT.2100: PQ, or HLG at 1,000 cd/m²."""
    sRGB = COLORS / 255
    light = 203 * np.where(sRGB <= 0.04045, sRGB / 12.92, ((sRGB + 0.055) / 1.055) ** 2.4) @ WIDE.T
    if curve == 16:
        power = (light / 10_000) ** (2610 / 16384)
        return ((3424 + 2413 * 32 * power) / 4096 / (1 + 2392 * 32 / 4096 * power)) ** (2523 / 4096 * 128)
    scene = light / 1000 * ((light @ [0.2627, 0.6780, 0.0593]) / 1000)[..., None] ** (1 / 1.2 - 1)
    bright = 0.17883277 * np.log(np.maximum(12 * scene, 1) - 0.28466892) + 0.55991073
    return np.where(scene <= 1 / 12, np.sqrt(3 * scene), bright)


def save(path: Path, curve: int) -> None:
    image = Image.fromarray((255 * stored(curve)).round().astype(np.uint8))
    if path.suffix == ".png":
        chunk = PngInfo()
        chunk.add(b"cICP", bytes([2, curve, 0, 1]))  # unspecified primaries are BT.2020's
        image.save(path, pnginfo=chunk)
    elif path.suffix == ".heic":
        codes = {
            "color_primaries": 9,
            "transfer_characteristics": curve,
            "matrix_coefficients": 9,
            "full_range_flag": 1,
        }
        pillow_heif.from_pillow(image).save(path, quality=-1, chroma=444, **codes)
    else:
        with av.open(str(path), "w") as container:
            stream = container.add_stream("ffv1", rate=5)
            stream.width, stream.height, stream.pix_fmt = *image.size, "yuv444p10le"
            context = stream.codec_context
            context.color_primaries, context.color_trc, context.colorspace, context.color_range = 9, curve, 9, 1
            frame = VideoFrame.from_ndarray((65535 * stored(curve)).round().astype(np.uint16), format="rgb48le")
            container.mux(stream.encode(frame.reformat(format="yuv444p10le", dst_colorspace=9, dst_color_range=1)))
            container.mux(stream.encode())


@pytest.mark.parametrize("curve", [16, 18])
@pytest.mark.parametrize("suffix", ["png", "heic", "mkv"])
def test_colours_of_high_dynamic_range_are_brought_to_srgb(suffix, curve, tmp_path, caplog):
    path = tmp_path / f"a.{suffix}"
    save(path, curve)
    shown = read_frames(path, 1)[0][1] if suffix == "mkv" else open_image(path)
    np.testing.assert_allclose(np.asarray(shown)[8:-8, 8::16], COLORS[8:-8, 8::16], atol=4)
    read_originals([path], longest=64, max_views=1)
    assert "what is brighter than white (203 cd/m²) is clipped" in caplog.text


def test_a_gain_map_leaves_the_picture_as_it_is(tmp_path):
    assert hdr_codes(b"ftypavifcolrnclx" + bytes([0, 12, 0, 16, 0, 9, 128])) == (12, 16)
    assert hdr_codes(b"ftypavif" + b"tmapcolrnclx" + bytes([0, 12, 0, 16, 0, 9, 128])) is None
