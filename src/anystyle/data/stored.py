"""Sources whose pictures are stored as files, or as the bytes of some."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Literal, NamedTuple

import torch

from anystyle.contracts import SceneSource, StoredCamera, StyleSource
from anystyle.data.folder import as_views, read_picture, require_views
from anystyle.data.images import read_square
from anystyle.data.poses import view_camera
from anystyle.errors import UserError
from anystyle.io.images import Picture
from anystyle.types import Cameras, Style, Views


class Shots(NamedTuple):
    """The photographs of a scene, with a camera each or none at all, and the views' height and width."""

    pictures: Sequence[Picture]
    names: Sequence[str]
    cameras: Sequence[StoredCamera]
    size: tuple[int, int]

    def views(self) -> Views:
        """All of them, decoded, as a batch of one."""
        require_views(len(self.pictures), self.size)
        read = [read_picture(*shot, self.size) for shot in zip(self.pictures, self.names, strict=True)]
        if not self.cameras:
            return as_views(read)
        cameras = [view_camera(camera, source) for camera, (_, source) in zip(self.cameras, read, strict=True)]
        return as_views(read, Cameras.cat(cameras, dim=1))


class StoredScenes(SceneSource):
    """Scenes of photographs that are stored."""

    @abstractmethod
    def shots(self, scene: int) -> Shots:
        """All photographs of a scene, in capture order, not decoded."""

    def select(self, scene: int, views: Sequence[int]) -> Shots:
        """Some photographs of a scene; override it where reading all of them would cost more."""
        shots = self.shots(scene)
        cameras = [shots.cameras[view] for view in views] if shots.cameras else []
        return Shots(
            [shots.pictures[view] for view in views], [shots.names[view] for view in views], cameras, shots.size
        )

    def num_views(self, scene: int) -> int:
        return len(self.shots(scene).pictures)

    def read(self, scene: int, views: Sequence[int]) -> Views:
        count = self.num_views(scene)
        if not views or not all(0 <= view < count for view in views):
            raise UserError(f"views {list(views)} of {self.name(scene)}: give at least one of 0 to {count - 1}")
        return self.select(scene, views).views()


class StoredStyle(NamedTuple):
    """A style as it is stored."""

    picture: Picture | None
    text: str
    name: str


class StoredStyles(StyleSource):
    """Styles of pictures that are stored; the constructor sets ``size``, their sides in pixels, and maybe ``crop``."""

    size: int
    crop: Literal["centre", "random"] = "centre"

    @abstractmethod
    def stored(self, style: int) -> StoredStyle:
        """A style, its picture not decoded."""

    def read(self, style: int) -> Style:
        if not 0 <= style < len(self):
            raise UserError(f"style {style}: there are {len(self)}, counted from 0")
        picture, text, name = self.stored(style)
        if picture is None:
            return Style(text=(text,), names=(name,))
        position = 0.5 if self.crop == "centre" else float(torch.rand(()))
        return Style(image=read_square(picture, self.size, position, name), text=(text,), names=(name,))
