from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
import torch

from anystyle.data.folder import read_originals
from anystyle.data.images import open_image
from anystyle.examples import resolved
from anystyle.io.video import read_frames, write_video
from anystyle_captures.sfm.model import Photograph
from tests.support.films import write_film


def test_a_video_has_every_frame_in_its_colours(tmp_path):
    shades = torch.linspace(0.1, 0.9, 9)
    write_video((torch.full((3, 33, 50), shade.item()) for shade in shades), tmp_path / "video.mp4", fps=24)
    with av.open(str(tmp_path / "video.mp4")) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.format.name, stream.average_rate) == ("h264", "yuv420p", 24)
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
    assert [frame.shape for frame in frames] == [(32, 50, 3)] * 9
    means = torch.tensor([float(frame.mean()) / 255 for frame in frames])
    torch.testing.assert_close(means, shades, rtol=0, atol=0.015)


def test_frames_are_as_bright_as_what_was_filmed(tmp_path):
    photograph = np.asarray(open_image(resolved(Path("example:wave")), longest=800))
    write_film(tmp_path / "a.mp4", [photograph], options={"crf": "4"})
    ((_, shown),) = read_frames(tmp_path / "a.mp4", 1)
    assert np.abs((np.asarray(shown) - photograph.astype(float)).mean((0, 1))).max() < 0.3


def test_no_frames_leave_no_file(tmp_path):
    with pytest.raises(ValueError, match="no frames"):
        write_video(iter(()), tmp_path / "video.mp4")
    assert list(tmp_path.iterdir()) == []


def phone(path, steps, *, rotation=0):
    """A film as a phone writes it: HEVC of varying rate, turned by its container, with its lens in the metadata.

    Its frames brighten by a level each, and have a red corner at the top left as they are stored; the n-th lasts
    ``steps[n]`` of 600 to a second.
    """
    with av.open(str(path), "w", format="mov", options={"movflags": "use_metadata_tags"}) as container:
        texts = {"make": "Apple", "model": "iPhone 15 Pro", "camera.focal_length.35mm_equivalent": "26"}
        texts |= {"camera.lens_model": "iPhone 15 Pro back camera 6.86mm f/1.78"}
        for name, text in texts.items():
            container.metadata[f"com.apple.quicktime.{name}"] = text
        stream = container.add_stream("libx265", rate=30, options={"x265-params": "log-level=none", "crf": "10"})
        stream.width, stream.height, stream.pix_fmt = 96, 64, "yuv420p"
        stream.codec_context.codec_tag = "hvc1"
        stream.time_base = stream.codec_context.time_base = Fraction(1, 600)
        stream.set_display_rotation(rotation)
        time = 0
        for number, step in enumerate(steps):
            pixels = np.full((64, 96, 3), 20 + 2 * number, np.uint8)
            pixels[:32, :32] = [255, 0, 0]
            frame = av.VideoFrame.from_ndarray(pixels, format="rgb24")
            frame.pts, frame.time_base = time, Fraction(1, 600)
            time += step
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def test_frames_of_a_varying_rate_are_taken_by_time(tmp_path):
    """Forty frames in a second and a third, then ten in as many seconds: of four parts three show the last ten."""
    phone(tmp_path / "a.mov", [20] * 40 + [80] * 30)
    frames = read_frames(tmp_path / "a.mov", 4)
    seconds = [(20 * min(number, 40) + 80 * max(number - 40, 0)) / 600 for number, _ in frames]
    assert [int(4 * second / (3200 / 600)) for second in seconds] == [0, 1, 2, 3]
    assert (sum(number >= 40 for number, _ in frames), len(read_frames(tmp_path / "a.mov", 70))) == (3, 70)


@pytest.mark.parametrize("rotation", [0, -90, 90, 180])
def test_a_phones_film_is_upright_and_has_its_lens(tmp_path, rotation):
    phone(tmp_path / "a.mov", [20] * 6, rotation=rotation)
    [(_, image)] = read_frames(tmp_path / "a.mov", 1)
    assert image.size == ((64, 96) if rotation in (90, -90) else (96, 64))
    # QuickTime's matrix brings a stored pixel (x, y) to (a x + c y, b x + d y), up to a shift.
    data = (tmp_path / "a.mov").read_bytes()
    assert b"hvc1" in data
    matrix = np.frombuffer(data, ">i4", 9, data.index(b"tkhd") + 44).reshape(3, 3)[:2, :2] / 65536
    corners = np.array([[0, 0], [96, 0], [0, 64], [96, 64]]) @ matrix
    wanted = (np.array([16, 16]) @ matrix - corners.min(0)) / np.ptp(corners, axis=0)
    pixels = np.asarray(image).astype(int)
    rows, columns = np.nonzero((pixels[..., 0] > 200) & (pixels[..., 1] < 90))
    np.testing.assert_allclose((columns.mean() / image.width, rows.mean() / image.height), wanted, atol=0.05)
    [original] = read_originals([tmp_path / "a.mov"], longest=96, max_views=1)
    photograph = Photograph.from_exif("a", np.asarray(original.picture), original.exif)
    assert photograph.lens.startswith("Apple iPhone 15 Pro") and photograph.focal_length > 0


@pytest.mark.parametrize(("codec", "pixels"), [("libvpx-vp9", "yuva420p"), ("ffv1", "bgra"), ("ffv1", "yuv420p")])
def test_a_film_with_transparency_says_that_it_is_not_used(codec, pixels, tmp_path, caplog):
    write_film(tmp_path / "a.mkv", [np.zeros((64, 96, 4), np.uint8)], codec, rate=5, pixels=pixels)
    assert read_frames(tmp_path / "a.mkv", 1) and ("has an alpha channel" in caplog.text) == (pixels != "yuv420p")


@pytest.mark.parametrize(("suffix", "codec"), [("mkv", "libx264"), ("webm", "libvpx-vp9"), ("mp4", "libx264")])
@pytest.mark.parametrize("count", [48, 47, 24])
def test_as_many_frames_as_asked_for_are_read(tmp_path, suffix, codec, count):
    path = tmp_path / f"a.{suffix}"
    write_film(path, [np.full((48, 64, 3), 5 * number, np.uint8) for number in range(48)], codec, rate=30)
    assert len(read_frames(path, count)) == count


@pytest.mark.parametrize("rotation", [0, 90])
def test_pixels_that_are_not_square_are_widened(tmp_path, rotation, caplog):
    """A circle as it is shown, stored by pixels four thirds as wide as high, is a circle in the frames."""
    path, aspect = tmp_path / "a.mp4", Fraction(4, 3)

    def turned(stream: av.VideoStream) -> None:
        stream.codec_context.sample_aspect_ratio = aspect
        stream.set_display_rotation(rotation)

    rows, columns = np.mgrid[:120, :160]
    inside = ((columns - 80) * float(aspect)) ** 2 + (rows - 60.0) ** 2 < 40**2
    write_film(path, 4 * [np.where(inside[..., None], 0, 255).astype(np.uint8).repeat(3, -1)], rate=10, prepare=turned)
    ((_, image),) = read_frames(path, 1)
    assert sorted(image.size) == [120, 213]
    dark = np.asarray(image.convert("L")) < 128
    assert dark.any(0).sum() == pytest.approx(dark.any(1).sum(), abs=2)
    assert "pixels 1.33 times as wide as high" in caplog.text


@pytest.mark.parametrize(("size", "tagged"), [((720, 1280), True), ((360, 640), False)])
def test_films_of_high_definition_are_bt_709(tmp_path, size, tagged):
    red = torch.zeros(3, *size)
    red[0] = 1
    write_video([red] * 2, tmp_path / "a.mp4")
    with av.open(str(tmp_path / "a.mp4")) as container:
        frame = next(container.decode(video=0))
    luma = frame.to_ndarray(format="yuv420p")[0, 0]
    assert (frame.colorspace == 1, frame.color_primaries == 1, frame.color_trc == 1) == (tagged,) * 3
    assert luma == pytest.approx(16 + 219 * (0.2126 if tagged else 0.299), abs=1)
