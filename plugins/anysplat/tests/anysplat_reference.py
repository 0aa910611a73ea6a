"""Parts of AnySplat with the weights that the goldens were computed with."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor, nn

from oracle import fill_sorted, hashed

Fill = Callable[[dict[str, Tensor]], Mapping[str, Tensor]]


def fill(
    module: nn.Module,
    names: Callable[[Sequence[str]], Mapping[str, str]],
    *,
    own: str = "",
    published: str = "",
    unused: Mapping[str, Sequence[int]] | None = None,
    rule: Fill = fill_sorted,
) -> list[str]:
    """Give a module the hash-filled weights; the published names it has are returned.

    Args:
        module: A part whose keys follow ``own`` in the backbone or branch.
        names: Published names of whole keys.
        own: Ahead of the module's keys.
        published: Ahead of the published names, and cut.
        unused: Shapes of published tensors that the module has no use for, which count where places are counted.
        rule: Fills tensors by published name.
    """
    state = module.state_dict()
    whole = names([own + key for key in state])
    local = {key: whole[own + key].removeprefix(published) for key in state}
    shapes = {local[key]: tensor for key, tensor in state.items()}
    shapes |= {name: torch.empty(tuple(shape)) for name, shape in (unused or {}).items()}
    filled = rule(shapes)
    module.load_state_dict({key: filled[local[key]].view_as(tensor) for key, tensor in state.items()})
    module.eval()
    return sorted(shapes)


def style_vector(index: int = 6 + 1000, rows: int = 1) -> Tensor:
    """The style that goldens were computed with: unit rows of hashed numbers."""
    return torch.nn.functional.normalize(hashed(index, (rows, 512), -1, 1), dim=-1)


def scaled(record: Mapping[str, Any], samples: float = 2e-4) -> float:
    """The absolute tolerance of a record: ``samples`` of its root mean square."""
    count = 1
    for length in record["shape"]:
        count *= length
    return samples * record["l2"] / count**0.5
