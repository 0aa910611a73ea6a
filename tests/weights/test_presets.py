"""The published sizes as presets: built without memory, filled from the file; and other precisions."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf
from safetensors.torch import save_file

import anystyle
from anystyle.pipeline.load import assemble, build_and_load
from anystyle.pipeline.weights import load_reference, reference_config
from anystyle.registry.catalog import catalog
from anystyle.registry.compose import compose, override
from anystyle.stylizer import Stylizer
from anystyle.testing.oracle import smooth_image
from anystyle.types import StyleEmbedding, Views
from tests.support.weights_cases import STYLE_DIM, small_checkpoint, training_checkpoint

# Parameters of the files, which the published code's own modules have.
PARAMETERS = {"anysplat": 1_190_736_456, "anystyle_head": 1_251_520_924, "anystyle_full": 1_869_372_828}
MASK_TOKEN, TEXT_ADAPTER = 1024, 525_312
PARTS = ("backbone", "branch")
ROOT = Path(__file__).parents[2]
WITHIN = 1.15
"""Peak memory while loading, in the weights' size."""


@pytest.mark.parametrize("name", PARAMETERS)
def test_presets_have_the_published_size(name: str) -> None:
    config = compose("stylize", [f"model={name}", "style_encoder=long_clip"])
    with torch.device("meta"):
        stylizer, _ = build_and_load(config, {}, {})
    count = sum(parameter.numel() for parameter in stylizer.backbone.parameters()) + MASK_TOKEN
    if config.weights.branch is not None:
        count += sum(parameter.numel() for parameter in stylizer.branch.parameters()) + TEXT_ADAPTER
        assert (stylizer.branch.aggregator is not None) is (name == "anystyle_full")
        assert config.style_encoder.text_adapter
    assert count == PARAMETERS[name]


def grown(file: Path, width: int, dtype: torch.dtype) -> None:
    """Write a checkpoint of a reduced depth, and of a width at which weights outweigh the program."""
    catalog().find("backbone", "anysplat").load()
    from anystyle_backbones.anysplat import AnySplat, keys

    with torch.device("meta"):
        backbone = AnySplat(dim=width, heads=width // 64, embed_depth=4, depth=5, taps=(1, 2, 3, 4), camera_depth=1)
    state = backbone.state_dict()
    shapes = {name: state[key].shape for key, name in keys.backbone_names(state).items()}
    shapes["aggregator.patch_embed.mask_token"] = torch.Size([1, width])
    save_file({f"encoder.{name}": torch.full(shape, 0.1, dtype=dtype) for name, shape in shapes.items()}, file)


LOAD = """
import json, sys
import torch
from anystyle.pipeline.load import build_and_load
from anystyle.pipeline.weights import load_reference
from anystyle.registry.compose import compose
from tests.support.resident import sampled_peak

with torch.device("meta"):  # the program itself, which is no matter of weights
    build_and_load(compose("stylize", ["~model", "backbone=anysplat", "style_encoder=long_clip"]), {}, {})
result = {}

def load():
    stylizer = load_reference(sys.argv[1], overrides=["backbone.taps=[1,2,3,4]", *sys.argv[2:]])
    tensors = list(stylizer.state_dict().values())
    sum(float(tensor.sum()) for tensor in tensors)  # looks at all, as a first pass would
    result["size"] = sum(tensor.numel() * tensor.element_size() for tensor in tensors)
    result["types"] = sorted({str(tensor.dtype) for tensor in tensors})

result["peak"] = -sampled_peak(lambda: None) + sampled_peak(load)
print(json.dumps(result))
"""
"""Loads a file, and prints the peak of the process's own memory above where it began."""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="memory of files is told apart on Linux")
@pytest.mark.parametrize(("stored", "precision"), [(torch.bfloat16, "fp32"), (torch.float32, "bf16")])
def test_loading_holds_no_second_copy(tmp_path: Path, stored: torch.dtype, precision: str) -> None:
    """Not even where every tensor changes its type; on files of 250 and 500 MB, in a process of its own."""
    grown(tmp_path / "it.safetensors", 512, stored)
    command = [sys.executable, "-c", LOAD, str(tmp_path / "it.safetensors"), f"precision={precision}"]
    told = json.loads(subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT).stdout)
    assert ("torch.bfloat16" in told["types"]) is (precision == "bf16")
    assert told["size"] > 400e6
    assert told["peak"] < WITHIN * told["size"], told


@pytest.fixture(scope="module", params=["head", "full"])
def small(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path, list[str]]:
    """A placement, a file of its checkpoint, and overrides that make its preset small, on that file."""
    file = tmp_path_factory.mktemp(request.param) / "all.ckpt"
    torch.save(training_checkpoint(request.param), file)
    sizes = OmegaConf.to_container(reference_config(small_checkpoint(request.param)).backbone, enum_to_str=True)
    assert isinstance(sizes, dict)
    plain = [override(f"backbone.{key}", value) for key, value in sizes.items() if key != "_target_"]
    towers = {"text_width": 64, "text_layers": 1, "image_width": 64, "image_layers": 1}
    plain += [f"style_encoder.{name}={value}" for name, value in towers.items()]
    return request.param, file, [*plain, "weights.style_encoder=null", *(f"weights.{part}={file}" for part in PARTS)]


def test_presets_load_one_file_into_all_parts(small: tuple[str, Path, list[str]]) -> None:
    placement, file, overrides = small
    stylizer, found = assemble(compose("stylize", [f"model=anystyle_{placement}", *overrides]))
    assert set(found) == {*PARTS} and len(found["branch"]["sha256"]) == 64
    reference = load_reference(file)
    for part in PARTS:
        expected = getattr(reference, part).state_dict()
        own = getattr(stylizer, part).state_dict()
        assert own.keys() == expected.keys() and all(torch.equal(own[key], expected[key]) for key in own)
    adapter = stylizer.style_encoder.get_submodule("adapter").state_dict()
    assert torch.equal(adapter["mlp.0.weight"], small_checkpoint(placement)["text_adapter.mlp.0.weight"])


@pytest.mark.parametrize("small", ["head"], indirect=True)
@pytest.mark.parametrize(
    ("model", "more", "told"),
    [
        ("anystyle_full", [], r"missing \(aggregator_injection[^\n]*trained with placement=head[^\n]*$"),
        ("anystyle_head", ["style_encoder.dim=64"], "trained with embeddings of 512 numbers, and the .*'s have 64"),
    ],
)
def test_a_checkpoint_of_another_model_is_refused(
    small: tuple[str, Path, list[str]], model: str, more: list[str], told: str
) -> None:
    with pytest.raises(ValueError, match=told):
        anystyle.load(model, [*small[2], *more])


def restyled(stylizer: Stylizer) -> tuple[torch.Tensor, torch.Tensor]:
    """Depth, and raw colours of the style branch: what no voxel's border can flip."""
    vector = torch.nn.functional.normalize(torch.linspace(-1, 1, STYLE_DIM)[None], dim=-1)
    embedding = StyleEmbedding(vector, vector)
    with torch.no_grad():
        scene = stylizer.encode(Views(smooth_image(5, (1, 2, 3, 56, 70))))
        gaussians = stylizer.restyle(scene, embedding)
        with stylizer._precision(torch.device("cpu")):
            color = stylizer.branch(scene, embedding).color
    assert gaussians.means.dtype == scene.geometry.depth.dtype == torch.float32
    assert torch.isfinite(gaussians.harmonics).all()
    return scene.geometry.depth, color.float()


@pytest.fixture(scope="module")
def exact() -> tuple[torch.Tensor, torch.Tensor]:
    return restyled(load_reference(small_checkpoint("full")))


@pytest.mark.parametrize("precision", ["bf16", "reference"])
def test_half_precision_is_near_full_precision(precision: str, exact: tuple[torch.Tensor, torch.Tensor]) -> None:
    stylizer = load_reference(small_checkpoint("full"), overrides=[f"precision={precision}"])
    for one, other in zip(exact, restyled(stylizer), strict=True):
        assert 0 < (one - other).square().mean().sqrt() / one.square().mean().sqrt() < 0.03
    types = {
        name: next(module.parameters()).dtype
        for name, module in stylizer.backbone.named_children()
        if any(True for _ in module.parameters())
    }
    assert types["embedder"] == types["aggregator"] == torch.bfloat16 and types["geometry_head"] == torch.float32
    low = torch.bfloat16 if precision == "bf16" else torch.float32
    assert types["gaussian_head"] == next(stylizer.branch.parameters()).dtype == low
