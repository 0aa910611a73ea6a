"""The library's front door."""

from dataclasses import replace

import pytest
import torch

import anystyle
from anystyle.contracts import Placement
from anystyle.errors import UserError
from anystyle.io.checkpoint import read_header, save_part
from anystyle.methods.branch import Branch
from anystyle.pipeline.load import assemble, assemble_frozen, branch_header, default_device, load_model
from anystyle.pipeline.request import Request
from anystyle.pipeline.results import Restyler
from anystyle.registry.catalog import PluginError
from anystyle.registry.compose import compose
from anystyle.renderers.torch import TorchRenderer
from anystyle.testing.toy.injector import ToyInjector
from anystyle.testing.toy.method import ToyMethod
from anystyle.testing.toy.scenes import ToyScenes
from anystyle.testing.toy.stylizer import ToyStylizer
from anystyle.types import Site, Views
from tests.contracts.mutants import NeedsCameras, changed

UNTRAINED = ["weights.backbone=null", "weights.style_encoder=null", "weights.branch=null"]


def test_load_is_ready_for_use():
    stylizer = anystyle.load("tiny", UNTRAINED)
    assert isinstance(stylizer, anystyle.Stylizer) and not any(module.training for module in stylizer.modules())
    assert not any(parameter.requires_grad for parameter in stylizer.parameters())
    side = stylizer.backbone.patch_size * 4
    images = torch.rand(1, 2, 3, side, side, generator=torch.Generator().manual_seed(0))
    gaussians = stylizer.restyle(stylizer.encode(Views(images)), stylizer.embed(text="blue ink"))
    assert gaussians.means.shape[-1] == 3 and torch.isfinite(gaussians.means).all()


def test_load_takes_overrides():
    assert anystyle.load("tiny", [*UNTRAINED, "branch.styled=[color]"]).branch.styled == ("color",)


def test_load_says_what_is_wrong():
    with pytest.raises(ValueError, match=r"Could not find 'model/tyny'\. Did you mean 'tiny'\?"):
        anystyle.load("tyny")
    for word in ("branch=mine", "views=null", "weights=tiny"):
        with pytest.raises(ValueError, match=f"^{word}: '.*' has options and no choices; set one of"):
            anystyle.load("tiny", [word])
    with pytest.raises(ValueError, match="Could not override 'sed': Key 'sed' is unknown"):
        anystyle.load("tiny", ["sed=1"])


def test_build_takes_a_name():
    assert type(anystyle.build(Placement, "head")) is anystyle.catalog().find("placement", "head").load()
    with pytest.raises(PluginError, match=r"no placement is named 'haed'\. Did you mean 'head'\?"):
        anystyle.build(Placement, "haed")


MIXED = "branch.injectors={aggregator/*:film,head/tokens/?:{lora:{rank:3}},head/tokens/2:film}"


def test_sites_have_injectors_of_their_own(tmp_path):
    """By patterns, of which the last one that matches counts; a branch's file fits the same ones alone."""
    words = [*UNTRAINED, "placement=full"]
    stylizer = anystyle.load("tiny", [*words, MIXED])
    assert {site: type(injector).__name__ for site, injector in stylizer.branch.injectors.items()} == {
        site.name: "FiLM" if site.name.startswith("agg") or site.name == "head/tokens/2" else "LoRA"
        for site in stylizer.backbone.sites
        if site.tapped and site.name != "head/direct"
    } | {"head/direct": "ZeroConv"}
    header = branch_header(compose("stylize", ["model=tiny", *words, MIXED]), stylizer.branch, {})
    save_part(tmp_path / "branch.safetensors", stylizer.branch, header)
    file = f"weights.branch={tmp_path / 'branch.safetensors'}"
    again = anystyle.load("tiny", [*words, MIXED, file]).branch.state_dict()
    assert all(torch.equal(again[key], tensor) for key, tensor in stylizer.branch.state_dict().items())
    assert read_header(tmp_path / "branch.safetensors").config["branch"]["injectors"]["head/tokens/2"] == "film"
    with pytest.raises(ValueError, match="does not fit this StyleBranch"):
        anystyle.load("tiny", [*words, file])


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ("{aggregator/*:flim}", "no injector is named 'flim'. Did you mean 'film'?"),
        ("{agregator/*:film}", r"no site is called 'agregator/\*' here; there are: head/tokens/0"),
        ("{head/*:{film:{hiden:3}}}", "has no option 'hiden'. Did you mean 'hidden'?"),
        ("{head/*:{film:{hidden:a}}}", "injector.hidden=a: Value 'a'"),
        ("{head/*:{film:{},lora:{}}}", "is not one injector; give its name, or {NAME: {option: value}}"),
        ("{head/*:3}", "3 is not one injector"),
    ],
)
def test_injectors_of_sites_are_checked(given, told):
    with pytest.raises(ValueError, match=told):
        anystyle.load("tiny", [*UNTRAINED, f"branch.injectors={given}"])


def test_an_injector_may_ask_for_its_site(monkeypatch):
    monkeypatch.setattr("anystyle.registry.catalog._OWN", {})

    @anystyle.plugin("injector", "placed")
    class Placed(ToyInjector):
        """Knows where it is."""

        def __init__(self, *, dim: int, style_dim: int, site: Site) -> None:
            super().__init__(dim=dim, style_dim=style_dim)
            self.site = site

    branch = anystyle.load("tiny", [*UNTRAINED, "injector=placed"]).branch
    assert {name: injector.site.name for name, injector in branch.injectors.items()} == {n: n for n in branch.injectors}


def test_what_is_untrained_is_told(caplog):
    anystyle.load("tiny")
    assert not caplog.records
    anystyle.load("tiny", UNTRAINED)
    told = [message.partition(" is untrained")[0] for message in caplog.messages]
    assert told == ["the backbone", "the style branch"]


@pytest.mark.parametrize(("words", "poses"), [((), "auto"), (("backbone.trusted_cameras=true",), "predicted")])
def test_a_backbone_says_whether_its_cameras_are_taken(words, poses):
    assert load_model(Request(overrides=words)).poses == poses
    in_memory = load_model(Request(overrides=words), stylizer=anystyle.load("tiny", [*UNTRAINED]))
    assert in_memory.poses == "predicted" and type(in_memory.method) is Branch


def test_a_backbone_that_needs_cameras_is_given_them():
    views, stylizer = ToyScenes(num_scenes=1, size=(16, 24)).read(0, [0, 1]), ToyStylizer()
    stylizer.backbone = NeedsCameras().freeze()
    stylizer.eval()
    (done,) = anystyle.stylize(views, "deep blue", model=stylizer)
    torch.testing.assert_close(done.cameras.intrinsics, views.cameras.intrinsics)
    with pytest.raises(UserError, match=r"\Athis source knows no cameras of its scenes"):
        anystyle.stylize(replace(views, cameras=None), "deep blue", model=stylizer)
    with pytest.raises(UserError, match=r"\ANeedsCameras needs the cameras of its views, which have none; poses=known"):
        anystyle.stylize(views, "deep blue", model=stylizer, poses=anystyle.PoseOptions("predicted"))


def test_what_a_method_or_a_renderer_gives_is_checked():
    views, stylizer = ToyScenes(num_scenes=1, size=(16, 24)).read(0, [0, 1]), ToyStylizer().eval()
    (done,) = results = anystyle.stylize(views, "deep blue", model=stylizer)
    method = changed(ToyMethod, "__call__", lambda gaussians: None)()
    with pytest.raises(UserError, match="given the method ChangedToyMethod returned a NoneType; expected a Gaussians"):
        Restyler(results.run.restyler.encoded, method)(done.style)
    stylizer.renderer = changed(TorchRenderer, "__call__", lambda renders: renders.map(lambda tensor: tensor.mT))()
    with pytest.raises(UserError, match=r"given the renderer ChangedTorchRenderer: Renders\.color is .*, 3, 24, 16\]"):
        stylizer.render(done.gaussians, done.cameras)


def test_a_card_that_does_not_compute_is_said_and_the_cpu_taken(monkeypatch, caplog):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)

    def full(*size: int, device: str) -> torch.Tensor:
        raise torch.OutOfMemoryError(f"{device} out of memory")

    monkeypatch.setattr(torch, "ones", full)
    assert default_device() == torch.device("cpu")
    assert "the graphics card is not used, and the CPU computes (cuda out of memory)" in caplog.text


@pytest.mark.parametrize(
    ("words", "device", "precision"),
    [((), "cpu", "fp32"), ((), "meta", "reference"), (("precision=fp32",), "meta", "fp32")],
)
def test_auto_is_the_published_precision_on_a_card_and_exact_elsewhere(words, device, precision):
    config = compose("stylize", ["model=tiny", *words])
    stylizer, _ = assemble_frozen(config, torch.device(device))  # meta stands for a card: not the CPU
    assert stylizer.precision == precision and stylizer.device.type == device
    half = {parameter.dtype for parameter in stylizer.backbone.aggregator.parameters()} == {torch.bfloat16}
    assert half == (precision == "reference")
    assert assemble(config, learns=True)[0].precision == "fp32"  # a training has trainer.precision
