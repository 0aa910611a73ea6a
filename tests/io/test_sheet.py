import subprocess
import sys

import numpy as np
import pytest
import torch
from PIL import Image, ImageFont

from anystyle.io.sheet import TextCard, contact_sheet, save_png, style_sheet, thumbnails, to_pil, wrap


def test_pixels_are_rounded_to_nearest():
    values = torch.tensor([0.0, 0.4999 / 255, 0.5001 / 255, 1.0, 1.5]).repeat(3, 1)[:, None]
    assert np.asarray(to_pil(values))[0, :, 0].tolist() == [0, 0, 1, 255, 255]


def test_cells_keep_their_aspect_and_stand_in_their_places():
    red, wide = Image.new("RGB", (10, 10), (255, 0, 0)), Image.new("RGB", (40, 10), (0, 0, 255))
    sheet = np.asarray(contact_sheet([[red, wide], [None, TextCard("blue")]], cell=(40, 40), gap=4))
    assert sheet.shape == (4 + 2 * 44, 4 + 2 * 44, 3) and (sheet[4:44, 4:44] == (255, 0, 0)).all()
    blue = (sheet == (0, 0, 255)).all(-1)
    assert blue.sum() == 40 * 10 and (sheet[48:88, 4:44] == 255).all() and (sheet[48:88, 48:88] < 100).any()
    with pytest.raises(ValueError, match="rows of one length"):
        contact_sheet([[None], [None, None]])


def test_png_files_hold_every_pixel(tmp_path):
    noise = np.random.default_rng(0).integers(0, 255, (30, 40, 3), dtype=np.uint8)
    save_png(Image.fromarray(noise), tmp_path / "noise.png")
    assert (np.asarray(Image.open(tmp_path / "noise.png")) == noise).all()


def test_words_are_wrapped_and_endless_ones_end_in_an_ellipsis():
    lines = wrap("thick swirling strokes in deep blue " * 40, 15, 150, max_lines=3).split("\n")
    assert len(lines) == 3 and lines[-1].endswith("…")
    assert all(ImageFont.load_default(size=15).getlength(line) <= 150 for line in lines)
    assert wrap("a\nb", 15, 150, max_lines=2) == "a b"
    assert wrap("x" * 500, 15, 100, max_lines=1).endswith("…")


def test_thumbnails_are_the_first_the_last_and_two_between():
    small = thumbnails([Image.new("RGB", (400, 300), (index, 0, 0)) for index in range(7)])
    assert [image.getpixel((9, 9))[0] for image in small] == [0, 2, 4, 6]
    assert {image.size for image in small} == {(224, 168)}
    assert style_sheet(small, [("one", None, small)]).width == 10 + 2 * 234


@pytest.mark.skipif(sys.platform != "linux", reason="symbols of libraries do not mix elsewhere")
def test_pycolmap_before_pillow_is_refused_before_it_ends_the_process(tmp_path):
    pytest.importorskip("pycolmap")
    lines = "import pycolmap; from PIL import Image; from anystyle.io.sheet import save_png; "
    program = [sys.executable, "-c", lines + "save_png(Image.new('RGB', (64, 64)), 'a.png')"]
    ended = subprocess.run(program, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ended.returncode == 1 and "UserError: pycolmap was imported before Pillow" in ended.stderr
    assert not (tmp_path / "a.png").exists()
