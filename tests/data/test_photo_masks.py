"""What counts of photographs: alpha channels, and masks in a folder."""

import numpy as np
import pytest
import torch
from PIL import Image

from anystyle.data.folder import read_originals, read_views
from anystyle.data.images import open_alpha, open_image
from anystyle.data.photo_masks import are_labels, find_masks, masked_views, open_mask, with_masks
from anystyle.errors import UserError
from anystyle.types import SourceImage, Views
from tests.support.pictures import save

WHITE = 255


def photograph(path, size=(48, 32), alpha=None, exif=None):
    """Random colours, and an alpha channel where one is given."""
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = np.random.default_rng(len(path.stem)).integers(0, 255, (size[1], size[0], 3), dtype=np.uint8)
    picture = Image.fromarray(pixels)
    if alpha is not None:
        picture.putalpha(Image.fromarray(alpha))
    picture.save(path, **({"exif": exif} if exif else {}))
    return path


def left_half(size=(48, 32), white=WHITE, black=0):
    mask = np.full((size[1], size[0]), black, dtype=np.uint8)
    mask[:, : size[0] // 2] = white
    return mask


def read(path, masks=(), empty=False, side=16):
    views, sources = read_views([path], short_side=side, multiple=8, max_views=9)
    return masked_views(views, sources, dict(masks), empty=empty)


@pytest.mark.parametrize("factor", [1, 4])
def test_hidden_colors_never_show_in_a_photograph_that_is_reduced(tmp_path, factor):
    """Black with alpha 0 on the right and red on the left: no pixel is darker than red over white."""
    pixels = np.zeros((64, 96, 4), np.uint8)
    pixels[:, :48] = 255, 0, 0, 255
    pixels[:, 48:, 1] = 200
    Image.fromarray(pixels).save(tmp_path / "a.png")
    picture = np.asarray(open_image(tmp_path / "a.png", longest=96 // factor))
    assert (picture[..., 0] >= 253).all() and (picture[..., 1] == picture[..., 2]).all()
    assert np.asarray(open_alpha(tmp_path / "a.png", longest=96 // factor)).shape == picture.shape[:2]
    views, _ = read(tmp_path / "a.png")
    assert views.images[0, 0, 0].min() > 0.98
    # Premultiplied, as the fit takes its colours: red times alpha.
    covered = views.images[0, 0] - (1 - views.alpha[0, 0])
    torch.testing.assert_close(covered[1:], torch.zeros_like(covered[1:]), rtol=0, atol=0.03)


@pytest.mark.parametrize("mode", ["RGBA", "LA", "P", "PA", "RGB"])
def test_alpha_channels_of_all_kinds(tmp_path, mode):
    pixels = np.dstack([np.full((32, 48, 3), 255, np.uint8), left_half()])
    picture = Image.fromarray(pixels)
    if mode == "RGB":  # one colour of the file is transparent
        pixels[..., 0] = left_half()
        Image.fromarray(pixels[..., :3].copy()).save(tmp_path / "a.png", transparency=(0, 255, 255))
    elif mode == "P":
        picture.quantize(4).save(tmp_path / "a.png")
    else:
        picture.convert("LA" if mode == "PA" else mode).save(tmp_path / ("a.tif" if mode == "PA" else "a.png"))
    np.testing.assert_array_equal(np.asarray(open_alpha(next(tmp_path.iterdir()))), left_half())


def test_an_opaque_alpha_channel_is_no_mask(tmp_path):
    photograph(tmp_path / "a.png", alpha=left_half(black=255))
    assert open_alpha(tmp_path / "a.png") is None and read(tmp_path)[0].alpha is None and read(tmp_path)[1] == {}


def test_alpha_lies_as_the_photograph_does(tmp_path):
    """A photograph that a phone stored lying on a side, and its mask, drawn on it as it stands."""
    exif = Image.Exif()
    exif[0x0112] = 6
    photograph(tmp_path / "a.png", alpha=left_half(), exif=exif)
    views, report = read(tmp_path)
    assert views.size == (24, 16) and report["transparent"] == pytest.approx(0.5, abs=0.03)
    assert (views.alpha[0, 0, :10] > 0.95).all() and (views.alpha[0, 0, 14:] < 0.05).all()
    upright = save(tmp_path / "masks" / "a.png", left_half().T.copy())
    assert with_masks(read_originals([tmp_path / "a.png"], longest=64, max_views=1), {tmp_path / "a.png": upright})


@pytest.mark.parametrize(
    "names",
    [
        {"a.jpg": "a.png", "b.JPG": "b.png"},
        {"a.jpg": "a.jpg.png", "b.jpg": "b.jpg.png"},
        {"a.jpg": "A.PNG", "é.jpg": "e\u0301.png"},
        {"cam0/1.jpg": "cam0/1.png", "cam1/1.jpg": "cam1/1.jpg.png"},
        {"1.jpg": "left/1.png"} | {"x/left/2.jpg": "left/2.png"},
    ],
)
def test_masks_are_found_by_the_names_of_photographs(tmp_path, names):
    names = {one: other for one, other in names.items() if one != "1.jpg"}
    photographs = [photograph(tmp_path / "photos" / name) for name in names]
    masks = [save(tmp_path / "masks" / name, left_half()) for name in names.values()]
    assert find_masks(tmp_path / "masks", photographs) == dict(zip(photographs, masks, strict=True))


def test_masks_that_do_not_fit_are_told_of_or_refused(tmp_path, caplog):
    photos, masks = tmp_path / "photos", tmp_path / "masks"
    paths = [photograph(photos / f"{name}.png") for name in "abc"]
    save(masks / "other.png", left_half())
    with pytest.raises(UserError, match=r"none of the 1 images in .*; expected a\.png, b\.png, c\.png"):
        find_masks(masks, paths)
    save(masks / "a.png", left_half())
    found = find_masks(masks, paths)
    assert "2 of 3 photographs have no mask" in caplog.text and "b.png, c.png" in caplog.text
    assert "1 masks" in caplog.text and "other.png" in caplog.text
    save(masks / "a.jpg", left_half())
    with pytest.raises(UserError, match=r"a\.png has 2 masks"):
        find_masks(masks, paths)
    save(masks / "a.png", left_half((32, 48)))
    with pytest.raises(UserError, match=r"has 32x48 pixels, and a\.png 48x32, upright; give a mask of the same"):
        read(photos, found)
    twice = [photograph(tmp_path / cam / "1.png") for cam in ("cam0", "cam1")]
    save(masks / "1.png", left_half())
    with pytest.raises(UserError, match="would be the mask of both"):
        find_masks(masks, twice)
    with pytest.raises(UserError, match=r"walk\.mp4 is a film"):
        find_masks(masks, [*paths, tmp_path / "walk.mp4"])


@pytest.mark.parametrize("white", [255, 1, 200], ids=["black and white", "labels", "grey"])
@pytest.mark.parametrize("scale", [1, 2])
def test_white_counts_and_black_is_ignored_or_empty(tmp_path, white, scale):
    path = photograph(tmp_path / "a.png")
    file = save(tmp_path / "masks" / "a.png", left_half((48 * scale, 32 * scale), white=white))
    views, report = read(path, {path: file})
    assert views.alpha is None and views.valid[0, 0, :, :10].all() and not views.valid[0, 0, :, 12:].any()
    assert report == {"photographs": 1, "transparent": 0.0, "ignored": pytest.approx(0.5, abs=0.1)}
    views, report = read(path, {path: file}, empty=True)
    assert views.valid is None and views.alpha[0, 0].mean() == pytest.approx(0.5, abs=0.05)
    assert report["ignored"] == 0 and report["transparent"] == pytest.approx(0.5, abs=0.05)
    original = with_masks(read_originals([path], longest=64, max_views=1), {path: file})[0]
    np.testing.assert_array_equal(np.asarray(original.mask) > 127, left_half() > 0)


def test_masks_that_leave_little_and_nothing(tmp_path, caplog):
    """They may be inverted, and a photograph of which nothing is left is ignored, not taken for an empty place."""
    one, two = photograph(tmp_path / "p" / "a.png"), photograph(tmp_path / "p" / "b.png", alpha=left_half(white=0))
    few = left_half()
    few[:, 4:] = 0
    views, _ = read(tmp_path / "p", {one: save(tmp_path / "masks" / "a.png", few)})
    assert "nothing is left of 1 photographs, and they are ignored: b" in caplog.text
    assert "invert them if black is what is to stay" in caplog.text
    assert views.alpha is None and not views.valid[0, 1].any() and views.valid[0, 0].any()
    assert two.is_file()


def test_what_lies_beside_a_photograph_is_not_counted():
    source = SourceImage.covering("a", (64, 48), (48, 64), whole=True)
    views, report = masked_views(Views(torch.ones(1, 1, 3, 48, 64)), [source], {}, empty=False)
    assert report == {} and views.alpha is None and views.valid is not None
    assert views.valid[0, 0].nonzero().amin(0).tolist() == [0, 14] and views.valid.sum() == 48 * 36


def test_segmentations_are_white_but_for_what_is_black_or_transparent(tmp_path):
    """Labels are told from a faint soft mask by the others of their folder, and colours may be dark."""
    faint, white = save(tmp_path / "faint.png", left_half(white=20)), save(tmp_path / "white.png", left_half())
    assert are_labels([faint]) and not are_labels([faint, white])
    colors = np.zeros((32, 48, 3), np.uint8)
    colors[:, :24, 0], colors[:4, :24] = 1, (250, 3, 0)
    cut_out = Image.merge("LA", [Image.new("L", (48, 32), 1), Image.fromarray(left_half())])
    Image.fromarray(colors).save(tmp_path / "ids.png")
    cut_out.save(tmp_path / "cut.png")
    for file, labels in (("faint.png", True), ("ids.png", False), ("cut.png", are_labels([tmp_path / "cut.png"]))):
        np.testing.assert_array_equal(open_mask(tmp_path / file, None, labels=labels), left_half())
    np.testing.assert_array_equal(open_mask(faint, None, labels=False), left_half(white=20))
    Image.fromarray(left_half().astype(np.uint16) * 100).save(tmp_path / "deep.png")
    with pytest.raises(UserError, match=r"deep\.png: no level is white, the largest is 25500 of 65535; save labels"):
        open_mask(tmp_path / "deep.png", None, labels=False)
