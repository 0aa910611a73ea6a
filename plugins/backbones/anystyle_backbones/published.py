"""Published weights of backbones: renaming keys, reading sizes off shapes, strict loading."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence

import torch
from torch import Tensor, nn

from anystyle.errors import UserError
from anystyle.io.checkpoint import differences, fill

RenamingRules = Sequence[tuple[str, str]]
"""Regular expressions and what takes the place of what they match."""


def renamed(key: str, rules: RenamingRules) -> str:
    """A key after all rules, one after the other."""
    for pattern, replacement in rules:
        key = re.sub(pattern, replacement, key)
    return key


def dpt_rules(part: str) -> RenamingRules:
    """The rules from names of :class:`anystyle_backbones.dpt.Dpt` to VGGT's; ``part`` matches the decoders' names."""
    # Levels count from 0 here and from 1 there.
    return (
        (rf"^({part})\.resize\.", r"\1.resize_layers."),
        *((rf"^({part})\.reduce\.{level}\.", rf"\1.scratch.layer{level + 1}_rn.") for level in range(4)),
        (rf"^({part})\.neck\.", r"\1.scratch.output_conv1."),
        (rf"^({part})\.output\.", r"\1.scratch.output_conv2."),
        *fusion_rules(part),
    )


def fusion_rules(part: str) -> RenamingRules:
    """The rules from names of :class:`anystyle_backbones.dpt.FusionChain` to DPT's; ``part`` matches the decoders'."""
    return (
        *((rf"^({part})\.fusions\.{level}\.", rf"\1.scratch.refinenet{level + 1}.") for level in range(4)),
        (r"(refinenet\d(?:_aux)?)\.level\.", r"\1.resConfUnit1."),
        (r"(refinenet\d(?:_aux)?)\.refine\.", r"\1.resConfUnit2."),
        (r"(refinenet\d(?:_aux)?)\.project\.", r"\1.out_conv."),
    )


def first_names(state: Mapping[str, Tensor], rules: RenamingRules) -> dict[str, Tensor]:
    """A state dict without the second names of its tensors, which ``rules`` turn into the first.

    Raises:
        UserError: Two names of one tensor have different values.
    """
    first: dict[str, Tensor] = {}
    for second, tensor in state.items():
        name = renamed(second, rules)
        known = first.setdefault(name, tensor)
        if known is not tensor and not (known.dtype == tensor.dtype and torch.equal(known, tensor)):
            raise UserError(f"the checkpoint has {name} under two names, and the two differ; get the file again")
    return first


def checked_parts(state: Mapping[str, Tensor], parts: tuple[str, ...], *, publisher: str, advice: str) -> None:
    """Refuse a state dict that is empty or has a name beginning with none of ``parts``; ``advice`` ends the message."""
    foreign = [name for name in state if not name.startswith(parts)]
    if foreign or not state:
        shown = ", ".join(foreign[:5]) + (", …" if len(foreign) > 5 else "")
        raise UserError(f"the checkpoint has {len(foreign)} keys that are not {publisher} ({shown}); {advice}")


def length(state: Mapping[str, Tensor], name: str, axis: int, *, publisher: str) -> int:
    """The length of an axis of a tensor, from which a network's options are derived."""
    if name not in state:
        raise UserError(f"the checkpoint has no {name}; it is not {publisher}, or not all of it")
    shape = state[name].shape
    if axis >= len(shape) or not shape[axis]:
        raise UserError(f"the checkpoint's {name} is {list(shape)}, which no such network has; get the file again")
    return shape[axis]


def numbers(names: Iterable[str], pattern: str) -> set[int]:
    """The numbers that the group of a regular expression matches at the beginning of names."""
    return {int(match[1]) for name in names if (match := re.match(pattern, name))}


def count(names: Iterable[str], prefix: str) -> int:
    """How many numbers follow a prefix."""
    return len(numbers(names, re.escape(prefix) + r"(\d+)\."))


def decoder_options(of: Callable[[str, int], int], part: str, option: str) -> dict[str, object]:
    """The options of a :class:`~anystyle_backbones.dpt.Dpt`, by the lengths ``of`` axes of tensors."""
    channels = tuple(of(f"{part}.projects.{level}.weight", 0) for level in range(4))
    return {f"{option}_features": of(f"{part}.scratch.output_conv1.weight", 1), f"{option}_channels": channels}


def load_renamed(
    module: nn.Module, state: Mapping[str, Tensor], names: Mapping[str, str], *, what: str, layout: str
) -> None:
    """Load published tensors into a module, strictly; parameters that ``names`` leaves out stay as they are.

    Where a linear map here is a 1x1 convolution there, the weight loses its unit axes. An error says what the tensors
    should fit (``what``), and whose names these are (``layout``).
    """
    local = module.state_dict()
    squeezed = {name: _squeezed(tensor) for name, tensor in state.items()}
    unlike = differences({name: _squeezed(local[key]) for key, name in names.items()}, squeezed)
    if unlike:
        expected = f"{len(names)} tensors in the layout of {layout}"
        raise UserError(f"the checkpoint does not fit this {what}: {unlike} (expected: {expected})")
    fill(module, {key: state[name].reshape(local[key].shape) for key, name in names.items()})


def _squeezed(tensor: Tensor) -> Tensor:
    return tensor.flatten(1) if tensor.dim() > 2 and set(tensor.shape[2:]) == {1} else tensor
