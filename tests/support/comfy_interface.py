"""What ComfyUI publishes of its node interface, as far as these nodes use it, and an executor of prompts.

Facts from its documentation and API of version 0.27: the V3 schema (docs.comfy.org/custom-nodes/v3_migration), prompts
of the HTTP API, nodes running in inference mode, the type ``SPLAT``.
"""

import asyncio
import inspect
import sys
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import ClassVar

import torch

ROOT = Path(__file__).parents[2] / "plugins" / "comfyui"

CORE = {  # nodes of ComfyUI that the example workflows use: types of inputs and outputs
    "LoadImage": ({}, ["IMAGE", "MASK"]),
    "PreviewImage": ({"images": "IMAGE"}, ["IMAGE"]),
    "SaveImage": ({"images": "IMAGE"}, ["IMAGE"]),
    "CreateVideo": ({"images": "IMAGE"}, ["VIDEO"]),
    "SaveVideo": ({"video": "VIDEO"}, ["VIDEO"]),
    "GetSplatCount": ({"splat": "SPLAT"}, ["SPLAT", "INT"]),
    "RenderSplat": ({"splat": "SPLAT"}, ["IMAGE", "MASK"]),
}
OUTPUTS = {"PreviewImage", "SaveImage", "SaveVideo", "AnyStyleSaveScene"}


class Interrupted(BaseException):
    pass


@dataclass
class Slot:
    id: str = ""
    type: str = ""
    display_name: str = ""
    optional: bool = False
    default: object = None
    options: list = field(default_factory=list)
    min: float | None = None
    max: float | None = None
    step: float | None = None
    multiline: bool = False
    tooltip: str = ""


def kind(name):
    def make_input(id, **given):
        return Slot(id, name, **given)

    def make_output(display_name):
        return Slot(type=name, display_name=display_name)

    return SimpleNamespace(Input=make_input, Output=make_output)


@dataclass
class Schema:
    node_id: str
    display_name: str
    category: str
    description: str
    inputs: list
    outputs: list
    is_output_node: bool = False


class NodeOutput:
    def __init__(self, *args, ui=None):
        self.args, self.ui = args, ui


class Splat:
    def __init__(self, positions, scales, rotations, opacities, sh, counts=None):
        self.positions, self.scales, self.rotations = positions, scales, rotations
        self.opacities, self.sh, self.counts = opacities, sh, counts


class Bar:
    values: ClassVar[list] = []

    def __init__(self, total, node_id=None):
        self.total = total

    def update_absolute(self, value, total=None, preview=None):
        assert 0 <= value <= total
        Bar.values.append(value / total)


class Interface:
    def __init__(self, folder):
        self.folders = {name: folder / name for name in ("input", "output", "temp")}
        for path in self.folders.values():
            path.mkdir()
        self.cancelled, self.nodes = lambda: False, {}
        Bar.values = []

    def throw(self):
        if self.cancelled():
            raise Interrupted

    def load(self, module):
        extension = asyncio.run(module.comfy_entrypoint())
        self.nodes = {node.define_schema().node_id: node for node in asyncio.run(extension.get_node_list())}

    def run(self, prompt, core=lambda kind, inputs: (None, None)):
        """Execute a prompt of the HTTP API; the outputs of every node, in order."""
        results, ui = {}, {}

        def result(key):
            if key not in results:
                node, inputs = prompt[key], {}
                for name, value in node["inputs"].items():
                    linked = isinstance(value, list)
                    inputs[name] = result(value[0])[value[1]] if linked else value
                if node["class_type"] in CORE:
                    results[key] = core(node["class_type"], inputs)
                else:
                    cls = self.nodes[node["class_type"]]
                    self.check(cls, node["inputs"], prompt)
                    with torch.inference_mode():
                        output = cls.execute(**inputs)
                    results[key], ui[key] = output.args, output.ui
                    assert len(output.args) == len(cls.define_schema().outputs)
            return results[key]

        for key, node in prompt.items():
            if node["class_type"] in OUTPUTS:
                result(key)
        return results, ui

    def outputs_of(self, name):
        return CORE[name][1] if name in CORE else [slot.type for slot in self.nodes[name].define_schema().outputs]

    def check(self, cls, inputs, prompt):
        slots = {slot.id: slot for slot in cls.define_schema().inputs}
        assert inputs.keys() <= slots.keys()
        assert {name for name, slot in slots.items() if not slot.optional} <= inputs.keys()
        for name, value in inputs.items():
            slot = slots[name]
            if isinstance(value, list):
                assert self.outputs_of(prompt[value[0]]["class_type"])[value[1]] == slot.type
            else:
                assert value in slot.options if slot.type == "COMBO" else True
                assert slot.min is None or slot.min <= value <= slot.max
                assert isinstance(value, {"STRING": str, "INT": int, "FLOAT": (int, float), "COMBO": str}[slot.type])


def install(monkeypatch, folder):
    interface = Interface(folder)
    names = {"Image": "IMAGE", "String": "STRING", "Int": "INT", "Float": "FLOAT", "Combo": "COMBO", "Splat": "SPLAT"}
    io = SimpleNamespace(
        ComfyNode=type("ComfyNode", (), {}),
        Schema=Schema,
        NodeOutput=NodeOutput,
        Custom=kind,
        **{name: kind(type_) for name, type_ in names.items()},
    )

    def save_path(prefix, output):
        path = Path(output, prefix)
        path.parent.mkdir(parents=True, exist_ok=True)
        return str(path.parent), path.name, 1, "", prefix

    modules = {
        "comfy_api.latest": {
            "io": io,
            "ui": SimpleNamespace(PreviewText=lambda value: value),
            "Types": SimpleNamespace(SPLAT=Splat),
            "ComfyExtension": type("ComfyExtension", (), {}),
        },
        "comfy.utils": {"ProgressBar": Bar},
        "comfy.model_management": {"throw_exception_if_processing_interrupted": interface.throw},
        "folder_paths": {
            "get_save_image_path": save_path,
            **{f"get_{name}_directory": lambda path=path: str(path) for name, path in interface.folders.items()},
        },
    }
    for name, content in modules.items():
        for module in {name.partition(".")[0], name}:
            monkeypatch.setitem(sys.modules, module, ModuleType(module))
        vars(sys.modules[name]).update(content)
    return interface


def parameters(cls):
    return list(inspect.signature(cls.execute).parameters)


def prompt_of(graph, changes):
    """A workflow as the browser keeps it, as a prompt of the HTTP API; ``changes`` are widget values by type of node.

    Each node's widgets are named in its inputs, in the order of its values. The second value of ComfyUI's own
    ``LoadImage`` is the button that uploads, and no input.
    """
    links = {link[0]: link for link in graph["links"]}
    prompt = {}
    for node in graph["nodes"]:
        values, inputs = list(node["widgets_values"]), {}
        for slot in node["inputs"]:
            if "widget" in slot:
                inputs[slot["name"]] = values.pop(0)
            elif slot["link"] is not None:
                _, source, output, *_ = links[slot["link"]]
                inputs[slot["name"]] = [str(source), output]
        assert values in ([], ["image"]), f"{node['type']} has more values than widgets"
        prompt[str(node["id"])] = {"class_type": node["type"], "inputs": inputs | changes.get(node["type"], {})}
    return prompt
