"""What every frozen network of this package is: a door to its features, by the names of its layers."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, final

import torch
from jaxtyping import Float
from torch import Tensor, nn

RGB = "rgb"
"""The name under which every network offers the image itself."""


class Frozen(nn.Module):
    """A network that judges and never learns."""

    @final
    def train(self, mode: bool = True) -> "Frozen":
        """Stay in ``eval``, whatever is asked for: whoever owns this network may be training, it is not."""
        return super().train(False)

    def settle(self) -> None:
        """Compute what does not depend on images; called once, when the weights are in."""


def fold(conv: nn.Conv2d, norm: nn.Module) -> nn.Identity:
    """Put a normalisation with fixed statistics into the convolution before it; what takes its place does nothing.

    Args:
        conv: Changed.
        norm: Scales and shifts every channel; in float64, so that nothing but the last rounding is lost.
    """
    zero = torch.zeros(1, conv.out_channels, 1, 1, dtype=torch.float64)
    with torch.no_grad():
        norm = norm.double()
        shift = norm(zero).flatten()
        scale = norm(zero + 1).flatten() - shift
        if conv.bias is not None:
            shift = shift + conv.bias.double() * scale
        conv.weight = nn.Parameter((conv.weight.double() * scale.view(-1, 1, 1, 1)).to(conv.weight))
        conv.bias = nn.Parameter(shift.to(conv.weight))
    return nn.Identity()


class FeatureNetwork(Frozen, ABC):
    """A network that turns images into maps of features.

    The constructor sets ``layers``, the names it offers in the order of the computation; the first is ``rgb``, the
    image as it came.
    """

    layers: tuple[str, ...]

    @abstractmethod
    def forward(self, images: Float[Tensor, "M 3 H W"], layers: Sequence[str]) -> list[Float[Tensor, "M _ _ _"]]:
        """The features of sRGB images in [0, 1], one map a layer in the order asked for; nothing deeper is computed.

        Raises:
            ValueError: A layer is not offered, or the images are too small for it.
        """


def walk(
    stages: nn.Sequential,
    names: Mapping[str, int],
    images: Float[Tensor, "M 3 H W"],
    normalised: Float[Tensor, "M 3 H W"],
    layers: Sequence[str],
) -> list[Tensor]:
    """Run a chain of layers up to the deepest that is asked for and collect the others on the way.

    Args:
        stages: The chain.
        names: For each offered layer the place in the chain whose output it is.
        images: What ``rgb`` stands for.
        normalised: What the chain reads.
        layers: The names asked for.

    Raises:
        ValueError: A layer is not offered, or the images are too small for it.
    """
    unknown = [layer for layer in layers if layer != RGB and layer not in names]
    if unknown or not layers:
        raise ValueError(f"layers are {list(layers)}; choose from {', '.join([RGB, *names])}")
    wanted = {names[layer] for layer in layers if layer != RGB}
    found: dict[int, Tensor] = {}
    current = normalised
    for place in range(max(wanted, default=-1) + 1):
        # Below two pixels neither a reflecting border nor a pooling is defined.
        if min(current.shape[-2:]) < 2:
            height, width = images.shape[-2:]
            raise ValueError(f"images of {height}x{width} pixels are too small for {list(layers)}; enlarge them")
        current = stages[place](current)
        if place in wanted:
            found[place] = current
    return [images if layer == RGB else found[names[layer]] for layer in layers]


AnyFrozen = TypeVar("AnyFrozen", bound=Frozen)


def freeze(network: AnyFrozen) -> AnyFrozen:
    """Fix a network for good: no gradients, and no copy of its weights in anyone's state dict.

    A loss that holds it moves with it from device to device, but a training checkpoint does not repeat weights that
    lie in a file of their own.
    """
    network.requires_grad_(False)
    keys = tuple(network.state_dict())
    network.register_state_dict_post_hook(_leave_out)
    network.register_load_state_dict_pre_hook(partial(_put_back, keys))
    return network


def load_strictly(network: AnyFrozen, state: Mapping[str, Tensor], *, name: str, file: str | Path) -> AnyFrozen:
    """Fill a network to the last key and fix it for good.

    Args:
        network: To be filled.
        state: Under the network's own keys.
        name: Of the network, for the message.
        file: Where the weights come from, for the message.

    Raises:
        ValueError: A key is missing, is left over, or has another shape.
    """
    own = network.state_dict()
    wrong = sorted(
        key
        for key in own.keys() | state.keys()
        if key not in own or key not in state or own[key].shape != state[key].shape
    )
    if wrong:
        shown = ", ".join(wrong[:5]) + (", …" if len(wrong) > 5 else "")
        raise ValueError(f"{file} does not hold the weights of {name}: {len(wrong)} keys differ ({shown})")
    network.load_state_dict(state)
    network.train(False)
    network.settle()
    return freeze(network)


def _leave_out(module: nn.Module, state: dict[str, Any], prefix: str, metadata: Any) -> None:
    for key in [key for key in state if key.startswith(prefix)]:
        del state[key]


def _put_back(keys: tuple[str, ...], module: nn.Module, state: dict[str, Any], prefix: str, *rest: Any) -> None:
    own = {**dict(module.named_parameters()), **dict(module.named_buffers())}
    for key in keys:
        state.setdefault(prefix + key, own[key])
