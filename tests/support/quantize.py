"""Stores the matrices and convolutions of a file of weights in 8 bits, as those that come with plugins are.

``python -m tests.support.quantize FROM TO [PREFIX ...]`` reads what ``anystyle train`` exported; see
:func:`anystyle.io.checkpoint.dequantized` for the reader. Vectors, small tensors and those whose keys begin with a
prefix stay in 16 bits; the header stays as it is.
"""

import sys

import torch
from safetensors import safe_open
from torch import Tensor

from anystyle.io.checkpoint import SCALES, save_tensors

SMALL = 8192
"""Tensors of no more numbers stay in 16 bits: last layers are small, and what they round is seen in every pixel."""


def quantized(tensor: Tensor) -> tuple[Tensor, Tensor]:
    """A tensor (rows, ...) as int8, and the scale of each row (rows,), of those tried the one with the least error."""
    rows = tensor.flatten(1).double()
    most = rows.abs().amax(1).clamp(min=1e-30)
    best = torch.full_like(most, torch.inf)
    scales = most / 127
    for fraction in torch.linspace(0.7, 1, 61):
        tried = (fraction * most / 127).float().double()
        error = (_rounded(rows, tried) * tried[:, None] - rows).square().sum(1)
        scales, best = torch.where(error < best, tried, scales), torch.minimum(error, best)
    return _rounded(rows, scales).to(torch.int8).view(tensor.shape), scales.float()


def _rounded(rows: Tensor, scales: Tensor) -> Tensor:
    return (rows / scales[:, None]).round().clamp(-127, 127)


def main(source: str, target: str, *kept: str) -> None:
    state: dict[str, Tensor] = {}
    with safe_open(source, framework="pt") as file:
        for key in file.keys():  # noqa: SIM118  (no mapping)
            state[key] = file.get_tensor(key)
            if state[key].dim() > 1 and state[key].numel() > SMALL and not key.startswith(kept):
                state[key], state[key + SCALES] = quantized(state[key])
        save_tensors(target, state, file.metadata() or {})


if __name__ == "__main__":
    main(*sys.argv[1:])
