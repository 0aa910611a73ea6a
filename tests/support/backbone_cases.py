"""Small networks of the repository's backbones with random weights, and what they are shown."""

from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from anystyle.contracts import Backbone
from anystyle.registry.catalog import catalog
from anystyle.testing.oracle import smooth_image
from anystyle.types import Views


def network(name: str, **options: Any) -> Backbone:
    plugin = catalog().find("backbone", name).load()
    torch.manual_seed(0)
    backbone = plugin(**(plugin.example(Path()) | options))
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for parameter in backbone.parameters():
            if options.get("init") != "scratch":
                parameter.add_(0.05 * torch.randn(parameter.shape, generator=generator))
    return backbone.eval()


def views(count: int, scenes: int = 1, patch: int = 14) -> Views:
    """Photographs of two by three patches."""
    return Views(smooth_image(count, (scenes, count, 3, 2 * patch, 3 * patch)))


def same(left: Any, right: Any, **tolerance: float) -> None:
    for one, other in zip(torch.utils._pytree.tree_leaves(left), torch.utils._pytree.tree_leaves(right), strict=True):
        if isinstance(one, torch.Tensor):
            torch.testing.assert_close(one, other, **tolerance)


def tally(names: dict[str, str], state: dict[str, Tensor]) -> dict[str, tuple[int, int]]:
    """Keys and parameters of each part of a published file, whose name begins those of its tensors."""
    parts: dict[str, tuple[int, int]] = {}
    for key, name in names.items():
        part = name.partition(".")[0]
        count, size = parts.get(part, (0, 0))
        parts[part] = (count + 1, size + state[key].numel())
    return parts
