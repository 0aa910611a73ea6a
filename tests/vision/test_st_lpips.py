"""ST-LPIPS, which replaces LPIPS where its published weights are missing: the same distances, under its own name."""

import importlib.util
import io
from pathlib import Path

import pytest
import torch
from kornia.filters import gaussian_blur2d
from PIL import Image, ImageOps

import anystyle_benchmark
from anystyle.data.images import to_tensor
from anystyle.io.sheet import to_pil
from anystyle.metrics.art_fid import ArtFID
from anystyle.metrics.lpips import LPIPSGray
from anystyle.metrics.warp_consistency import WarpConsistency
from anystyle.testing.inputs import comparison
from anystyle.testing.oracle import smooth_image
from anystyle.testing.toy.correspondence import ToyCorrespondence
from anystyle.types import Source
from anystyle.vision import lpips, weights
from tests.support.oracle import golden

BACKBONES = ("alex", "vgg")
installed = pytest.mark.skipif(
    importlib.util.find_spec("stlpips_pytorch") is None, reason="the package stlpips-pytorch is not installed"
)


@installed
@pytest.mark.parametrize("backbone", BACKBONES)
@torch.no_grad()
def test_distances_are_those_of_the_published_package(backbone):
    network = lpips.load(backbone)
    for size, expected in golden("golden_st_lpips")[backbone].items():
        images = (smooth_image(seed, [1, 3, *map(int, size.split("x"))]) for seed in (61, 62))
        assert float(network(*images)) == pytest.approx(expected, rel=1e-5)
    with pytest.raises(ValueError, match="images are too small for ST-LPIPS, which needs 21 x 21 pixels"):
        network.describe(torch.zeros(1, 3, 17, 17))


@installed
@pytest.mark.parametrize("backbone", BACKBONES)
def test_files_have_the_stated_checksum_and_scores_name_them(backbone):
    name = f"st_lpips_{backbone}"
    assert weights.verified(name, weights.find(name))
    source = lpips.load(backbone).source
    assert source.stand_in == "st_lpips" and source.file == weights.row(name).file
    # Asked for by name, a stand-in is the bundled one, and published weights are LPIPS'.
    assert lpips.load(backbone, "stand_in").source.stand_in == "texture_distance"
    with pytest.raises(FileNotFoundError, match=f"weights '{lpips.NETWORKS[backbone][0]}' are missing"):
        lpips.load(backbone, "published")


def photographs():
    """The first photographs of two captures, (2, 3, 225, 225): a pixel is left for a shift."""
    folder = Path(anystyle_benchmark.__file__).with_name("tracks") / "open" / "photographs"
    files = [folder / "banana" / "dsc_0423.jpg", folder / "brighton_beach" / "DJI_0018.jpg"]
    return torch.stack([to_tensor(ImageOps.fit(Image.open(file), (225, 225))) for file in files])


def jpeg(images, quality):
    files = [io.BytesIO() for _ in images]
    for image, file in zip(images, files, strict=True):
        to_pil(image).save(file, "JPEG", quality=quality)
    return torch.stack([to_tensor(Image.open(file)) for file in files])


@torch.no_grad()
def distances(network):
    """The mean distance of two photographs from what is made of them."""
    whole = photographs()
    images = whole[..., :-1, :-1]
    blurred = {sigma: gaussian_blur2d(whole, 8 * sigma + 1, (float(sigma), float(sigma))) for sigma in (1, 3)}
    distorted = {
        "moved by a pixel": whole[..., :-1, 1:],
        "blurred, σ 1": blurred[1][..., :-1, :-1],
        "blurred, σ 3": blurred[3][..., :-1, :-1],
        "JPEG 60": jpeg(images, 60),
        "JPEG 8": jpeg(images, 8),
        "another photograph": images.flip(0),
    }
    return {name: float(network(other, images).mean()) for name, other in distorted.items()}


@installed
def test_distortions_are_ordered_as_people_see_them():
    found = distances(lpips.load("alex"))
    assert found["moved by a pixel"] < found["JPEG 60"] < found["JPEG 8"] < found["another photograph"]
    assert 5 * found["moved by a pixel"] < found["blurred, σ 1"] < found["blurred, σ 3"] < found["another photograph"]
    texture = distances(lpips.load("alex", "stand_in"))
    moved = texture["moved by a pixel"]
    assert moved > texture["JPEG 60"] and 5 * moved > texture["blurred, σ 1"]


@installed
def test_scores_bear_its_name():
    flow = ToyCorrespondence()
    flow.sources = (Source("raft_things", stand_in="window_matching"),)
    metrics = [ArtFID(), LPIPSGray(size=None), WarpConsistency(correspondence=flow)]
    names = [["st_lpips"], ["st_lpips_gray"], ["warp_st_lpips_short", "warp_st_lpips_long"]]
    for metric, own in zip(metrics, names, strict=True):
        metric.update(comparison(2, 8 if len(own) == 2 else 2))
        assert [name for name in metric.scores() if "lpips" in name] == own
        assert metric.scores().keys() == metric.better.keys() >= metric.stand_ins.keys()
        assert all("st_lpips" in metric.stand_ins[name] for name in own)
    assert metrics[0].stand_ins["art_fid"] == "texture_moments, st_lpips"
    assert ArtFID(weights="stand_in").better == ArtFID.better


@pytest.mark.parametrize("backbone", BACKBONES)
def test_without_the_package_the_bundled_stand_in_is_taken(backbone, monkeypatch, caplog):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, package=None: None)
    network = lpips.load(backbone)
    assert network.name == "lpips" and network.source.stand_in == "texture_distance"
    assert "pip install --no-deps stlpips-pytorch==0.0.2" in caplog.text
    assert LPIPSGray().better == {"lpips_gray": "lower"}
