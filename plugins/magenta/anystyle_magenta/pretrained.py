"""Loading weights: Magenta's published ones, from the Python package that holds them, and the bundled text tower's."""

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from anystyle.errors import UserError
from anystyle.io.checkpoint import load_part
from anystyle.vision import weights
from anystyle.vision.weights import Source, published
from anystyle_magenta.networks import StyledConv, StylePrediction, StyleTransfer, TextTower

# The published files are int8 ONNX graphs, read without the packages ``onnx`` and ``onnxruntime``. ONNX is a protocol
# buffer (onnx.proto3 of the ONNX specification, IR version 8; wire format: protobuf.dev/encoding); only what such a
# file needs is read: nodes, and initializers with raw data.
GRAPH = 7
"""Field of ``ModelProto``."""
NODE, INITIALIZER = 1, 5
"""Fields of ``GraphProto``."""
INPUT, OUTPUT, OPERATOR = 1, 2, 4
"""Fields of ``NodeProto``."""
DIMS, DATA_TYPE, NAME, RAW_DATA = 1, 2, 8, 9
"""Fields of ``TensorProto``."""
DTYPES = {1: np.dtype("<f4"), 3: np.dtype("<i1"), 6: np.dtype("<i4")}
"""``TensorProto.DataType``: float32, int8 and int32."""

VARINT, BYTES = 0, 2
"""Wire types."""
FIXED = {1: 8, 5: 4}
"""Bytes of the values of the other wire types."""


class Convolution(NamedTuple):
    """The weight (out, in / groups, height, width) and bias of a convolution, in float32."""

    weight: Tensor
    bias: Tensor


def read_convolutions(content: bytes) -> dict[str, Convolution]:
    """The convolutions of a graph whose weights and biases pass through ``DequantizeLinear``, by their outputs' names.

    Quantised values are ``scale * (integer - zero point)``, per tensor or per output channel.
    """
    try:
        graph = _bytes(content, GRAPH)[0]
        nodes = [_node(message) for message in _bytes(graph, NODE)]
        initializers = dict(_tensor(message) for message in _bytes(graph, INITIALIZER))
        constants = {
            outputs[0]: _dequantized(*(initializers[name] for name in inputs))
            for (operator,), inputs, outputs in nodes
            if operator == "DequantizeLinear" and inputs[0] in initializers
        }
        return {
            outputs[0]: Convolution(*(torch.from_numpy(constants[name]) for name in inputs[1:]))
            for (operator,), inputs, outputs in nodes
            if operator == "Conv"
        }
    except (IndexError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"no int8 ONNX graph, or a truncated one ({type(error).__name__}: {error})") from None


def _node(message: memoryview) -> list[list[str]]:
    """The operator, alone in a list, the inputs and the outputs."""
    return [[bytes(value).decode() for value in _bytes(message, field)] for field in (OPERATOR, INPUT, OUTPUT)]


def _tensor(message: memoryview) -> tuple[str, np.ndarray]:
    """An initializer by name; empty where its type or storage is not among those of convolutions."""
    name = bytes(_bytes(message, NAME)[0]).decode()
    dtype, raw = DTYPES.get(_integers(message, DATA_TYPE)[0]), _bytes(message, RAW_DATA)
    if dtype is None or not raw:
        return name, np.zeros(0)
    return name, np.frombuffer(raw[0], dtype).reshape(_integers(message, DIMS))


def _dequantized(integers: np.ndarray, scale: np.ndarray, zero_point: np.ndarray) -> np.ndarray:
    channels = (-1,) + (1,) * (integers.ndim - 1)
    difference = integers.astype(np.float32) - zero_point.astype(np.float32).reshape(channels)
    return difference * scale.reshape(channels)


def _bytes(message: bytes | memoryview, number: int) -> list[memoryview]:
    return [value for field, value in _fields(memoryview(message)) if field == number and not isinstance(value, int)]


def _integers(message: memoryview, number: int) -> list[int]:
    return [value for field, value in _fields(message) if field == number and isinstance(value, int)]


def _fields(message: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    """Every field of a message: its number, and the integer or the bytes that it holds."""
    position = 0
    while position < len(message):
        key, position = _varint(message, position)
        wire_type = key & 7
        if wire_type == VARINT:
            integer, position = _varint(message, position)
            yield key >> 3, integer
            continue
        if wire_type == BYTES:
            length, position = _varint(message, position)
        else:
            length = FIXED[wire_type]
        if position + length > len(message):
            raise ValueError("a field is longer than its message")
        yield key >> 3, message[position : position + length]
        position += length


def _varint(message: memoryview, position: int) -> tuple[int, int]:
    """The integer in groups of seven bits, least significant first, at a position, and the position after it."""
    value = shift = 0
    while True:
        byte = message[position]
        value |= (byte & 0x7F) << shift
        position += 1
        if byte < 0x80:
            return value, position
        shift += 7


PREDICTION, TRANSFER, TEXT = "magenta_predict", "magenta_transform", "magenta_text"
"""Rows of ``weights.toml``."""


def load_prediction(network: StylePrediction, path: str | Path | None = None) -> Source:
    """Fill the style prediction network from a file, or from where :func:`anystyle.vision.weights.find` looks."""
    convolutions, source = _read(PREDICTION, path)
    layers = [layer for layer in network.modules() if isinstance(layer, nn.Conv2d | nn.Linear)]
    # The graph lists its convolutions in the order of the computation, as the network does.
    for layer, convolution in zip(layers, convolutions.values(), strict=True):
        _fill(layer, convolution)
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
    return read_convolutions(content), Source(network=name, file=file.name, sha256=digest)


def _transfer_layers(network: StyleTransfer) -> Iterator[tuple[nn.Conv2d | nn.Linear, str]]:
    """Each layer with the name of its output in the published graph."""
    for index, conv in enumerate(network.contract, start=1):
        assert isinstance(conv, nn.Conv2d)
        yield conv, f"transformer/contract/conv{index}/Relu_prequant"
    styled: list[tuple[nn.Module, str]] = []
    for index, block in enumerate(network.residual, start=1):
        for part, layer in enumerate(block.children(), start=1):
            styled.append((layer, f"transformer/residual/residual{index}/conv{part}"))
    styled += [(layer, f"transformer/expand/conv{index}/conv") for index, layer in enumerate(network.expand, start=1)]
    for layer, name in styled:
        assert isinstance(layer, StyledConv)
        yield layer.conv, f"{name}/Conv2D_prequant"
        yield layer.shift, f"style_params/{name}/StyleNorm/Conv/BiasAdd_prequant"
        yield layer.scale, f"style_params/{name}/StyleNorm/Conv_1/BiasAdd_prequant"


@torch.no_grad()
def _fill(layer: nn.Conv2d | nn.Linear, convolution: Convolution) -> None:
    # A linear layer is a convolution of 1x1 there.
    layer.weight.copy_(convolution.weight.flatten(1).view(layer.weight.shape))
    if layer.bias is not None:
        layer.bias.copy_(convolution.bias)
