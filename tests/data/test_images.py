import sys
import threading
import warnings
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image, ImageDraw, ImageOps

from anystyle import load
from anystyle.data.images import image_size, open_image, read_image, readable
from anystyle.errors import UserError
from anystyle.examples import resolved
from anystyle.io.checkpoint import read_header
from anystyle.io.documents import read_json
from anystyle.io.images import MAX_PIXELS, formats
from anystyle.io.sheet import to_pil
from anystyle.types import Gaussians
from anystyle_study.pictures import read_picture
from tests.support.refusals import raises_line


def gradient(height=20, width=30):
    across = np.linspace(0, 255, width)[None].repeat(height, 0)
    down = np.linspace(255, 0, height)[:, None].repeat(width, 1)
    return np.stack([across, down, np.full((height, width), 90.0)], -1).astype(np.uint8)


def test_modes_that_hold_the_same_picture_read_the_same(tmp_path):
    colour = Image.fromarray(gradient())
    for mode, suffix, tolerance in (("RGB", "png", 0), ("RGBA", "png", 0), ("CMYK", "tif", 3), ("P", "gif", 60)):
        colour.convert(mode).save(tmp_path / f"a.{suffix}")
        picture = open_image(tmp_path / f"a.{suffix}")
        assert picture.mode == "RGB"
        assert np.abs(np.asarray(picture).astype(int) - gradient()).max() <= tolerance


def test_grey_and_sixteen_bits(tmp_path):
    grey = gradient()[..., 0]
    Image.fromarray(grey).save(tmp_path / "grey.png")
    Image.fromarray(grey.astype(np.uint16) * 257).save(tmp_path / "deep.png")
    for name in ("grey.png", "deep.png"):
        assert (np.asarray(open_image(tmp_path / name)) == grey[..., None]).all()


def test_transparency_shows_white(tmp_path):
    pixels = np.dstack([gradient(), np.zeros((20, 30), np.uint8)])
    pixels[:10, :, 3] = 255
    Image.fromarray(pixels).save(tmp_path / "a.png")
    picture = np.asarray(open_image(tmp_path / "a.png"))
    assert (picture[10:] == 255).all() and (picture[:10] == gradient()[:10]).all()
    palette = Image.new("P", (4, 4), 0)
    palette.putpalette([255, 0, 0, 0, 255, 0])
    palette.putpixel((1, 1), 1)
    palette.save(tmp_path / "palette.png", transparency=0)
    pixels = np.asarray(open_image(tmp_path / "palette.png"))
    assert (pixels[0, 0] == 255).all() and (pixels[1, 1] == [0, 255, 0]).all()


@pytest.mark.parametrize("suffix", ["png", "tif"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_turned_camera_gives_an_upright_picture(tmp_path, suffix, orientation):
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(gradient()).save(path := tmp_path / f"a.{suffix}", exif=exif)
    turned = ImageOps.exif_transpose(Image.open(tmp_path / "a.png")) if suffix == "png" else open_image(path)
    assert (np.asarray(open_image(path)) == np.asarray(turned)).all()
    assert image_size(path) == open_image(path).size == ((20, 30) if orientation > 4 else (30, 20))
    if orientation == 6:
        assert (np.asarray(open_image(path)) == np.rot90(gradient(), -1)).all()


POINTER = "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a2146\nsize 12345\n"
PAGE = f"\n<!DOCTYPE html>\n<html><head><title>Log in</title></head>{9999 * ' '}</html>"


@pytest.mark.parametrize("name", ["a.jpg", "a.ply", "a.safetensors", "a.json"])
@pytest.mark.parametrize(
    ("content", "told"),
    [
        (POINTER, r"is a Git LFS pointer and not the .* itself; fetch it with git lfs pull"),
        (PAGE, r"is a web page and not the .* itself; download the file, not its page"),
    ],
)
def test_what_came_in_place_of_a_file_is_named(tmp_path, name, content, told):
    (tmp_path / name).write_text(content)
    readers = {
        "a.jpg": image_size,
        "a.ply": Gaussians.load,
        "a.safetensors": read_header,
        "a.json": lambda path: read_json(path, dict),
    }
    with pytest.raises(UserError, match=told):
        readers[name](tmp_path / name)


def test_what_is_no_picture_is_refused_in_one_line(tmp_path):
    (tmp_path / "text.png").write_text("not an image at all")
    (tmp_path / "empty.jpg").touch()
    noise = Image.fromarray(np.random.default_rng(0).integers(0, 255, (200, 300, 3), dtype=np.uint8))
    noise.save(tmp_path / "whole.png")
    (tmp_path / "half.png").write_bytes((tmp_path / "whole.png").read_bytes()[:20000])
    noise.save(tmp_path / "whole.jpg")
    (tmp_path / "half.jpg").write_bytes((tmp_path / "whole.jpg").read_bytes()[:2000])
    (tmp_path / "endless.png").write_bytes(b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n(x) = {} loop\n")
    (tmp_path / "vast.png").write_bytes(b"P6\n9999999 9999999\n255\n")
    told = {"text.png": "is not an image", "empty.jpg": "is not an image", "absent.png": "there is no image"}
    told |= {"endless.png": "is not an image", "vast.png": "too many pixels"}
    for name, words in (told | {"half.png": "damaged", "half.jpg": "damaged"}).items():
        with raises_line(ValueError, match=words, naming=name):
            open_image(tmp_path / name)


def test_only_formats_that_are_meant_are_decoded(tmp_path, monkeypatch):
    """A drawing in PostScript, whatever its name says, would start another program."""
    Image.fromarray(gradient()).save(tmp_path / "drawing.eps")
    drawing = (tmp_path / "drawing.eps").rename(tmp_path / "drawing.png")
    with Image.open(drawing) as image:
        assert image.format == "EPS"
    monkeypatch.setattr("subprocess.check_call", lambda *words, **options: pytest.fail("a program was started"))
    for read in (open_image, image_size, read_picture):
        with pytest.raises(ValueError, match=r"drawing\.png"):
            read(drawing)


def test_a_photograph_of_200_megapixels_is_decoded_reduced(tmp_path):
    left = Image.new("L", (16320, 12240), 40)
    left.paste(200, (8160, 0, 16320, 12240))
    left.save(path := tmp_path / "phone.jpg", quality=50)
    assert image_size(path) == (16320, 12240)
    seen = open_image(path, longest=1024)
    assert seen.size == (2040, 1530)
    np.testing.assert_allclose(np.asarray(seen)[700, [500, 1500]], [[40] * 3, [200] * 3], atol=2)


def test_a_bomb_is_refused_before_it_is_decoded(tmp_path):
    side = int(MAX_PIXELS**0.5) + 1000
    Image.new("1", (side, side)).save(tmp_path / "bomb.png")
    with pytest.raises(ValueError, match="pixels"):
        open_image(tmp_path / "bomb.png")


FORMATS = ("png", "jpg", "gif", "bmp", "tif", "webp", "ppm")


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sampled_from(FORMATS), st.lists(st.tuples(st.floats(0, 1), st.integers(0, 255)), max_size=8), st.floats(0, 1))
def test_a_damaged_file_reads_or_is_refused_in_one_line_that_names_it(tmp_path, suffix, flips, kept):
    path = tmp_path / f"a.{suffix}"
    Image.fromarray(gradient()).save(path)
    data = bytearray(path.read_bytes())
    for place, value in flips:
        data[int(place * (len(data) - 1))] = value
    path.write_bytes(data[: max(1, int(len(data) * min(1.0, 0.3 + kept)))])
    try:
        picture = open_image(path)
    except ValueError as error:
        assert str(path) in str(error) and "\n" not in str(error)
    else:
        assert picture.mode == "RGB" and picture.width * picture.height <= MAX_PIXELS


def test_the_transparency_of_a_painting_is_a_mask(tmp_path):
    """A transparent border, whatever its hidden colours, changes nothing; and all that is seen was painted."""
    painting = Image.effect_mandelbrot((90, 70), (-2, -1, 1, 1), 50).convert("RGB")
    framed = Image.effect_noise((140, 110), 99).convert("RGBA")
    framed.putalpha(0)
    framed.paste(painting, (20, 30))
    for source in (framed, tmp_path / "framed.png"):
        framed.save(tmp_path / "framed.png")
        assert torch.equal(read_image(source, masked=True), read_image(painting))
    two = Image.new("RGBA", (60, 60), (255, 255, 255, 0))  # hidden white
    ImageDraw.Draw(two).ellipse((10, 5, 50, 55), fill=(200, 30, 20, 255))
    ImageDraw.Draw(two).rectangle((29, 20, 31, 40), fill=(10, 40, 160, 200))
    seen = {tuple(pixel) for pixel in np.asarray(to_pil(read_image(two, masked=True))).reshape(-1, 3).tolist()}
    assert seen == {(200, 30, 20), (10, 40, 160)}
    with pytest.raises(UserError, match="transparent everywhere"):
        read_image(Image.new("RGBA", (8, 8)), masked=True)


def test_a_painting_that_is_cut_out_is_nearer_to_itself_than_on_white():
    encoder = load().style_encoder
    for name in ("starry_night", "scream"):
        whole = Image.open(resolved(Path(f"example:{name}"))).convert("RGB").resize((256, 224))
        mask = Image.new("L", whole.size, 0)
        ImageDraw.Draw(mask).ellipse((0, 0, 255, 223), fill=255)
        cut = whole.copy()
        cut.putalpha(mask)
        images = [read_image(cut, masked=True), read_image(cut), read_image(whole)]
        with torch.no_grad():
            masked, white, original = (encoder.embed_images(image[None])[0] for image in images)
        assert (masked - original).norm() < 0.3 * (white - original).norm(), name


def test_a_picture_is_left_out_only_with_its_reason(tmp_path, caplog):
    Image.new("RGB", (8, 8)).save(tmp_path / "a.png")
    (tmp_path / "b.png").write_text("no picture")
    assert readable([tmp_path / "a.png", tmp_path / "b.png"]) == [tmp_path / "a.png"]
    assert "1 of 2 pictures cannot be read and are left out" in caplog.text
    assert "b.png is not an image that can be read" in caplog.text


def test_what_is_not_the_fault_of_a_picture_ends_the_reading(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(24, "Too many open files", "a.png")

    monkeypatch.setattr("anystyle.data.images.image_size", full)
    with pytest.raises(OSError, match="Too many open files"):
        readable([tmp_path / "a.png"])


def test_decoders_register_before_threads_open_pictures(tmp_path, monkeypatch):
    registered = []
    monkeypatch.setattr("anystyle.io.images.check_pillow", lambda: registered.append(threading.current_thread()))
    formats.cache_clear()
    paths = [tmp_path / f"{number}.png" for number in range(16)]
    for path in paths:
        Image.new("RGB", (8, 8)).save(path)
    assert readable(paths) == paths and registered == [threading.main_thread()]


def test_threads_that_open_pictures_leave_the_filters_of_warnings(tmp_path):
    formats()
    paths = [tmp_path / f"{number}.png" for number in range(64)]
    for path in paths:
        Image.new("RGB", (8, 8)).save(path)
    before, interval = list(warnings.filters), sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        readable(paths)
    finally:
        sys.setswitchinterval(interval)
    assert warnings.filters == before
