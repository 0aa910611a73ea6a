"""The precision of inference."""

import torch
from torch import nn

from anystyle.branch import StyleBranch
from anystyle.contracts import Backbone
from anystyle.errors import UserError
from anystyle.stylizer import Stylizer

PRECISIONS = ("fp32", "bf16", "reference")


def set_precision(stylizer: Stylizer, precision: str) -> Stylizer:
    """Set what inference computes in; weights are rounded to it. Geometry is always computed in fp32.

    Args:
        stylizer: Changed in place.
        precision: ``fp32``; ``bf16``: weights and activations of the transformers and Gaussian heads, half the memory;
            ``reference``: as the published code runs on a GPU, the frozen transformers' weights in bf16 and the rest
            under autocast.
    """
    for module in modules_in_bf16(precision, stylizer.backbone, stylizer.branch):
        module.to(torch.bfloat16)
    stylizer.autocast = precision == "reference"
    return stylizer


def modules_in_bf16(precision: str, backbone: Backbone, branch: StyleBranch | None = None) -> list[nn.Module]:
    """The modules whose weights a precision stores in bf16."""
    if precision not in PRECISIONS:
        raise UserError(f"precision is {precision!r}; choose from {', '.join(PRECISIONS)}")
    parts: list[nn.Module] = [] if precision == "fp32" else [backbone.embedder, backbone.aggregator]
    if precision == "bf16":
        parts += [backbone.gaussian_head, *([branch] if branch else [])]
    return parts
