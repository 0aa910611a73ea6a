"""Photographs of phones and of raw converters: HEIC, 16 bits, colour profiles."""

import struct

import av
import numpy as np
import pytest
import tifffile
from PIL import ExifTags, Image, ImageCms

from anystyle.data.folder import read_originals
from anystyle.data.images import image_size, open_image, read_exif
from anystyle.io import images as opening
from tests.support.refusals import raises_line

LEVELS = np.random.default_rng(0).integers(0, 65536, (24, 32, 4), dtype=np.uint16)
LEVELS[0, :4, :3] = np.array([0, 127, 128, 65535])[:, None]
ROUNDED = np.round(LEVELS / 257).astype(np.uint8)


def ramp():
    across = np.linspace(0, 255, 64)[None].repeat(48, 0)
    return np.stack([across, np.linspace(255, 0, 48)[:, None].repeat(64, 1), np.full((48, 64), 90.0)], -1).astype("u1")


@pytest.mark.parametrize(
    "layout",
    [{}, {"compression": "zlib"}, {"planarconfig": "separate"}, {"byteorder": ">"}, {"orientation": 6}],
    ids=str,
)
def test_colours_of_16_bits_are_rounded(tmp_path, layout):
    options, pixels = dict(layout), LEVELS[..., :3]
    tags = [(274, "H", 1, options.pop("orientation"), True)] if "orientation" in options else []
    pixels = np.moveaxis(pixels, 2, 0).copy() if "planarconfig" in options else pixels
    tifffile.imwrite(tmp_path / "a.tif", pixels, photometric="rgb", extratags=tags, **options)
    wanted = np.rot90(ROUNDED[..., :3], -1) if tags else ROUNDED[..., :3]
    assert (np.asarray(open_image(tmp_path / "a.tif")) == wanted).all()
    assert (np.asarray(open_image((tmp_path / "a.tif").read_bytes(), "a")) == wanted).all()
    assert max(open_image(tmp_path / "a.tif", longest=16).size) == 16


def test_png_and_grey_levels_of_16_bits_are_rounded(tmp_path):
    with av.open(str(tmp_path / "a.png"), "w", format="image2") as container:
        stream = container.add_stream("png", rate=1)
        stream.width, stream.height, stream.pix_fmt = 32, 24, "rgb48be"
        frame = av.VideoFrame.from_ndarray(LEVELS[..., :3].copy(), format="rgb48le").reformat(format="rgb48be")
        for packet in [*stream.encode(frame), *stream.encode()]:
            container.mux(packet)
    assert (np.asarray(open_image(tmp_path / "a.png")) == ROUNDED[..., :3]).all()
    Image.fromarray(LEVELS[..., 0]).save(tmp_path / "grey.tif")
    assert (np.asarray(open_image(tmp_path / "grey.tif"))[..., 0] == ROUNDED[..., 0]).all()


def test_transparency_of_16_bits_shows_white(tmp_path):
    pixels = LEVELS.copy()
    pixels[:12, :, 3], pixels[12:, :, 3] = 65535, 0
    tifffile.imwrite(tmp_path / "a.tif", pixels, photometric="rgb", extrasamples=["unassalpha"])
    shown = np.asarray(open_image(tmp_path / "a.tif"))
    assert (shown[:12] == ROUNDED[:12, :, :3]).all() and (shown[12:] == 255).all()


def test_levels_that_cannot_be_told_are_refused_in_one_line(tmp_path):
    tifffile.imwrite(tmp_path / "float.tif", (LEVELS[..., :3] / 65535).astype(np.float32), photometric="rgb")
    tifffile.imwrite(tmp_path / "long.tif", LEVELS[..., 0].astype(np.uint32) << 16, photometric="minisblack")
    for name, words in (("float.tif", "floating-point colours are not read"), ("long.tif", "levels of 32 bits")):
        with raises_line(ValueError, match=words, naming=name):
            open_image(tmp_path / name)


def display_p3(**others):
    """A profile with Display P3's primaries and sRGB's curve, as phones write: sRGB's with other columns.

    It keeps sRGB's name, as profiles of linear colours have that name in theirs.
    """
    data = bytearray(ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes())
    columns = {
        "rXYZ": (0.51512, 0.2412, -0.00105),
        "gXYZ": (0.29198, 0.69225, 0.04189),
        "bXYZ": (0.1571, 0.06657, 0.78407),
        **others,
    }
    for index in range(int.from_bytes(data[128:132], "big")):
        entry = data[132 + 12 * index : 144 + 12 * index]
        offset = int.from_bytes(entry[4:8], "big")
        if (name := entry[:4].decode()) in columns:
            numbers = [round(value * 65536) for value in columns[name]]
            data[offset + 8 : offset + 20] = b"".join(value.to_bytes(4, "big", signed=True) for value in numbers)
    return bytes(data)


@pytest.mark.parametrize("suffix", ["jpg", "heic", "png"])
def test_colours_of_another_profile_become_srgb(tmp_path, suffix):
    """Display P3's red of 0.8 is sRGB's (0.862, ...); grey stays grey."""
    if suffix == "heic":
        opening.formats()  # lets Pillow write it
    for name, colour in (("red", (204, 76, 51)), ("grey", (120, 120, 120))):
        path = tmp_path / f"{name}.{suffix}"
        image = Image.new("RGB", (32, 32), colour).convert("P" if suffix == "png" else "RGB", palette=Image.ADAPTIVE)
        image.save(path, icc_profile=display_p3(), quality=98)
        linear = np.array([c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in np.array(colour) / 255])
        matrix = np.array([[1.2249, -0.2247, 0.0], [-0.0420, 1.0419, 0.0], [-0.0197, -0.0786, 1.0979]])
        converted = matrix @ linear
        wanted = 255 * np.where(converted <= 0.0031308, 12.92 * converted, 1.055 * converted ** (1 / 2.4) - 0.055)
        assert np.abs(np.asarray(open_image(path)).mean((0, 1)) - wanted).max() < 3, name


@pytest.mark.parametrize("mode", ["L", "I;16"])
def test_linear_grey_becomes_srgb(tmp_path, mode):
    """Half of the light has a level of 188; a grey image whose profile is of RGB stays as it is."""
    curve = b"kTRC" + struct.pack(">IIIII", 144, 12, 0x63757276, 0, 0)  # "curv" without entries
    header = struct.pack(">I4xI12s12x4s28x3I48x", 156, 0x2400000, b"mntrGRAYXYZ ", b"acsp", 63190, 65536, 54061)
    linear = header + struct.pack(">I", 1) + curve
    half = Image.new(mode, (8, 8), 128 if mode == "L" else 128 * 257)
    for name, profile, level in (("grey", linear, 188), ("rgb", display_p3(), 128)):
        half.save(tmp_path / f"{name}.png", icc_profile=profile)
        assert np.asarray(open_image(tmp_path / f"{name}.png")).tolist() == [[[level] * 3] * 8] * 8
    if mode == "L":
        half.putalpha(Image.new("L", (8, 8), 0))
        half.putpixel((0, 0), (128, 255))
        half.save(tmp_path / "alpha.png", icc_profile=linear)
        shown = np.asarray(open_image(tmp_path / "alpha.png"))
        assert shown[0, 0].tolist() == [188] * 3 and (shown[1:] == 255).all()


def test_profiles_of_srgb_that_round_otherwise_change_nothing(tmp_path):
    """As the usual one of cameras: its primaries are rounded to four digits."""
    profile = display_p3(rXYZ=(0.4361, 0.2225, 0.0139), gXYZ=(0.3851, 0.7169, 0.0971), bXYZ=(0.1431, 0.0606, 0.7141))
    levels = np.random.default_rng(0).integers(0, 256, (64, 64, 3), dtype=np.uint8)
    Image.fromarray(levels).save(tmp_path / "a.png", icc_profile=profile)
    assert (np.asarray(open_image(tmp_path / "a.png")) == levels).all()


def test_a_damaged_profile_is_left_out(tmp_path, caplog):
    Image.fromarray(ramp()).save(tmp_path / "a.png", icc_profile=b"nonsense")
    assert (np.asarray(open_image(tmp_path / "a.png")) == ramp()).all()
    assert "colour profile cannot be read" in caplog.text


def test_a_phones_heic_is_upright_once_and_has_its_lens(tmp_path):
    """Its pixels are turned by the container, and its EXIF data say so again."""
    opening.formats()
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation], exif[ExifTags.Base.Model] = 6, "iPhone 15"
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] = 26
    Image.fromarray(ramp()).save(tmp_path / "a.heic", exif=exif.tobytes(), quality=95)
    assert b"irot" in (tmp_path / "a.heic").read_bytes() and image_size(tmp_path / "a.heic") == (48, 64)
    assert np.abs(np.asarray(open_image(tmp_path / "a.heic")).astype(int) - np.rot90(ramp(), -1)).mean() < 4
    [original] = read_originals([tmp_path], longest=64, max_views=4)
    assert original.size == (64, 48)  # height and width
    assert read_exif(original.path).get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] == 26


def test_without_its_package_heic_says_what_to_install(tmp_path, monkeypatch):
    (tmp_path / "a.heic").write_bytes(b"\0\0\0\x1cftypheic" + bytes(64))
    monkeypatch.setattr(opening, "formats", lambda: ("JPEG", "PNG"))
    with pytest.raises(ValueError, match=r"pip install \"anystyle\[heic\]\""):
        open_image(tmp_path / "a.heic")
