import shutil
from functools import partial

import av
import numpy as np
import pytest
import torch
from PIL import Image

from anystyle.data.folder import cover, read_originals, read_views, tell_of_cut
from anystyle.data.images import SUFFIXES
from anystyle.io import video
from anystyle.io.video import read_frames, write_video
from anystyle.types import SourceImage
from tests.support.films import write_film
from tests.support.pictures import picture
from tests.support.refusals import raises_line

save = partial(picture, value=100, size=(64, 48))


def read(*inputs, **options):
    return read_views(list(inputs), **{"short_side": 32, "multiple": 8, "max_views": 16, **options})


def test_a_folder_in_natural_order_with_its_aspect_kept(tmp_path):
    for number in (1, 2, 10):
        save(tmp_path / f"v{number}.png", value=number * 20)
    (tmp_path / "notes.txt").write_text("no image")
    views, sources = read(tmp_path)
    assert [source.name for source in sources] == ["v1", "v2", "v10"] == list(views.names)
    assert views.images.shape == (1, 3, 3, 32, 40)
    torch.testing.assert_close(views.images.mean((0, 2, 3, 4)) * 255, torch.tensor([20.0, 40, 200]))


@pytest.mark.parametrize(
    ("short_side", "enlarge", "size"), [(80, True, (80, 104)), (80, False, (48, 64)), (32, False, (32, 40))]
)
def test_photographs_are_enlarged_where_that_is_asked_for(tmp_path, short_side, enlarge, size):
    save(tmp_path / "a.png")
    assert read(tmp_path / "a.png", short_side=short_side, enlarge=enlarge)[0].size == size


@pytest.mark.parametrize(("width", "height"), [(64, 48), (48, 64), (100, 33), (50, 50), (7, 900)])
def test_sides_are_multiples_and_points_map_back_to_the_source(tmp_path, width, height):
    across = np.linspace(0, 255, width)[None, :, None].repeat(height, 0).repeat(3, 2)
    Image.fromarray(across.astype(np.uint8)).save(tmp_path / "a.png")
    views, (source,) = read(tmp_path / "a.png")
    h, w = views.size
    assert h % 8 == 0 and w % 8 == 0 and min(h, w) == 32 and max(h, w) <= 96
    mapped = source.source_intrinsics(torch.tensor([[40.0, 0, w / 2], [0, 40, h / 2], [0, 0, 1]]))
    assert mapped[0, 2].item() == pytest.approx(width / 2) and mapped[1, 2].item() == pytest.approx(height / 2)
    assert mapped[0, 0].item() == pytest.approx(mapped[1, 1].item())
    if width > 20:
        # The ramp's brightness tells which source column a view column shows.
        column = w // 4
        shown = views.images[0, 0, 0, h // 2, column].item() * (width - 1)
        expected = source.box[0] + (column + 0.5) * (source.box[2] - source.box[0]) / w - 0.5
        assert abs(shown - expected) < 1.0


def test_without_a_size_every_pixel_stays(tmp_path):
    pixels = np.random.default_rng(0).integers(0, 255, (2, 48, 64, 3), dtype=np.uint8)
    for number in range(2):
        Image.fromarray(pixels[number]).save(tmp_path / f"{number}.png")
    views, sources = read(tmp_path, short_side=None)
    assert torch.equal((views.images[0] * 255).round().byte(), torch.from_numpy(pixels).movedim(-1, 1))
    assert sources[0].box == (0, 0, 64, 48)
    with pytest.raises(ValueError, match=r"are 64x48 pixels, and sides must be multiples of 14: views\.resize=true"):
        read(tmp_path, short_side=None, multiple=14)
    save(tmp_path / "2.png", size=(56, 56))
    with pytest.raises(ValueError, match=r"have 2 sizes \(56x56, 64x48\)"):
        read(tmp_path, short_side=None)


def test_different_sizes_and_a_bad_file_among_good_ones(tmp_path, caplog):
    save(tmp_path / "a.png")
    save(tmp_path / "b.png")
    save(tmp_path / "c.png", size=(30, 90))
    (tmp_path / "d.jpg").write_text("nonsense")
    views, sources = read(tmp_path)
    assert views.images.shape == (1, 3, 3, 32, 40) and "d.jpg" in caplog.text
    assert sources[2].size == (90, 30)


def test_intrinsics_map_back_to_the_pixels_of_a_large_upright_source(tmp_path):
    """A 50-megapixel photograph taken with the camera turned is reduced while it is read; its pixels still count."""
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.new("RGB", (8000, 6400), (9, 99, 199)).save(tmp_path / "a.jpg", exif=exif)
    views, (source,) = read(tmp_path)
    assert views.size == (40, 32) and source.size == (8000, 6400)
    lens = source.source_intrinsics(torch.tensor([[30.0, 0, 16], [0, 30, 20], [0, 0, 1]]))
    torch.testing.assert_close(lens, torch.tensor([[6000.0, 0, 3200], [0, 6000, 4000], [0, 0, 1]]))
    torch.testing.assert_close(source.view_intrinsics(lens), torch.tensor([[30.0, 0, 16], [0, 30, 20], [0, 0, 1]]))


def test_equal_names_are_told_apart(tmp_path):
    files = [save(tmp_path / name) for name in ("a/1.png", "b/1.png", "b/1.jpg")]
    assert read(*files)[0].names == ("a_1", "b_1", "b_1_2")


def test_folders_in_a_folder_are_read(tmp_path, caplog):
    """A rig's photographs; masks and reduced copies are none, and those below a folder that has its own are told."""
    for name in ("cam10/1.png", "cam2/1.png", "cam2/2.png", "masks/1.png", ".hidden/1.png"):
        save(tmp_path / "images" / name)
    save(tmp_path / "images_2" / "cam2" / "1.png")
    views, sources = read(tmp_path)
    assert views.names == ("cam2_1", "cam2_2", "cam10_1") and sources[0].path == tmp_path / "images" / "cam2" / "1.png"
    assert "are those in cam2, cam10" in caplog.text
    save(tmp_path / "images" / "0.png")
    assert read(tmp_path)[0].names == ("0",) and "those in cam2, cam10 are left out" in caplog.text


def test_many_photographs_are_thinned_evenly(tmp_path):
    for number in range(20):
        save(tmp_path / f"{number}.png", value=number)
    _, sources = read(tmp_path, max_views=4)
    assert [source.name for source in sources] == ["0", "6", "13", "19"]


def test_a_video_gives_evenly_spaced_frames(tmp_path):
    write_video((torch.full((3, 48, 64), place / 29) for place in range(30)), tmp_path / "walk.mp4")
    views, sources = read(tmp_path / "walk.mp4", max_views=5)
    assert views.images.shape == (1, 5, 3, 32, 40)
    numbers = [int(source.name.rpartition("_")[2]) for source in sources]
    assert [number // 6 for number in numbers] == [0, 1, 2, 3, 4]
    torch.testing.assert_close(views.images.mean((0, 2, 3, 4)), torch.tensor(numbers) / 29, rtol=0, atol=0.03)


def test_the_sharpest_frame_of_each_part_is_taken(tmp_path):
    noise = torch.rand(3, 64, 64, generator=torch.Generator().manual_seed(0))
    frames = [noise if place in (3, 7) else torch.full((3, 64, 64), 0.5) for place in range(10)]
    write_video(frames, tmp_path / "a.mp4")
    assert [number for number, _ in read_frames(tmp_path / "a.mp4", 2)] == [3, 7]


@pytest.mark.parametrize("gop", [10, 1000])
def test_long_videos_are_read_by_their_key_frames_where_these_are_enough(tmp_path, monkeypatch, gop):
    monkeypatch.setattr(video, "MANY_FRAMES", 50)
    frames = np.full((100, 48, 64, 3), 2 * np.arange(100)[:, None, None, None], np.uint8)
    frames[:, ::2] = 255 - frames[:, ::2]
    write_film(tmp_path / "a.mp4", frames, options={"g": str(gop), "sc_threshold": "0"})
    numbers = [number for number, _ in read_frames(tmp_path / "a.mp4", 5)]
    assert [number // 20 for number in numbers] == [0, 1, 2, 3, 4]
    assert (gop == 1000) or all(number % 10 == 0 for number in numbers)


def test_bad_inputs_end_in_one_line(tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "bad.png").write_text("nonsense")
    (tmp_path / "bad.mp4").write_text("nonsense")
    (tmp_path / "VID_00.insv").write_bytes(b"\0\0\0\x18ftypavc1")
    with av.open(str(tmp_path / "sound.mp4"), "w") as container:
        stream = container.add_stream("aac", rate=44100)
        stream.layout = "mono"
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), format="fltp", layout="mono")
        frame.sample_rate = 44100
        for packet in [*stream.encode(frame), *stream.encode()]:
            container.mux(packet)
    told = {
        "empty": "no images in the folder",
        "absent": "no folder, image or video",
        "sound.mp4": "no video in it",
        "VID_00.insv": "save films as .mp4, and those of 360° cameras cut into views",
    }
    for name, words in (told | {"bad.png": "no photograph can be read", "bad.mp4": "is not a video"}).items():
        with raises_line(ValueError, match=words):
            read(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("a.mp4", {}, "is not a video, or is damaged"),
        ("a.mp4", {"movflags": "faststart"}, "it is truncated"),
        ("a.mkv", {}, "it is truncated"),
        ("a.avi", {}, "it is truncated"),
    ],
)
def test_a_truncated_video_is_refused(tmp_path, name, options, words):
    """Whatever its container: what is left of it would pass for a shorter walk."""
    path = tmp_path / name
    pixels = np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8)
    frames = [np.roll(pixels, index, axis=1) for index in range(40)]
    write_film(path, frames, "mpeg4", rate=2, container=options)  # several clusters of Matroska
    assert len(read_frames(path, 4)) == 4
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 7 // 10])
    with raises_line(ValueError, match=words):
        read_frames(path, 4)


def test_photographs_of_which_little_is_shown_are_named(tmp_path, caplog):
    for name, size in (("a", (80, 60)), ("b", (80, 60)), ("c", (60, 80)), ("d", (78, 60))):
        Image.new("RGB", size).save(tmp_path / f"{name}.png")
    read_views([tmp_path], short_side=28, multiple=14, max_views=9)
    (line,) = caplog.messages
    assert "1 of 4 photographs have another aspect than most" in line
    assert line.endswith("their middles are used, 50% of them: c")


@pytest.mark.parametrize(("width", "height"), [(48, 64), (200, 40), (61, 133)])
def test_a_photograph_of_another_aspect_is_kept_whole(width, height, caplog):
    """All of its columns are there, points map back to it, and a line names it; beside it is white."""
    across = np.linspace(0, 200, width)[None, :, None].repeat(height, 0).repeat(3, 2)
    picture = Image.fromarray(across.astype(np.uint8))
    view, source = cover("a", picture, (width, height), (96, 128), whole=True)
    left, top, right, bottom = source.inside
    sides = width / max(width / 128, height / 96), min(96, 128 * height / width)
    assert (right - left, bottom - top) == pytest.approx(sides, abs=0.5)
    shown, inside = np.asarray(view)[..., 0].astype(float), np.zeros((96, 128), bool)
    inside[top:bottom, left:right] = True
    assert (shown[~inside] == 255).all() and (shown[inside] <= 201).all()
    for column in (left, (left + right) // 2, right - 1):
        at = source.box[0] + (column + 0.5) * (source.box[2] - source.box[0]) / 128 - 0.5
        assert abs(shown[48, column] - 200 * at / (width - 1)) < 200 / (right - left)
    beside = np.asarray(source.of_view(picture.resize((width * 3, height * 3))))[~inside]
    assert np.array_equal(beside, np.full_like(np.asarray(view)[~inside], 255))
    tell_of_cut([source, SourceImage.covering("b", (96, 128), (96, 128), whole=True)])
    (line,) = caplog.messages
    assert "1 of 2 photographs have another aspect" in line and line.endswith("kept whole, at fewer pixels: a")


def test_a_photograph_of_nearly_the_same_aspect_fills_its_view():
    assert SourceImage.covering("a", (60, 90), (96, 128), whole=True) == SourceImage.covering("a", (60, 90), (96, 128))
    assert SourceImage.covering("a", (60, 90), (96, 128)).inside == (0, 0, 128, 96)


@pytest.mark.parametrize(
    ("photographs", "others"),
    [
        (["r_0", "r_1"], ["r_0_depth_0001", "r_0_normal_0001", "r_1_depth_0001"]),
        (["0001", "0002"], ["0001.mask", "0002_masks", "mask_0001"]),
        (["frame-000000.color", "frame-000001.color"], ["frame-000000.depth", "frame-000001.depth"]),
        (["rgb_0", "rgb_1"], ["depth_0", "depth_1", "seg_0"]),
        (["0001.png", "0002.png"], ["0001.png.png", "0002.png.png"]),
        (["0001.jpg"], ["0001.jpg.png", "0001.png", "0001.avif", "0001.tif"]),
        (["Image0001", "Image0002"], ["Depth0001", "Normal0002", "Image0001Mask"]),
        (["rgb"], ["depth", "mask"]),
        (["view_1_rgb"], ["view_1_instance", "view_1_semantic_instance", "view_1_thumb"]),
        (["mask", "depth"], []),
        (["frame_00001"], ["mask_00001", "frame_00001_matte", "00001_albedo", "00001_confidence", "00001Depth"]),
        (["IMG_1", "mask of a lion", "depths of winter"], []),
        (["a_mask_1", "a_mask_2"], []),
    ],
)
def test_maps_of_photographs_are_no_photographs(tmp_path, caplog, photographs, others):
    for name in [*photographs, *others]:
        save(tmp_path / (name if f".{name.rpartition('.')[2]}" in SUFFIXES else f"{name}.png"))
    views, _ = read(tmp_path)
    assert views.images.shape[1] == len(photographs)
    assert (f"{len(others)} of {len(photographs) + len(others)} images in" in caplog.text) == bool(others)


def test_copies_of_photographs_count_once(tmp_path, caplog):
    for name in ("IMG_1.jpg", "IMG_2.jpg", "IMG_2 (1).jpg", "10.jpg"):
        save(tmp_path / name, value=len(name) * 15)  # IMG_2 (1) is another photograph
    copies = ["IMG_1 (1)", "IMG_1(2)", "IMG_1 - Copy", "IMG_1 - Copy (2)", "IMG_1 copy", "IMG_1 copy 2", "IMG_1_copy"]
    copies += ["IMG_1 (another copy)", "Copy of IMG_1", "IMG_1 2", "IMG_1~3", "IMG_1 - Kopie", "IMG_1 - 副本"]
    for name in copies:
        (tmp_path / f"{name}.jpg").write_bytes((tmp_path / "IMG_1.jpg").read_bytes())
    Image.open(tmp_path / "IMG_1.jpg").save(tmp_path / "IMG_1 (3).png")  # the same pixels in other bytes
    assert read(tmp_path, max_views=32)[0].names == ("IMG_1", "IMG_2 (1)", "IMG_2", "10")
    assert "14 of 18 images in" in caplog.text
    assert "copies of others, and are left out: Copy of IMG_1.jpg" in caplog.text


def test_of_one_format_content_tells_which_photographs_are_copies(tmp_path):
    """Names that differ in their suffix alone are those of copies, unless the format is the same."""
    names = ("1.JPG", "1.jpg", "2.JPEG", "2.jpg", "3.tif", "3.TIFF", "4.JPG", "4.jpg", "4.png")
    for name, shade in zip(names, (20, 50, 80, 110, 140, 170, 200, 200, 20), strict=True):
        save(tmp_path / name, value=shade)
    views, sources = read(tmp_path)
    assert [round(255 * float(view.mean()) / 10) * 10 for view in views.images[0]] == [20, 50, 80, 110, 140, 170, 200]
    assert len({name.casefold() for name in views.names}) == len(sources) == 7


def test_what_other_systems_leave_is_no_photograph(tmp_path, caplog):
    for name in ("photos/a.png", "photos/b.png", "photos/@eaDir/a.png", "__MACOSX/photos/a.png", "sam_masks/a.png"):
        save(tmp_path / name)
    (tmp_path / "photos" / "._a.png").write_bytes(b"resource fork")
    views, _ = read(tmp_path, max_views=2)
    assert views.images.shape[1] == 2 and caplog.text == ""


def test_a_folder_that_is_named_as_maps_may_hold_the_only_photographs(tmp_path, caplog):
    for name in ("normal/IMG_1.png", "normal/IMG_2.png", "photos/a.png", "depth/a.png"):
        save(tmp_path / name)
    assert read(tmp_path)[0].names == ("a",)  # depth has its names, and is silent
    assert len(caplog.messages) == 1 and "normal are left out, for its name is that of maps" in caplog.text
    shutil.rmtree(tmp_path / "photos")
    shutil.rmtree(tmp_path / "depth")
    assert read(tmp_path)[0].names == ("IMG_1", "IMG_2")
    assert "normal is named as maps of photographs are, and read as photographs" in caplog.text


def test_a_folder_of_one_film_is_that_film(tmp_path):
    frames = [torch.full((3, 48, 64), shade) for shade in (0.2, 0.5, 0.8)]
    write_video(frames, tmp_path / "DJI_0001.MP4")
    assert read(tmp_path)[0].images.shape[1] == 3
    write_video(frames, tmp_path / "DJI_0002.MP4")
    with pytest.raises(ValueError, match=r"2 films in the folder .*; name one"):
        read(tmp_path)


def test_a_film_beside_images(tmp_path, caplog):
    write_video([torch.full((3, 48, 64), shade) for shade in (0.2, 0.5, 0.8)], tmp_path / "MVI_0001.MP4")
    save(tmp_path / "MVI_0001.JPG")  # its thumbnail
    assert read(tmp_path)[0].images.shape[1] == 3 and caplog.text == ""
    save(tmp_path / "IMG_0002.JPG")
    (tmp_path / "MVI_0001.JPG").unlink()
    assert read(tmp_path)[0].images.shape[1] == 1
    assert "has photographs; the films in it are left out: MVI_0001.MP4" in caplog.text


def test_photographs_that_are_not_developed_are_named(tmp_path, caplog):
    for name in ("a.DNG", "b.cr3"):
        (tmp_path / name).write_bytes(b"raw")
    with pytest.raises(ValueError, match=r"the 2 photographs .* are not developed \(CR3, DNG\); save them as JPEG"):
        read(tmp_path)
    with pytest.raises(ValueError, match=r"there are no images in the folder .*; its files are INSP"):
        (tmp_path / "360").mkdir()
        (tmp_path / "360" / "IMG_1.insp").write_bytes(b"two circles")
        read(tmp_path / "360")
    save(tmp_path / "a.jpg")
    assert read(tmp_path)[0].images.shape[1] == 1 and "1 photographs in" in caplog.text and "(CR3)" in caplog.text


def test_panoramas_are_no_photographs(tmp_path, caplog):
    xmp = b'<rdf:Description xmlns:GPano="http://ns.google.com/photos/1.0/panorama/" GPano:ProjectionType="%s"/>'
    part = b'equirectangular" GPano:FullPanoWidthPixels="128" GPano:CroppedAreaImageWidthPixels="64'
    kinds = {"sphere": part.replace(b"64", b"128"), "phone": b"cylindrical", "plain": b"perspective", "part": part}
    for name, kind in kinds.items():
        Image.linear_gradient("L").resize((64, 32)).save(tmp_path / f"{name}.jpg", xmp=xmp % kind)
    views, _ = read_views([tmp_path], short_side=28, multiple=14, max_views=4)
    assert views.names == ("plain",) and "sphere.jpg is a panorama (equirectangular, 64x32)" in caplog.text
    assert "phone.jpg is a panorama (cylindrical, 64x32)" in caplog.text
    assert "all photographs are twice as wide as high, as 360° cameras take them" in caplog.text
    originals = read_originals([tmp_path], longest=28, max_views=4)
    assert [one.name for one in originals] == ["plain", "sphere"] and originals[1].picture.size == (64, 32)
    assert "part.jpg is a panorama (part of equirectangular, 64x32)" in caplog.text
