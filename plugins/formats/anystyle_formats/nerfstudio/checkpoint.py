"""Checkpoints of splatfacto, ``nerfstudio_models/step-*.ckpt``."""

import io
import pickle
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import torch
import torch.nn.functional as F
from torch import Tensor

from anystyle.contracts import Format
from anystyle.errors import UserError, one_line
from anystyle.geometry.harmonics import constant_from_rgb
from anystyle.io.atomic import atomic_path
from anystyle.io.documents import regular
from anystyle.io.limits import require
from anystyle.types import Gaussians, StyledScene
from anystyle_formats.nerfstudio.run_folder import frame_of

STEP = 29_999
"""Of a checkpoint that is written: splatfacto trains 30,000 steps, and shows all harmonics from 3,000 on."""
PARAMETERS = {"means": 3, "scales": 3, "quats": 4, "features_dc": 3, "features_rest": 3, "opacities": 1}
"""Names, and the lengths of their last axis."""

_KEY = re.compile(r"(?:module\.)?_model\.(?:module\.)?(?:gauss_params\.)?(\w+)")
_NUMBERS = ("numpy.", "_codecs.encode")
"""What the names of objects begin with that schedulers keep numbers in; they are not needed."""


class Ckpt(Format):
    """A checkpoint of nerfstudio's splatfacto, in the coordinates of its photographs' cameras where these are found."""

    up: ClassVar[str] = "z"
    reads = True

    def write(self, scene: StyledScene, path: Path) -> None:
        gaussians = scene.styles[-1][1]
        buffer = io.BytesIO()  # a file's own name would be in it
        torch.save(
            {"step": STEP, "pipeline": state_of(gaussians), "optimizers": {}, "schedulers": {}, "scalers": {}}, buffer
        )
        with atomic_path(path) as temporary:
            temporary.write_bytes(buffer.getvalue())

    def read(self, path: Path) -> StyledScene:
        gaussians = gaussians_of(_pipeline(path), path)
        frame = frame_of(path)
        if frame is None:
            return StyledScene(((path.stem, gaussians),), up=self.up)
        placed = frame.data_from_model.gaussians(gaussians)
        return StyledScene(((path.stem, placed),), frame.cameras, frame.names, up=frame.up)


def state_of(gaussians: Gaussians) -> dict[str, Tensor]:
    """A scene as splatfacto's parameters, of degree 1 at least: of degree 0 its colours are sigmoids."""
    (means, quats, scales, opacities, harmonics) = (
        getattr(gaussians, name)[0].detach().float().cpu()
        for name in ("means", "rotations", "scales", "opacities", "harmonics")
    )
    rest = harmonics[:, 1:]
    parameters = {
        "means": means,
        "scales": scales.clamp_min(1e-12).log(),
        "quats": F.normalize(quats, dim=-1),
        "features_dc": harmonics[:, 0],
        "features_rest": rest if rest.shape[1] else torch.zeros(len(means), 3, 3),
        "opacities": opacities.clamp(1e-6, 1 - 1e-6).logit()[:, None],
    }
    # Copies: of a view its whole storage would be saved.
    copies = {name: parameters[name].clone(memory_format=torch.contiguous_format) for name in PARAMETERS}
    return {f"_model.gauss_params.{name}": copy for name, copy in copies.items()}


def gaussians_of(pipeline: Mapping[str, Any], path: Path) -> Gaussians:
    """The Gaussians of a pipeline's state, in the model's coordinates; those that are not finite are left out."""
    named = ((_KEY.fullmatch(key), value) for key, value in pipeline.items() if isinstance(value, Tensor))
    found = {match[1]: value.float() for match, value in named if match is not None and match[1] in PARAMETERS}
    if missing := [name for name in PARAMETERS if name not in found]:
        raise UserError(f"{path} holds no Gaussians of splatfacto ({', '.join(missing)} missing); train splatfacto")
    count = len(found["means"])
    axes = {name: 3 if name == "features_rest" else 2 for name in PARAMETERS}
    for name, last in PARAMETERS.items():
        shape = found[name].shape
        if len(shape) != axes[name] or shape[0] != count or shape[-1] != last:
            raise UserError(f"{path}: {name} of shape {list(shape)} does not fit {count} Gaussians")
    if found["features_rest"].shape[1] not in (0, 3, 8, 15, 24):
        raise UserError(f"{path}: {found['features_rest'].shape[1] + 1} harmonics are of no degree up to 4")
    finite = torch.stack([found[name].flatten(1).isfinite().all(1) for name in PARAMETERS]).all(0)
    if not bool(finite.any()):
        raise UserError(f"{path} holds no Gaussians whose numbers are finite")
    kept = {name: value[finite] for name, value in found.items()}
    constant = kept["features_dc"]
    if not kept["features_rest"].shape[1]:  # without harmonics splatfacto learns colours through a sigmoid
        constant = constant_from_rgb(constant.sigmoid())
    return Gaussians(
        means=kept["means"][None],
        rotations=F.normalize(kept["quats"], dim=-1)[None],
        scales=kept["scales"].exp()[None],
        opacities=kept["opacities"].sigmoid()[None, :, 0],
        harmonics=torch.cat([constant[:, None], kept["features_rest"]], 1)[None],
    )


class _Number:
    """Stands for a number of NumPy beside the tensors; unpickling it has no effect."""

    def __new__(cls, *_: object) -> "_Number":
        return super().__new__(cls)

    def _nothing(self, *_: object) -> None:
        pass

    __init__ = __setstate__ = _nothing


def _pipeline(path: Path) -> Mapping[str, Any]:
    """The state of the pipeline; of the optimisers nothing is read."""
    regular(path, most=None, what="checkpoint")
    require(path.stat().st_size, str(path), "a scene of fewer Gaussians, or another machine")
    try:
        known = torch.serialization.get_unsafe_globals_in_checkpoint(path)
        foreign = sorted(name for name in known if not name.startswith(_NUMBERS))
        if foreign:
            raise UserError(f"{path} holds code or objects of other programs ({', '.join(foreign[:3])})")
        allowed: list[Any] = [(_Number, name) for name in known]
        with torch.serialization.safe_globals(allowed):
            content = torch.load(path, map_location="cpu", weights_only=True, mmap=True)
    except (RuntimeError, OSError, EOFError, ValueError, TypeError, KeyError, pickle.UnpicklingError) as error:
        if isinstance(error, UserError):
            raise
        raise UserError(f"{path} is truncated or no checkpoint of PyTorch ({one_line(error)[:120]})") from None
    pipeline = content.get("pipeline") if isinstance(content, Mapping) else None
    if not isinstance(pipeline, Mapping):
        raise UserError(f"{path} is no checkpoint of nerfstudio; it has no `pipeline`")
    return pipeline
