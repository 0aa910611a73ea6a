"""Consistency against closed forms, plain NumPy, scenes that are known, and captures."""

from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.ndimage import correlate1d
from torch.nn.functional import interpolate

import anystyle_benchmark
from anystyle.data.images import open_image, to_tensor
from anystyle.geometry.warp import pixels, sample_at
from anystyle.testing.oracle import smooth_image
from anystyle.types import Cameras, Comparison
from anystyle_benchmark.distortions import blurred, flickering
from anystyle_metrics import consistency
from anystyle_metrics.consistency import Consistency, Windows, disagreement, error_of_mean, flicker
from tests.support.known_scene import photographed_wall

CAPTURES = {
    "banana": ["dsc_0423", "dsc_0424", "dsc_0425", "dsc_0426"],
    "bronze_axe": ["IMG_8840", "IMG_8841", "IMG_8842", "IMG_8843"],
}
SIZE = (126, 168)


def noise(seed, count=8):
    """Independent content of variance 0.01, mean 0.5."""
    return 0.5 + 0.1 * torch.randn(count, 3, *SIZE, generator=torch.Generator().manual_seed(seed))


def score(first, second):
    return float(disagreement(first, second, Windows(torch.ones(len(first), *SIZE).bool())).mean())


def known(scene, views=slice(None)):
    _, cameras, depth = scene
    return {"cameras": cameras.select(views), "depth": depth[None, views]}


def scores(metric, images, stylized, **known):
    metric.reset()
    metric.update(Comparison(images[None], stylized[None], **known))
    return {name: float(value) for name, value in metric.compute().items()}


def test_what_moved_exactly_is_consistent_and_what_is_independent_is_not():
    texture = noise(0)
    flow = torch.tensor([7.0, -3.0]).view(1, 2, 1, 1).expand(8, 2, *SIZE)
    inside = sample_at(torch.ones(8, 1, *SIZE), flow)[:, 0] > 0.999
    moved = disagreement(texture.roll((-3, 7), (2, 3)), sample_at(texture, -flow), Windows(inside.flip(1, 2)))
    assert float(moved.abs().max()) < 1e-4
    assert score(noise(1), noise(2)) == pytest.approx(1, abs=0.01)
    for share in (0.25, 0.5):
        mixed = 0.5 + (1 - share) ** 0.5 * (noise(1) - 0.5) + share**0.5 * (noise(2) - 0.5)
        assert score(noise(1), mixed) == pytest.approx(1 - (1 - share) ** 0.5, abs=0.01)


@pytest.mark.parametrize("change", [lambda x: 0.4 * x + 0.3, lambda x: 1 - x], ids=["gain and offset", "negation"])
def test_it_is_invariant(change):
    first, second = noise(1), (noise(1) + noise(2)) / 2
    assert score(change(first), change(second)) == pytest.approx(score(first, second), rel=1e-4)


def test_flicker_is_what_the_photographs_exposures_do_not_explain():
    shift, exposure = torch.tensor([[0.2, 0.2, 0.2]]), torch.tensor([[0.4, 0.4, 0.4]])
    assert float(flicker(shift, exposure)) == pytest.approx(0, abs=1e-9)  # half of it is followed
    assert float(flicker(shift, -exposure)) == float(flicker(shift, 0 * exposure)) == pytest.approx(0.02)


def test_the_error_is_the_spread_of_means_over_other_views():
    """Of scores that each view moves by itself; it is conservative where the pairs alone differ."""
    generator, pairs = torch.Generator().manual_seed(0), torch.combinations(torch.arange(8)).unbind(1)
    for spread, low, high in ((0.0, 0.95, 1.05), (1.0, 1.0, 1.2)):
        views = torch.randn(500, 8, generator=generator)
        drawn = views[:, pairs[0]] + views[:, pairs[1]] + spread * torch.randn(500, 28, generator=generator)
        errors = torch.stack([error_of_mean(values, *pairs) for values in drawn])
        assert low < float(errors.square().mean().sqrt() / drawn.mean(1).std()) < high
    assert error_of_mean(torch.ones(1), *torch.tensor([[0], [1]])).isnan()


def test_numpy_agrees_on_four_views():
    scene = photographed_wall(4)
    metric, stylized = Consistency(), (scene[0].flip(1) + smooth_image(1, scene[0].shape)) / 2
    found = scores(metric, scene[0], stylized, **known(scene))
    links, side = metric._links[1], min(stylized.shape[-2:])

    def weight(distance):  # Keys 1981, with a = -3 / 4
        d = abs(distance)
        return np.where(d < 1, (1.25 * d - 2.25) * d * d + 1, np.where(d < 2, -0.75 * (((d - 5) * d + 8) * d - 4), 0))

    def cubic(image, row, column):
        (height, width), top, left = row.shape, np.floor(row).astype(int), np.floor(column).astype(int)
        return sum(
            image[:, (top + i).clip(0, height - 1), (left + j).clip(0, width - 1)]
            * (weight(row - top - i) * weight(column - left - j))
            for i in range(-1, 3)
            for j in range(-1, 3)
        )

    def mean(values, mask, sigma):
        radius = np.arange(-9, 10)
        kernel = np.exp(-((radius / sigma) ** 2) / 2) * (np.abs(radius) < 3 * sigma)
        total, weight = (
            correlate1d(correlate1d(each, kernel, 0, mode="constant"), kernel, 1, mode="constant")
            for each in (values * mask, 1.0 * mask)
        )
        return total / np.maximum(weight, 1e-6)

    expected = []
    for first, second, flow, mask in zip(links.first, links.second, links.flow, links.verified.numpy(), strict=True):
        rows, columns = np.indices(mask.shape)
        places = [rows + flow[1].double().numpy(), columns + flow[0].double().numpy()]
        one, other = stylized[first].double().numpy(), cubic(stylized[second].double().numpy(), *places)
        x, y = (
            np.stack([mean(c, mask, 3 / 378 * side) - mean(c, mask, 6 / 378 * side) for c in image])
            for image in (one, other)
        )
        xx, yy, xy = (mean(product.sum(0), mask, 9 / 378 * side) for product in (x * x, y * y, x * y))
        w = np.sqrt(np.minimum(xx, yy)) * mask
        expected.append(1 - (w * xy / np.sqrt(xx * yy).clip((0.35 / 255) ** 2)).sum() / w.sum())
    assert len(expected) == 3
    np.testing.assert_allclose([pair["consistency"] for pair in metric.pairs], expected, atol=1e-4)
    assert found["consistency"] == pytest.approx(np.mean(expected), abs=1e-4)


def test_what_is_corrected_out_of_the_picture_is_not_compared():
    (images, cameras, depth), metric = photographed_wall(4), Consistency()
    scores(metric, images, images, cameras=cameras, depth=0.97 * depth[None])
    links = metric._links[1]
    places = pixels(links.flow) + links.flow
    last = torch.tensor(places.shape[:-3:-1]).view(2, 1, 1) - 1
    moved = links.verified & ((places < 0) | (places > last)).any(1)
    assert links.verified.any() and not moved.any()


def test_correspondences_are_found_once_for_a_scene_and_the_next_one_has_its_own(monkeypatch):
    calls, link = [], consistency.link
    monkeypatch.setattr(consistency, "link", lambda *args: (calls.append(1), link(*args))[1])
    scene, metric = photographed_wall(3), Consistency()
    for images in (scene[0], 1 - scene[0], scene[0]):
        scores(metric, scene[0], images, **known(scene))
    assert len(calls) == 1
    found = scores(metric, scene[0][:2], scene[0][:2], **known(scene, [0, 1]))
    assert len(calls) == 2 and found["consistency_flicker"] == pytest.approx(0, abs=1e-9)


@pytest.mark.filterwarnings("ignore:consistency")
def test_without_evidence_there_is_no_score():
    scene = photographed_wall(3)
    images, metric = scene[0], Consistency()
    with pytest.warns(UserWarning, match="too flat or too blurred"):
        assert np.isnan(scores(metric, images, torch.full_like(images, 0.5), **known(scene))["consistency"])
    with pytest.warns(UserWarning, match="agree in no pair"):
        wrong = {**known(scene), "depth": scene[2][None] / 2}
        assert np.isnan(scores(metric, images, images, **wrong)["consistency"])
    with pytest.warns(UserWarning, match="flow between the photographs"):
        assert scores(metric, images, images)["consistency"] < 0.5
    assert np.isnan(scores(metric, noise(1), noise(1))["consistency"])
    with pytest.warns(UserWarning, match="one view has no other to agree with"):
        assert np.isnan(scores(metric, images[:1], images[:1])["consistency"])


@pytest.mark.parametrize("name", CAPTURES)
def test_photographs_of_captures_win_and_every_distortion_is_seen(name):
    root = Path(anystyle_benchmark.__file__).parent / "tracks" / "open"
    geometry, views = root / "geometry" / name, CAPTURES[name]
    arrays, maps = np.load(geometry / "cameras.npz"), np.load(geometry / "depth.npz")
    places = [arrays["frames"].tolist().index(view) for view in views]
    depth = torch.stack([torch.from_numpy(maps[view]) for view in views])[None].float()
    poses, intrinsics = (torch.from_numpy(arrays[key][places]).float()[None] for key in list(arrays)[1:3])
    given = {"cameras": Cameras(poses, intrinsics, depth.shape[-2:]), "depth": depth}
    files = [to_tensor(open_image(root / "photographs" / name / f"{view}.jpg")) for view in views]
    images = interpolate(torch.stack(files), depth.shape[-2:], mode="bicubic", antialias=True).clamp(0, 1)
    texture = smooth_image(1, images.shape) - 0.5
    metric = Consistency()

    def of(stylized):
        return scores(metric, images, stylized.clamp(0, 1), **given)

    base = of(images)
    slides, more = (of(images + strength * texture[:1]) for strength in (0.15, 0.45))
    rung = slides["consistency"] - base["consistency"]
    assert base["consistency"] < slides["consistency"] < more["consistency"] < of(images[[1, 0, 3, 2]])["consistency"]
    for same in (images / 2, images.mean(1, keepdim=True).expand_as(images), 1 - images):
        assert abs(of(same)["consistency"] - base["consistency"]) < 0.25 * rung
    for share in (0.005, 0.01, 0.02, 0.05):
        assert not of(blurred(images, share))["consistency"] < base["consistency"] - 0.1 * rung
    flickers = [of(flickering(images, strength))["consistency_flicker"] for strength in (0, 0.07, 0.15)]
    assert flickers == sorted(flickers) and flickers[0] == pytest.approx(0, abs=1e-9)
