"""Parts of AnySplat with the weights that the goldens were computed with."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor, nn

from anystyle.types import Attributes
from tests.support.oracle import fill_sorted, hashed


def fill(module: nn.Module, names: Callable[[Sequence[str]], Mapping[str, str]], *, published: str) -> int:
    """Give a module the hash-filled weights and return their number; ``published`` is cut off the published names."""
    state = module.state_dict()
    local = {key: name.removeprefix(published) for key, name in names(list(state)).items()}
    filled = fill_sorted({local[key]: tensor for key, tensor in state.items()})
    module.load_state_dict({key: filled[local[key]].view_as(tensor) for key, tensor in state.items()})
    module.eval()
    return len(local)


def style_vector(index: int = 6 + 1000, rows: int = 1) -> Tensor:
    """The style that goldens were computed with: unit rows of hashed numbers."""
    return torch.nn.functional.normalize(hashed(index, (rows, 512), -1, 1), dim=-1)


def raw_maps(attributes: Attributes) -> Tensor:
    """Attributes as the published head lays them out, B V 84 H W."""
    assert attributes.confidence is not None
    parts = [attributes.opacity[..., None], attributes.scale, attributes.rotation, attributes.color.flatten(4)]
    return torch.cat([*parts, attributes.confidence[..., None]], dim=-1).movedim(-1, 2)


def scaled(record: Mapping[str, Any], samples: float = 2e-4) -> float:
    """The absolute tolerance of a record: ``samples`` of its root mean square."""
    return samples * record["l2"] / math.prod(record["shape"]) ** 0.5
