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
from anystyle.io.splats import Remarks, Splats, visible
from anystyle.types import Gaussians, StyledScene
from anystyle_formats.nerfstudio.run_folder import frame_of

STEP = 29_999
"""The step of a checkpoint that is written: splatfacto trains 30,000, and shows all harmonics from 3,000 on."""
PARAMETERS = {"means": 3, "scales": 3, "quats": 4, "features_dc": 3, "features_rest": 3, "opacities": 1}
"""Names, and the lengths of their last axis."""

_KEY = re.compile(r"(?:module\.)?_model\.(?:module\.)?(?:gauss_params\.)?(\w+)")
_NUMBERS = ("numpy.", "_codecs.encode")
"""What the names of objects begin with that schedulers keep numbers in; they are not needed."""


class Ckpt(Format):
    """A checkpoint of nerfstudio's splatfacto, in the coordinates of its photographs' cameras where these are found.

    Args:
        activated: Whether files that are read hold lengths and opacities in [0, 1] in place of logarithms and logits.
    """

    up: ClassVar[str] = "z"
    reads = True

    def __init__(self, *, activated: bool = False) -> None:
        self.activated = activated

    def write(self, scene: StyledScene, path: Path) -> None:
        gaussians = scene.styles[-1][1]
        content = {"step": STEP, "pipeline": state_of(gaussians), "optimizers": {}, "schedulers": {}, "scalers": {}}
        buffer = io.BytesIO()  # a file's own name would be in it
        torch.save(content, buffer)
        with atomic_path(path) as temporary:
            temporary.write_bytes(buffer.getvalue())

    def read(self, path: Path) -> StyledScene:
        remarks = Remarks(path)
        gaussians = gaussians_of(_pipeline(path), remarks, activated=self.activated)
        remarks.tell()
        frame = frame_of(path)
        if frame is None:
            return StyledScene(((path.stem, gaussians),), up=self.up)
        placed = frame.data_from_model.gaussians(gaussians)
        return StyledScene(((path.stem, placed),), frame.cameras, frame.names, up=frame.up, offset=frame.offset)


def state_of(gaussians: Gaussians) -> dict[str, Tensor]:
    """A scene as splatfacto's parameters, of degree 1 at least: of degree 0 its colours are sigmoids."""
    means, quats, scales, opacities, harmonics = (
        tensor[0].detach().float().cpu() for tensor in vars(gaussians).values()
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
    return {
        f"_model.gauss_params.{name}": value.clone(memory_format=torch.contiguous_format)
        for name, value in parameters.items()
    }


def gaussians_of(pipeline: Mapping[str, Any], remarks: Remarks, *, activated: bool = False) -> Gaussians:
    """The Gaussians of a pipeline's state that show something, in the model's coordinates."""
    path = remarks.path
    named = ((_KEY.fullmatch(key), value) for key, value in pipeline.items() if isinstance(value, Tensor))
    found = {match[1]: value.float() for match, value in named if match is not None and match[1] in PARAMETERS}
    if missing := [name for name in PARAMETERS if name not in found]:
        raise UserError(f"{path} holds no Gaussians of splatfacto ({', '.join(missing)} missing); train splatfacto")
    count = len(found["means"])
    for name, last in PARAMETERS.items():
        shape = found[name].shape
        if len(shape) != (3 if name == "features_rest" else 2) or shape[0] != count or shape[-1] != last:
            raise UserError(f"{path}: {name} of shape {list(shape)} does not fit {count} Gaussians")
    if found["features_rest"].shape[1] not in (0, 3, 8, 15, 24):
        raise UserError(f"{path}: {found['features_rest'].shape[1] + 1} harmonics are of no degree up to 4")
    constant = found["features_dc"]
    if not found["features_rest"].shape[1]:  # without harmonics splatfacto learns colours through a sigmoid
        constant = constant_from_rgb(constant.sigmoid())
    harmonics = torch.cat([constant[:, None], found["features_rest"]], 1)
    quats = F.normalize(found["quats"], dim=-1)
    rows = Splats(found["means"], quats, found["scales"], found["opacities"][:, 0], harmonics)
    splats, _ = visible(rows, remarks, logarithmic=True, activated=activated)
    return Gaussians(*(column[None] for column in splats))


class _Number:
    """Stands for a number of NumPy beside the tensors; unpickling it has no effect."""

    def __init__(self, *_: object) -> None:
        pass

    __setstate__ = __init__


def _pipeline(path: Path) -> Mapping[str, Any]:
    """The state of the pipeline; the optimisers are not read."""
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
    except UserError:
        raise
    except (RuntimeError, OSError, EOFError, ValueError, TypeError, KeyError, pickle.UnpicklingError) as error:
        raise UserError(f"{path} is truncated or not a checkpoint of PyTorch ({one_line(error)[:120]})") from None
    pipeline = content.get("pipeline") if isinstance(content, Mapping) else None
    if not isinstance(pipeline, Mapping):
        raise UserError(f"{path} is not a checkpoint of nerfstudio; it has no `pipeline`")
    return pipeline
