"""Each node against ComfyUI's published interface, and the example workflows through an executor of prompts."""

import importlib
import json
from dataclasses import fields

import pytest
import torch
from plyfile import PlyData

from anystyle.errors import UserError
from anystyle.testing.inputs import gaussians
from anystyle.types import Gaussians
from tests.support import comfy_interface
from tests.support.comfy_interface import ROOT, Bar, Interrupted, parameters, prompt_of

WORKFLOWS = sorted((ROOT / "example_workflows").glob("*.json"))
SMALL = {"AnyStyleLoadModel": {"model": "tiny", "options": "splat.cameras=3 views.short_side=32 views.take=3"}}


@pytest.fixture
def scene(comfy):
    scene = gaussians(1, 60, 1)
    scene.save(comfy.folders["input"] / "scene.ply")
    return scene


def prompted(path, **changes):
    """The prompt of a workflow, small, of the splat in the input folder unless ``changes`` name another source."""
    source = {"AnyStyleLoadCapture": {"source": "scene.ply"}, "AnyStyleRender": {"frames": 3}}
    return prompt_of(json.loads(path.read_text()), SMALL | source | changes)


def test_schemas_fit_their_nodes(comfy):
    assert len(comfy.nodes) == 11
    for name, cls in comfy.nodes.items():
        schema = cls.define_schema()
        assert name.startswith("AnyStyle") and schema.display_name and schema.description.endswith(".")
        assert parameters(cls) == [slot.id for slot in schema.inputs]
        for slot in schema.inputs:
            assert slot.type != "COMBO" or slot.default in slot.options
            assert slot.min is None or slot.min <= slot.default <= slot.max


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_workflows_name_what_there_is(comfy, path):
    """Every node exists, has all its inputs, and links join equal types."""
    graph = json.loads(path.read_text())
    prompt = prompt_of(graph, {})
    for node in prompt.values():
        if node["class_type"] in comfy.nodes:
            comfy.check(comfy.nodes[node["class_type"]], node["inputs"], prompt)
        else:
            for name, kind in comfy_interface.CORE[node["class_type"]][0].items():
                source, output = node["inputs"][name]
                assert comfy.outputs_of(prompt[source]["class_type"])[output] == kind


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_workflows_run(comfy, path, scene):
    seen = []

    def core(kind, inputs):
        seen.extend(inputs[name] for name in ("images",) if name in inputs)
        return torch.rand(1, 20, 30, 4), None

    prompt = prompted(path)
    results, _ = comfy.run(prompt, core)
    for images in seen:
        assert images.ndim == 4 and images.shape[-1] in (3, 4) and 0 <= float(images.min()) <= float(images.max()) <= 1
    for key, node in prompt.items():
        if node["class_type"] == "AnyStyleSaveScene":
            written = Gaussians.load(results[key][0])
            torch.testing.assert_close(written.means, scene.means, atol=1e-5, rtol=0)
            assert results[key][0].startswith(str(comfy.folders["output"]))
    assert seen or "splat" in path.stem
    if "AnyStyleRender" in path.read_text():
        assert 1 in Bar.values


def test_a_cancelled_prompt_ends_within_a_step(comfy, scene):
    calls = []
    comfy.cancelled = lambda: calls.append(1) or len(calls) > 3
    with pytest.raises(Interrupted):
        comfy.run(prompted(WORKFLOWS[0]))
    assert len(calls) == 4 and not any(comfy.folders["output"].iterdir())
    parameter = torch.nn.Parameter(torch.ones(1))
    parameter.grad = torch.ones(1)
    torch.optim.SGD([parameter], lr=0.1).step()
    assert len(calls) == 4, "hooks of a node outlive it"


def test_mistakes_are_one_line(comfy):
    (comfy.folders["input"] / "empty").mkdir()
    with pytest.raises(UserError, match="empty"):
        comfy.run(prompted(WORKFLOWS[0], AnyStyleLoadCapture={"source": "empty"}))


def test_splats_convert_exactly(comfy, scene):
    """Numbers come back bit for bit, without padding; ComfyUI's own layout of PLY is the same."""
    values = importlib.import_module("custom_nodes_anystyle.anystyle_comfyui.values")
    unit = torch.nn.functional.normalize(scene.rotations, dim=-1)
    scene = Gaussians(scene.means, unit, scene.scales, scene.opacities.clamp(0.01, 0.99), scene.harmonics)
    splat = comfy_interface.Splat(**values.splat_columns(scene))
    assert splat.opacities.shape == (1, 60, 1) and splat.counts is None
    unit_again = torch.nn.functional.normalize(unit, dim=-1)
    back = values.gaussians_from_splat(splat)
    for item in fields(Gaussians):
        want = unit_again if item.name == "rotations" else getattr(scene, item.name)
        assert torch.equal(getattr(back, item.name), want), item.name
    columns = {name: column for name, column in vars(splat).items() if name != "counts"}
    columns = {name: torch.nn.functional.pad(of, [0, 0] * (of.ndim - 2) + [0, 4]) for name, of in columns.items()}
    padded = comfy_interface.Splat(**columns, counts=torch.tensor([60]))
    assert torch.equal(values.gaussians_from_splat(padded).means, scene.means)

    node = comfy.nodes["AnyStyleCaptureFromSplat"]
    with torch.inference_mode():
        path = node.execute(padded, 0).args[0]
    columns = PlyData.read(path)["vertex"]
    x, scale = torch.from_numpy(columns["x"].copy()), torch.from_numpy(columns["scale_0"].copy())
    assert torch.equal(x, scene.means[0, :, 0])
    torch.testing.assert_close(scale.exp(), scene.scales[0, :, 0])
    with pytest.raises(ValueError, match="index=1"):
        node.execute(padded, 1)


def test_a_batch_of_images_is_a_folder(comfy):
    images = torch.rand(3, 24, 32, 3)
    node = comfy.nodes["AnyStyleLoadCapture"]
    with torch.inference_mode():
        first, again = (node.execute("", images).args[0] for _ in range(2))
    assert first == again and len(list(first.iterdir())) == 3 and first.parent == comfy.folders["temp"]
    before = node.fingerprint_inputs("photos")
    (comfy.folders["input"] / "photos").mkdir()
    (comfy.folders["input"] / "photos" / "1.png").write_bytes(b"1")
    assert node.fingerprint_inputs("photos") != before
