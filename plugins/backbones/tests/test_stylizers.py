"""Styl3R and Stylos: style branches and style encoders of their own, from photographs to files and in training."""

import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from plyfile import PlyData

from anystyle.cli.launch import launch
from anystyle.commands import stylize
from anystyle.commands.train import run
from anystyle.contracts import Backbone, StyleEncoder
from anystyle.errors import UserError
from anystyle.io.sheet import to_pil
from anystyle.pipeline.load import PARTS, assemble
from anystyle.pipeline.options import BranchOptions
from anystyle.registry.catalog import catalog
from anystyle.registry.compose import compose, override
from anystyle.stylizer import Stylizer
from anystyle.testing.oracle import smooth_image
from anystyle.testing.toy.renderer import ToyRenderer
from anystyle.types import Scene, StyleEmbedding, Tokens
from anystyle.vision.preprocess import eight_bit
from tests.support.backbone_cases import network, same, views

AS_THE_NETWORK_READS = {
    "styl3r": {"resolution": None, "style_range": "symmetric"},
    "stylos": {"resolution": None, "native_resolution": 56},
}
"""Options by which a style encoder reads a picture as the network reads its photographs."""
FIRST_VIEW: dict[str, Callable[[StyleEncoder, Scene], Tokens]] = {
    "styl3r": lambda encoder, scene: encoder.embed_tokens(scene.views.images[:, 0]),
    "stylos": lambda encoder, scene: replace(scene.stem, data=scene.stem.patches[:, :1], special=0),
}
"""Tokens of the first photograph, as the network computes unstyled colours with."""


@pytest.fixture(scope="module", params=["styl3r", "stylos"])
def name(request: pytest.FixtureRequest) -> str:
    return request.param


def encoder_of(name: str, **options: object) -> StyleEncoder:
    plugin = catalog().find("style_encoder", name).load()
    return plugin(**(plugin.example(Path()) | options)).eval()


def file_of(backbone: Backbone) -> dict[str, torch.Tensor]:
    """A file of this network, which holds its style branch and encoder as well."""
    published = backbone.checkpoints()
    assert published is not None
    state = backbone.state_dict()
    return {name: state[key] for key, name in published.names(state).items()}


@pytest.fixture(scope="module")
def stylizer(name: str) -> Stylizer:
    backbone, encoder = network(name), encoder_of(name, **AS_THE_NETWORK_READS[name])
    encoder.load_published(file_of(backbone))
    branch = backbone.make_branch()
    assert branch is not None
    return Stylizer(backbone=backbone, style_encoder=encoder, branch=branch, renderer=ToyRenderer()).eval()


@pytest.fixture(scope="module")
@torch.no_grad()
def scene(stylizer: Stylizer) -> Scene:
    return stylizer.encode(views(3, patch=stylizer.backbone.patch_size))


def picture(index: int, stylizer: Stylizer, rows: int = 2, columns: int = 3) -> torch.Tensor:
    patch = stylizer.backbone.patch_size
    return smooth_image(index, (1, 3, rows * patch, columns * patch))


def styled(stylizer: Stylizer, scene: Scene, tokens: Tokens) -> torch.Tensor:
    vector = tokens.data.mean((1, 2))
    return stylizer.branch(scene, StyleEmbedding(vector, vector, tokens=tokens)).color


@torch.no_grad()
@pytest.mark.parametrize("number", [1, 2, 3])
def test_the_first_view_as_style_is_no_style_to_the_bit(name: str, stylizer: Stylizer, number: int) -> None:
    scene = stylizer.encode(views(number, scenes=2, patch=stylizer.backbone.patch_size))
    tokens = FIRST_VIEW[name](stylizer.style_encoder, scene)
    assert torch.equal(styled(stylizer, scene, tokens), scene.attributes.color)
    in_its_own_style = stylizer.restyle(scene, stylizer.embed(image=scene.views.images[:, 0]))
    same(in_its_own_style, stylizer.unstyled(scene))


@torch.no_grad()
def test_style_changes_colours_alone(stylizer: Stylizer, scene: Scene) -> None:
    one, other = (stylizer.restyle(scene, stylizer.embed(image=picture(index, stylizer))) for index in (7, 9))
    for attribute, tensor in vars(one).items():
        assert torch.equal(getattr(other, attribute), tensor) == (attribute != "harmonics"), attribute


@torch.no_grad()
def test_a_style_has_a_grid_of_its_own(stylizer: Stylizer, scene: Scene) -> None:
    tall = stylizer.embed(image=picture(7, stylizer, 4, 1)).tokens
    assert tall is not None and tall.grid == (4, 1) != scene.stem.grid
    assert not torch.equal(styled(stylizer, scene, tall), styled(stylizer, scene, replace(tall, grid=(1, 4))))


def test_a_branch_holds_copies_alone(stylizer: Stylizer) -> None:
    backbone, branch = stylizer.backbone, stylizer.branch
    assert [name for name, _ in branch.named_children()] == ["aggregator", "gaussian_head", "injectors"]
    assert all(parameter.requires_grad for parameter in branch.parameters()) and not len(branch.injectors)
    assert not {id(each) for each in branch.parameters()} & {id(each) for each in backbone.parameters()}


def test_texts_are_refused(stylizer: Stylizer, scene: Scene) -> None:
    with pytest.raises(UserError, match=r"'red': \w+ reads style images, no texts"):
        stylizer.embed(text="red")
    vector = torch.zeros(1, stylizer.style_encoder.dim)
    with pytest.raises(UserError, match="reads the tokens of a style image"):
        stylizer.branch(scene, StyleEmbedding(vector, vector))


@torch.no_grad()
def test_style_images_are_cut_to_a_square_and_pass_once(name: str) -> None:
    encoder = encoder_of(name, resolution=112)
    square, passes = eight_bit(smooth_image(3, (2, 3, 112, 112))), []
    next(encoder.children()).register_forward_hook(lambda *given: passes.append(given))
    vector, tokens = encoder.embed_both(square)
    assert len(passes) == 1 and tokens.special == 0
    torch.testing.assert_close(vector, tokens.data.mean((1, 2)))
    assert torch.equal(vector, encoder.embed_images(square)) and encoder.token_dim == encoder.dim
    wide = torch.cat([torch.zeros(2, 3, 112, 40), square, torch.ones(2, 3, 112, 40)], dim=-1)
    assert encoder.embed_tokens(wide).grid == tokens.grid
    torch.testing.assert_close(encoder.embed_tokens(wide).data, tokens.data)


def small(name: str, folder: Path) -> list[str]:
    """The examples' networks, as overrides."""
    words = []
    for kind in ("backbone", "style_encoder"):
        options = catalog().find(kind, name).load().example(folder)
        words += [override(f"{kind}.{option}", value) for option, value in options.items()]
    return words


@pytest.mark.parametrize("learns", [False, True])
def test_parts_share_the_tensors_of_their_file_unless_they_learn(name: str, learns: bool, tmp_path: Path) -> None:
    file, own = tmp_path / "model.ckpt", network(name)
    torch.save({"state_dict": file_of(own)}, file)
    encoder = AS_THE_NETWORK_READS[name].get("native_resolution")
    words = [f"style_encoder.native_resolution={encoder}"] if encoder else []
    words += [f"weights.{part}={file}" for part in PARTS]
    stylizer, found = assemble(compose("stylize", [f"model={name}", *small(name, tmp_path), *words]), learns=learns)
    assert set(found) == set(PARTS)
    same(stylizer.backbone.state_dict(), own.state_dict())
    places = {tensor.data_ptr() for tensor in stylizer.backbone.state_dict().values()}
    assert {tensor.data_ptr() for tensor in stylizer.style_encoder.state_dict().values()} <= places
    assert all((tensor.data_ptr() in places) is not learns for tensor in stylizer.branch.state_dict().values())


def test_photographs_and_a_painting_to_a_scene(
    name: str, tmp_path: Path, caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]
) -> None:
    """The command, with networks that no weights are named for: it says so, and refuses a text."""
    (tmp_path / "photos").mkdir()
    for number in range(2):
        to_pil(smooth_image(number, (3, 70, 100))).save(tmp_path / "photos" / f"{number}.png")
    to_pil(smooth_image(7, (3, 70, 84))).save(tmp_path / "a.png")
    words = [str(tmp_path / "photos"), f"model={name}", *small(name, tmp_path), "weights.backbone=null"]
    words += ["poses=predicted", "video.frames=2", "video.scale=0.5"]
    with caplog.at_level(logging.INFO):
        stylize.main([*words, "--image", str(tmp_path / "a.png"), "--out", str(tmp_path / "out")])
    assert len(PlyData.read(tmp_path / "out" / "scene.ply")["vertex"]) > 1000
    assert "the backbone is untrained" in caplog.text
    assert ("a field of view of 60 degrees" in caplog.text) == (name == "styl3r")
    with pytest.raises(SystemExit) as caught:
        stylize.main([*words, "--text", "red", "--out", str(tmp_path / "text")])
    assert caught.value.code == 2 and "reads style images, no texts" in capsys.readouterr().err.splitlines()[-1]


TRAINING = (
    "trainer=cpu", "trainer.max_steps=2", "workers=0", "loggers=[csv]", "renderer=cpu", "scenes=procedural",
    "scenes.num_scenes=2", "scenes.samples=1", "styles=procedural", "styles.num_styles=2", "training.batch_size=1",
    "training.context_views=[2,2]", "training.spread=any", "training.pool=2", "training.warmup=1", "name=x",
)  # fmt: skip
OWN = {
    "styl3r": (
        "loss.content.network=texture", "loss.style.network=texture", "loss.identity.network=texture",
        "training.heights=[32,32]", "training.width=32",
    ),
    "stylos": (
        "loss.adain_voxels.network=texture", "loss.adain_voxels.layers=[relu1_1,relu2_1]", "training.heights=null",
        "training.width=null", "scenes.size=28", "styles.size=28",
    ),
}  # fmt: skip


def test_two_steps_of_the_second_stage(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    words = [f"experiment={name}", *TRAINING, *OWN[name], *small(name, tmp_path), "weights.backbone=null"]
    launch("train", run, words)
    assert "2 steps done; " in capsys.readouterr().out
    assert (tmp_path / "runs" / "x" / "branch.safetensors").is_file()
    with pytest.raises(UserError, match=r"reads tokens of images, and texts have none; set training\.text_ratio=0"):
        launch("train", run, [*words, "training.text_ratio=0.5", "name=y"])


def test_styl3rs_experiment_is_the_published_second_stage() -> None:
    config = compose("train", ["experiment=styl3r", "name=x", "out=x"])
    assert (config.loss.content.weight, config.loss.style.weight, config.loss.identity.weight) == (1, 10, 1)
    assert config.loss.identity.pixels == 70 and config.loss.content.layers == ["relu3_1", "relu4_1"]
    assert config.style_encoder.style_range.name == "symmetric" and config.styles.text_only == 0
    assert config.training.learning_rate == 2e-4 and config.training.aggregator_rate == 1
    assert config.trainer.max_steps == 35001 and config.trainer.gradient_clip_val == 0.5 and config.branch.published


def test_stylos_experiment_is_as_published_where_it_can_be() -> None:
    config = compose("train", ["experiment=stylos", "name=x", "out=x"])
    training, adain = config.training, config.loss.adain_voxels
    assert config.branch.published and config.trainer.max_steps == 30000 and config.trainer.gradient_clip_val == 1.0
    assert training.learning_rate == 2e-4 and training.aggregator_rate == 1.0 and training.weight_decay == 0.05
    assert list(training.betas) == [0.9, 0.95] and training.warmup == 1000 and training.floor == 2e-7
    assert adain.pool.name == "voxels" and adain.content_weight == 0.1 and adain.voxel_size == 0.002
    assert config.loss.diagonal_variation.weight == 10.0


def test_options_that_the_published_branch_fixes_are_refused() -> None:
    with pytest.raises(UserError, match="set no other option of branch with it"):
        BranchOptions(published=True, styled=["rotation"])
