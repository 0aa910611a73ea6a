"""What a reader of stored cameras promises: see :class:`anystyle.contracts.CameraReader`."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from PIL import Image

from anystyle.contracts import CameraReader
from anystyle.data.folder import image_files
from anystyle.data.names import matched
from anystyle.errors import UserError
from anystyle.testing.subject import Subject


def test_reads_its_example(plugin: Subject[CameraReader]) -> None:
    """Of the folder that ``example`` writes it reads a camera for each photograph: rigid, finite, of its aspect."""
    with _example(plugin) as (path, images):
        cameras = plugin.instance.read(path, images)
        names = matched(cameras, images)
        again = plugin.instance.read(path, images)
        assert images, "`example` writes no photographs where `photographs` says, into the folder or `images`"
        for image in images:
            assert image in names, f"{image.name} has no camera among {sorted(cameras)}"
            camera = cameras[names[image]]
            rotation, height = camera.world_from_camera[:3, :3], camera.size[0]
            assert np.allclose(rotation @ rotation.T, np.eye(3)) and np.linalg.det(rotation) > 0, f"{rotation}"
            assert (camera.intrinsics[[0, 1], [0, 1]] > 0).all() and (camera.intrinsics[2] == [0, 0, 1]).all()
            with Image.open(image) as picture:
                assert abs(picture.width / picture.height - camera.size[1] / height) < 0.02, f"size {camera.size}"
                if camera.undistortion is not None:
                    assert camera.undistortion.apply(picture).size == picture.size, "undistortion changes the size"
        same = [np.array_equal(cameras[name].world_from_camera, again[name].world_from_camera) for name in cameras]
        assert all(same) and len(cameras) == len(again), "other cameras the second time"


def test_finds_its_own_and_nothing_else(plugin: Subject[CameraReader]) -> None:
    """It finds nothing in an empty folder, and a damaged file raises a UserError."""
    with tempfile.TemporaryDirectory() as folder:
        assert plugin.instance.find(Path(folder)) is None, "cameras in an empty folder"
    with _example(plugin) as (path, images):
        for file in [path] if path.is_file() else [each for each in path.iterdir() if each not in images]:
            file.write_bytes(file.read_bytes()[: max(1, file.stat().st_size // 2)])
        try:
            if (found := plugin.instance.find(path)) is not None:
                plugin.instance.read(found, images)
        except UserError as error:
            assert len(str(error).splitlines()) == 1, f"an error of more than a line: {error}"


@contextmanager
def _example(plugin: Subject[CameraReader]) -> Iterator[tuple[Path, list[Path]]]:
    """What the reader finds in its example, and the photographs."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        plugin.cls.example(folder)
        path = plugin.instance.find(folder)
        assert path is not None, "the folder that `example` writes holds no cameras"
        places = (folder, folder / "images")
        yield path, next(filter(None, (image_files(place) for place in places if place.is_dir())), [])
