"""Frozen networks and their features, by the names of their layers."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, final

import torch
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.errors import UserError
from anystyle.io.checkpoint import load_strictly

RGB = "rgb"
"""The name under which every network offers the image itself."""


class Frozen(nn.Module):
    """A network that is never trained."""

    @final
    def train(self, mode: bool = True) -> "Frozen":
        """Stay in ``eval``, also where a module that owns this network is trained."""
        return super().train(False)


class FeatureNetwork(Frozen, ABC):
    """A network from images to maps of features.

    The constructor sets ``layers``, the names in the order of computation; the first is ``rgb``, the image itself.
    """

    layers: tuple[str, ...]

    @abstractmethod
    def forward(self, images: Float[Tensor, "M 3 H W"], layers: Sequence[str]) -> list[Float[Tensor, "M _ _ _"]]:
        """The features of sRGB images in [0, 1], one map for each of ``layers``; nothing deeper is computed.

        Raises:
            UserError: A layer is not offered, or the images are too small for it.
        """


def known_layers(layers: Sequence[str], known: Sequence[str]) -> Sequence[str]:
    """The layers; a UserError where there is none, or one that is not known."""
    if not layers or not {*layers} <= {*known}:
        raise UserError(f"layers are {list(layers)}; choose from {', '.join(known)}")
    return layers


def walk(
    stages: nn.Sequential,
    names: Mapping[str, int],
    images: Float[Tensor, "M 3 H W"],
    normalised: Float[Tensor, "M 3 H W"],
    layers: Sequence[str],
) -> list[Tensor]:
    """Run modules in a row up to the deepest requested layer and collect the outputs of all requested ones.

    The layer ``rgb`` is ``images``; every other is the output of the module whose index ``names`` gives.
    """
    requested = {names[layer] for layer in known_layers(layers, (RGB, *names)) if layer != RGB}
    outputs, x = {}, normalised
    for index in range(max(requested, default=-1) + 1):
        # Below two pixels neither a reflecting border nor a pooling is defined.
        if min(x.shape[-2:]) < 2:
            height, width = images.shape[-2:]
            raise UserError(f"images of {height}x{width} pixels are too small for {list(layers)}; enlarge them")
        x = stages[index](x)
        if index in requested:
            outputs[index] = x
    return [images if layer == RGB else outputs[names[layer]] for layer in layers]


AnyFrozen = TypeVar("AnyFrozen", bound=Frozen)


def freeze(network: AnyFrozen) -> AnyFrozen:
    """Disable a network's gradients, and leave its weights, which have a file of their own, out of all state dicts."""
    network.requires_grad_(False)
    keys = tuple(network.state_dict())
    network.register_state_dict_post_hook(_leave_out)
    network.register_load_state_dict_pre_hook(partial(_put_back, keys))
    return network


def load_frozen(network: AnyFrozen, state: Mapping[str, Tensor], file: Path) -> AnyFrozen:
    """Load weights strictly and freeze the network."""
    load_strictly(network, state, source=str(file))
    # Convolutions on a CPU take a fifth less time where the channels of a pixel lie side by side.
    network.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
    network.train(False)
    return freeze(network)


def _leave_out(module: nn.Module, state: dict[str, Any], prefix: str, metadata: Any) -> None:
    for key in [key for key in state if key.startswith(prefix)]:
        del state[key]


def _put_back(keys: tuple[str, ...], module: nn.Module, state: dict[str, Any], prefix: str, *rest: Any) -> None:
    tensors = {**dict(module.named_parameters()), **dict(module.named_buffers())}
    for key in keys:
        state.setdefault(prefix + key, tensors[key])
