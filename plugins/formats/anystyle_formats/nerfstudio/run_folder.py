"""The frame of a run of nerfstudio: from its model's coordinates to those of the data it was trained on.

Training moves and scales a scene: ``model = scale * (transform @ original)``, both in ``dataparser_transforms.json``.
Original coordinates are those before ``ns-process-data``, which writes poses in coordinates of its own, with
``applied_transform`` and ``applied_scale`` from the original ones in ``transforms.json``. All axes of cameras are
OpenGL's there; a model's z axis is up.
"""

from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, NamedTuple

import msgspec
import numpy as np
import torch
import yaml
from numpy.typing import NDArray

from anystyle.data.names import short_names
from anystyle.data.poses import stored_cameras
from anystyle.errors import UserError, one_line
from anystyle.geometry.transforms import Similarity
from anystyle.io.documents import MAX_YAML, read_json, read_text
from anystyle.io.splats import Offset, Remarks, offset_of
from anystyle.pipeline.saved import cameras_beside
from anystyle.ranges import Positive
from anystyle.types import Cameras
from anystyle_formats.reading import cameras_of_one_size

TRANSFORMS, CONFIG = "dataparser_transforms.json", "config.yml"
_Row = tuple[float, float, float, float]
_LEGACY = ((0.0, 1.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, -1.0, 0.0))
"""What ``ns-process-data`` applied to COLMAP's poses before it wrote that down."""
_UP = {"opencv": (0.0, -1.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


class _DataparserTransforms(msgspec.Struct):
    transform: tuple[_Row, _Row, _Row]
    scale: Positive


class _Applied(msgspec.Struct):
    applied_transform: Annotated[list[_Row], msgspec.Meta(min_length=3, max_length=4)] | None = None
    applied_scale: Positive = 1.0


class RunFrame(NamedTuple):
    """Where a run's scene is.

    Args:
        data_from_model: From the model's coordinates to those of the cameras, or to the original ones.
        offset: What was taken off these coordinates, where they are far away.
        up: Axes of these coordinates, of those that files can have the ones nearest to the model's.
        cameras: The photographs' cameras, a batch of one; empty where they are not found.
        names: Names of the cameras.
    """

    data_from_model: Similarity
    offset: Offset
    up: str
    cameras: Cameras
    names: tuple[str, ...]


def frame_of(checkpoint: Path) -> RunFrame | None:
    """The frame of a checkpoint by the files around it; ``None`` where there is no ``dataparser_transforms.json``."""
    folders = (checkpoint.parent, checkpoint.absolute().parent.parent)
    return next((read_run(folder) for folder in folders if (folder / TRANSFORMS).is_file()), None)


def read_run(folder: Path) -> RunFrame:
    """The frame of a run by its folder, which holds ``dataparser_transforms.json``."""
    path = folder / TRANSFORMS
    stored = read_json(path, _DataparserTransforms, what="transform of a dataparser")
    model, scale, data = _square(stored.transform), stored.scale, _data_folder(folder)
    if data is not None and (data / "transforms.json").is_file():
        applied = read_json(data / "transforms.json", _Applied, what="transforms.json of cameras")
        legacy = _LEGACY if (data / "colmap" / "sparse" / "0").is_dir() else None
        rows = applied.applied_transform or legacy
        if rows is not None:
            model = model @ np.linalg.inv(_square(rows[:3]))
        scale /= applied.applied_scale
    rotation = model[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3 or np.linalg.det(rotation) < 0:
        raise UserError(f"{path} does not hold a rotation and translation; get the folder of the run again")
    origin, remarks = -rotation.T @ model[:3, 3], Remarks(folder)
    offset = offset_of(origin[None], remarks)
    remarks.tell()
    parts = (torch.tensor(part, dtype=torch.float32) for part in (1 / scale, rotation.T, origin - offset))
    up = max(_UP, key=lambda name: float(np.dot(_UP[name], model[2, :3])))
    stored_views = {} if data is None else cameras_beside(data, offset)
    names = short_names([PurePosixPath(name) for name in stored_views])
    views = [
        (camera.size, name, camera.world_from_camera, camera.intrinsics)
        for name, camera in zip(names, stored_views.values(), strict=True)
    ]
    return RunFrame(Similarity(*parts), offset, up, *cameras_of_one_size(views))


def _square(rows: Sequence[_Row]) -> NDArray[np.float64]:
    return np.array([*rows, (0.0, 0.0, 0.0, 1.0)], np.float64)


def _data_folder(folder: Path) -> Path | None:
    """The folder of the photographs: the run's, or what its configuration names, from where it may be relative to."""
    if (folder / "transforms.json").is_file():
        return folder
    for named in _named_data(folder / CONFIG) if (folder / CONFIG).is_file() else ():
        for base in (Path.cwd(), *folder.absolute().parents):
            data = base / named
            if data.suffix == ".json" and data.is_file():
                return data.parent
            # A run lies in a folder of its data's name.
            if data.is_dir() and stored_cameras(data):
                return data
    return None


class _PlainLoader(yaml.SafeLoader):
    """Reads objects of Python, which nerfstudio writes, as the tables and lists that they are made of."""


def _plain(loader: yaml.SafeLoader, _: str, node: yaml.Node) -> Any:
    match node:
        case yaml.MappingNode():
            return loader.construct_mapping(node, deep=True)
        case yaml.SequenceNode():
            return loader.construct_sequence(node, deep=True)
        case yaml.ScalarNode():
            return loader.construct_scalar(node)


_PlainLoader.add_multi_constructor("tag:yaml.org,2002:python/", _plain)


def _named_data(config: Path) -> list[Path]:
    """What ``config.yml`` names as data; a path in it is a list of its parts."""
    text = read_text(config, most=MAX_YAML, what="configuration of nerfstudio")
    try:
        content = _PlainLoader(text).get_single_data()
        manager = content["pipeline"]["datamanager"]
        values = [content.get("data"), manager.get("data"), manager.get("dataparser", {}).get("data")]
    except (yaml.YAMLError, KeyError, TypeError, AttributeError, ValueError, RecursionError) as error:
        reason = one_line(error)[:120]
        raise UserError(f"{config} is not a configuration of a run of nerfstudio ({reason})") from None
    parts = [value if isinstance(value, list) else [value] for value in values if value]
    return [Path(*(str(part) for part in value)) for value in parts]
