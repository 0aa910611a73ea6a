"""What ``compile=true`` compiles: the blocks that networks repeat."""

import logging
import time
from collections.abc import Callable
from itertools import chain
from typing import Any

import torch
from torch import nn

from anystyle.errors import UserError, one_line
from anystyle.stylizer import Stylizer

_log = logging.getLogger(__name__)

SIZES = 64
"""How many sizes of what it is given a block is compiled for; beyond them it runs as it is. PyTorch's number is 8,
as many as the levels of a decoder in two sizes of its chunks of views."""


def compile_blocks(stylizer: Stylizer, *, backend: str | Callable[..., Any] = "inductor") -> None:
    """Compile blocks of transformers and levels of decoders, each kind once for every size that comes.

    A line says how long the first pass took. Injectors, which may paint in many sizes, stay as they are.

    Raises:
        UserError: Nothing can be compiled here.
    """
    torch._dynamo.config.cache_size_limit = SIZES
    try:
        torch.compile(torch.sin, backend=backend)(torch.zeros(1, device=stylizer.device))
    except RuntimeError as error:
        reason = one_line(str(error).partition("\n\n")[0])
        raise UserError(f"compile=true: {reason}; install a C++ compiler, or leave the word out") from error
    backbone, begun = stylizer.backbone, list[float]()
    parts = [backbone, *(part for name, part in stylizer.branch.named_children() if name != "injectors")]
    for block in chain.from_iterable(m for part in parts for m in part.modules() if isinstance(m, nn.ModuleList)):
        if next(block.children(), None) is not None:
            block.compile(dynamic=False, backend=backend)

    def end(*_: object) -> None:
        _log.warning("compile=true: compiling and the first pass took %.0f s", time.monotonic() - begun[0])
        for hook in hooks:
            hook.remove()

    begin = backbone.embedder.register_forward_pre_hook(lambda *_: begun.append(time.monotonic()))
    hooks = [begin, backbone.geometry_head.register_forward_hook(end)]
