import av
import pytest
import torch

from anystyle.io.video import write_video


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


def test_no_frames_leave_no_file(tmp_path):
    with pytest.raises(ValueError, match="no frames"):
        write_video(iter(()), tmp_path / "video.mp4")
    assert list(tmp_path.iterdir()) == []
