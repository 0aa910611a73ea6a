"""The photographs' views one after the other: the smallest film."""

from pathlib import Path

from anystyle.contracts import RenderFrames, Video
from anystyle.io.video import write_video
from anystyle.types import Cameras, Gaussians


class ToyVideo(Video):
    """A film of the input views.

    Args:
        fps: Frames a second.
    """

    def __init__(self, *, fps: int = 2) -> None:
        self.fps = fps

    def write(self, gaussians: Gaussians, cameras: Cameras, render: RenderFrames, folder: Path) -> None:
        write_video(render(cameras), folder / "video.mp4", fps=self.fps)
