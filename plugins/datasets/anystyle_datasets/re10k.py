"""RealEstate10K in chunks of compressed frames, as pixelSplat and its successors store it."""

import io
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image
from torch import Tensor

from anystyle.contracts import StoredCamera
from anystyle.data.folder import common_size
from anystyle.data.images import image_size
from anystyle.data.stored import Shots, StoredScenes
from anystyle.errors import UserError
from anystyle.io.arrays import read_tensors
from anystyle.io.cache import LRUCache
from anystyle.io.documents import read_json
from anystyle.paths import inside
from anystyle.ranges import AtLeastOne


class Re10kScenes(StoredScenes):
    """Clips with poses: ``root/{train,test}/*.torch`` with an ``index.json`` from keys to chunks.

    A chunk is a list of dictionaries: ``key``, ``cameras`` (a row per frame: focal lengths and principal point in
    fractions of the image, two unused numbers, and 3x4 camera from world in OpenCV axes) and ``images`` (compressed).
    Poses are handed out as they are stored, without a common scale.

    Args:
        root: A folder.
        split: Which of its sub-folders.
        short_side: Shorter side of the views in pixels.
        multiple: Sides are multiples of it; ``None`` is the backbone's patch size.
    """

    def __init__(
        self,
        *,
        root: str = "re10k",
        split: Literal["train", "test"] = "train",
        short_side: AtLeastOne = 252,
        multiple: AtLeastOne | None = None,
        patch_size: int = 14,
    ) -> None:
        multiple = patch_size if multiple is None else multiple
        self.folder = Path(root) / split
        self.short_side = short_side
        self.multiple = multiple
        path, what = self.folder / "index.json", "JSON object from clips to chunk files"
        self.index: dict[str, str] = read_json(path, dict[str, str], what=what)
        if not self.index:
            raise UserError(f"{path} is empty; a {what} is expected")
        self.keys = sorted(self.index)
        self._chunks: LRUCache[str, Mapping[str, Mapping[str, Any]]] = LRUCache(2)

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        buffer = io.BytesIO()
        Image.linear_gradient("L").resize((48, 27)).save(buffer, "PNG")
        frame = torch.tensor(list(buffer.getvalue()), dtype=torch.uint8)
        row = torch.tensor([0.8, 1.4, 0.5, 0.5, 0.0, 0.0, *torch.eye(4)[:3].flatten().tolist()])
        (folder / "train").mkdir()
        torch.save([{"key": "clip", "cameras": row.repeat(3, 1), "images": [frame] * 3}], folder / "train" / "0.torch")
        (folder / "train" / "index.json").write_text(json.dumps({"clip": "0.torch"}))
        return {"root": str(folder), "short_side": 28}

    def __len__(self) -> int:
        return len(self.keys)

    def name(self, scene: int) -> str:
        if not 0 <= scene < len(self.keys):
            raise UserError(f"scene {scene}: there are {len(self.keys)}, counted from 0")
        return self.keys[scene]

    def frames(self, scene: int) -> list[bytes]:
        """The frames of a clip as they are stored, compressed."""
        return [frame.numpy().tobytes() for frame in self._clip(scene)["images"]]

    def num_views(self, scene: int) -> int:
        return len(self._clip(scene)["images"])

    def shots(self, scene: int) -> Shots:
        frames = self.frames(scene)
        # A clip may be called anything, and views' names become those of files.
        clean = re.sub(r"[^A-Za-z0-9_-]", "_", self.name(scene))[:80]
        names = [f"{clean}_{view:05d}" for view in range(len(frames))]
        size = common_size([image_size(frames[0], names[0])], short_side=self.short_side, multiple=self.multiple)
        return Shots(frames, names, _cameras(self._clip(scene)["cameras"].double()), size)

    def _clip(self, scene: int) -> Mapping[str, Any]:
        key = self.name(scene)
        chunk = self.index[key]
        clips = self._chunks.get(chunk, lambda: self._load(chunk))
        if key not in clips:
            raise UserError(f"{self.folder / chunk} does not hold the clip {key} that the index says it does")
        return clips[key]

    def _load(self, chunk: str) -> dict[str, Mapping[str, Any]]:
        path = inside(self.folder, chunk)
        if path is None:
            raise UserError(f"{self.folder / 'index.json'} names {chunk!r:.200}, which lies outside of its folder")
        if not path.is_file():
            raise UserError(f"{path} is in the index and not there; download the chunk or take it out of the index")
        clips = read_tensors(path, what="chunk of clips")
        if not isinstance(clips, list):
            raise UserError(f"{path} is not a chunk of clips: a list is expected")
        return {clip["key"]: clip for clip in clips if _is_clip(clip)}


def _is_clip(clip: Any) -> bool:
    """Whether a record of a chunk is of the form that :class:`Re10kScenes` describes."""
    if not isinstance(clip, dict) or not isinstance(clip.get("key"), str):
        return False
    cameras, images = clip.get("cameras"), clip.get("images")
    if (
        not isinstance(cameras, Tensor)
        or not isinstance(images, list)
        or not images
        or cameras.shape != (len(images), 18)
    ):
        return False
    if not cameras.is_floating_point() or not all(isinstance(frame, Tensor) for frame in images):
        return False
    plausible = bool(cameras.isfinite().all() and (cameras[:, :2] > 0).all())
    first, second, third = cameras[:, 6:].double().reshape(-1, 3, 4)[..., :3].unbind(1)
    turned = (torch.linalg.cross(first, second) * third).sum(-1).abs() > 1e-6  # the determinant
    return plausible and bool(turned.all()) and all(frame.dtype == torch.uint8 for frame in images)


def _cameras(rows: Float[Tensor, "V 18"]) -> list[StoredCamera]:
    bottom = rows.new_tensor([0.0, 0.0, 0.0, 1.0]).expand(len(rows), 1, 4)
    poses = torch.linalg.inv(torch.cat([rows[:, 6:].reshape(-1, 3, 4), bottom], dim=1))
    lenses = ([[fx, 0, cx], [0, fy, cy], [0, 0, 1]] for fx, fy, cx, cy in rows[:, :4].tolist())
    return [StoredCamera(pose, np.array(lens), (1, 1)) for pose, lens in zip(poses.numpy(), lenses, strict=True)]
