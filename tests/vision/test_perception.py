"""The door to frozen networks: published keys, strict loading, clear refusals, and no weights in anyone's state."""

import zipfile
from pathlib import Path

import pytest
import torch
import torch.nn.functional as F
from safetensors.torch import save_file
from torch import nn

from anystyle.io.checkpoint import read_header
from anystyle.testing.oracle import assert_matches, fill_named, smooth_image
from anystyle.vision import networks, weights
from anystyle.vision.vgg import VGG19, Texture
from tests.support.oracle import golden
from tests.support.style_cases import VGG_RULES, filled_vgg_file

PAPER_LAYERS = ("relu1_1", "relu2_1", "relu3_1", "relu4_1")


@pytest.fixture(scope="module")
def vgg() -> networks.FeatureNetwork:
    return networks.load("vgg19", filled_vgg_file())


def test_vgg_features_match_the_reference(vgg: networks.FeatureNetwork) -> None:
    records = golden("golden_metrics")["style_content_loss"]["vgg_features_pred"]
    images = F.interpolate(smooth_image(4501, [4, 3, 84, 112]), size=(224, 224), mode="bilinear", antialias=True)
    with torch.no_grad():
        found = vgg(images, PAPER_LAYERS)
    for features, record in zip(found, records, strict=True):
        assert_matches(features, record)


@pytest.mark.parametrize("network", [VGG19, Texture])
def test_layers_are_what_the_chain_computes(network: type[networks.FeatureNetwork]) -> None:
    net = network().eval()
    net.load_state_dict(fill_named(net.state_dict(), VGG_RULES))
    images = smooth_image(7, [2, 3, 35, 42])
    names = net.layers[1:]
    with torch.no_grad():
        together = net(images, names)
        # Asked for one at a time, in any order, with repeats: the same maps.
        again = net(images, ("relu2_2", "rgb", "relu1_1", "relu2_2"))
    by_name = dict(zip(names, together, strict=True))
    assert again[1] is images
    for place, name in ((0, "relu2_2"), (2, "relu1_1"), (3, "relu2_2")):
        torch.testing.assert_close(again[place], by_name[name], rtol=0, atol=0)
    for name, features in by_name.items():
        block = int(name[4])
        assert features.shape[-2:] == (35 >> (block - 1), 42 >> (block - 1)), name
        assert features.min() >= 0, name


def test_a_frozen_network_never_learns_and_adds_nothing_to_a_state_dict(vgg: networks.FeatureNetwork) -> None:
    assert not vgg.training and not any(parameter.requires_grad for parameter in vgg.parameters())
    owner = nn.ModuleDict({"network": vgg, "own": nn.Linear(2, 2)})
    owner.train()
    assert not vgg.training
    state = owner.state_dict()
    assert set(state) == {"own.weight", "own.bias"}
    before = next(vgg.parameters()).clone()
    assert str(owner.load_state_dict(state)) == "<All keys matched successfully>"
    torch.testing.assert_close(next(vgg.parameters()), before, rtol=0, atol=0)


def test_weights_are_looked_for_in_named_folders_then_in_the_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(weights.FOLDERS, f"{tmp_path / 'a'}:{tmp_path / 'b'}")
    assert weights.folders()[:2] == (tmp_path / "a", tmp_path / "b")
    assert weights.folders()[2].name == "assets"
    with pytest.raises(FileNotFoundError) as caught:
        networks.load("vgg19")
    message = str(caught.value)
    assert "\n" not in message
    for part in ("vgg19-dcbb9e9d.pth", "https://download.pytorch.org", weights.FOLDERS, str(tmp_path / "b")):
        assert part in message
    # A file in torchvision's format: the classifier's keys beside the features.
    (tmp_path / "b").mkdir()
    state = fill_named(VGG19().state_dict(), VGG_RULES)
    torch.save({**state, "classifier.0.weight": torch.zeros(3, 3)}, tmp_path / "b" / "vgg19-dcbb9e9d.pth")
    loaded = networks.load("vgg19")
    torch.testing.assert_close(dict(loaded.named_parameters())["features.5.bias"], state["features.5.bias"])


def test_the_bundled_file_says_how_it_was_made() -> None:
    header = read_header(weights.find("texture"))
    assert header.part == "texture" and header.provenance["steps"] > 0 and header.provenance["commit"]
    assert header.provenance["command"].startswith("anystyle train experiment=tiny_perceptual")


def test_old_torch_files_are_read(tmp_path: Path) -> None:
    """The published VGG file predates PyTorch's zip format."""
    path = tmp_path / "old.pth"
    torch.save({"features.0.bias": torch.arange(3.0)}, path, _use_new_zipfile_serialization=False)
    assert not zipfile.is_zipfile(path)
    torch.testing.assert_close(weights.read(path)["features.0.bias"], torch.arange(3.0))


def test_refusals_name_what_is_wrong(tmp_path: Path) -> None:
    told = "no perceptual network 'vgg11'; choose from vgg19, vgg16, alexnet, efficientnet_lite0, texture"
    with pytest.raises(ValueError, match=told):
        networks.load("vgg11")
    state = VGG19().state_dict()
    state["features.2.weight"] = torch.zeros(64, 64, 1, 1)
    del state["features.34.bias"]
    save_file(state, tmp_path / "short.safetensors")
    with pytest.raises(ValueError, match=r"1 missing \(features\.34\.bias\); 1 misshapen \(features\.2\.weight is"):
        networks.load("vgg19", tmp_path / "short.safetensors")
    (tmp_path / "cut.safetensors").write_bytes((tmp_path / "short.safetensors").read_bytes()[:5000])
    with pytest.raises(ValueError, match=r"cut\.safetensors is not a valid file of weights, or truncated"):
        networks.load("vgg19", tmp_path / "cut.safetensors")
    torch.save(state, tmp_path / "whole.pth")
    (tmp_path / "cut.pth").write_bytes((tmp_path / "whole.pth").read_bytes()[:5000])
    with pytest.raises(ValueError, match=r"cut\.pth is not a valid file of weights, or truncated"):
        networks.load("vgg19", tmp_path / "cut.pth")
    torch.save({"features": eval}, tmp_path / "evil.pth")
    with pytest.raises(ValueError, match=r"holds code or objects of other programs \(builtins\.eval\)"):
        weights.read(tmp_path / "evil.pth")
    with pytest.raises(ValueError, match=r"relu9_1.*choose from rgb, relu1_1"):
        Texture()(torch.zeros(1, 3, 16, 16), ["relu9_1"])
    with pytest.raises(ValueError, match="images of 6x40 pixels are too small"):
        Texture()(torch.zeros(1, 3, 6, 40), ["relu4_1"])
