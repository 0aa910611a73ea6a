"""Metrics against other libraries, closed forms, and input that is too little or wrong."""

import warnings
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import torch
from skimage.metrics import peak_signal_noise_ratio, structural_similarity
from torchmetrics.image.kid import poly_mmd

from anystyle.contracts import Metric
from anystyle.errors import UserError
from anystyle.metrics.art_fid import ArtFID, frechet_distance, frechet_infinity
from anystyle.metrics.color_match import ColorMatch
from anystyle.metrics.kid import KID, discrepancy
from anystyle.metrics.psnr import PSNR
from anystyle.metrics.ssim import SSIM
from anystyle.metrics.warp_consistency import WarpConsistency
from anystyle.testing.oracle import hashed, smooth_image
from anystyle.testing.toy.correspondence import ToyCorrespondence
from anystyle.testing.toy.metric import ToyMetric
from anystyle.testing.toy.scenes import ToyScenes
from anystyle.testing.toy.style_encoder import ToyStyleEncoder
from anystyle.types import Comparison, Style
from anystyle.vision import feature_cache
from anystyle_metrics.clip import ClipDirection, ClipStyle
from anystyle_metrics.optical_flow.raft import Raft


def pictures(styles: int = 2, frames: int = 3, side: int = 70) -> Comparison:
    content = smooth_image(11, [frames, 3, side, side])
    stylized = 0.6 * content + 0.4 * smooth_image(13, [styles, frames, 3, side, side])
    image = smooth_image(15, [styles, 3, 77, 77])
    return Comparison(content.expand(styles, -1, -1, -1, -1), stylized, Style(image))


def score(metric: Metric, *comparisons: Comparison) -> float:
    for comparison in comparisons:
        metric.update(comparison)
    (value,) = metric.scores().values()
    return float(value)


def test_psnr_and_ssim_agree_with_scikit_image():
    given = pictures()
    pairs = [
        (a.permute(1, 2, 0).numpy(), b.permute(1, 2, 0).numpy())
        for a, b in zip(given.content.flatten(0, 1), given.stylized.flatten(0, 1), strict=True)
    ]
    noise = np.mean([peak_signal_noise_ratio(a, b, data_range=1) for a, b in pairs])
    np.testing.assert_allclose(score(PSNR(), given), noise, rtol=1e-5)
    options = {"channel_axis": 2, "data_range": 1, "gaussian_weights": True, "sigma": 1.5}
    both = [
        structural_similarity(a, b, use_sample_covariance=False, win_size=11, full=True, **options)[1] for a, b in pairs
    ]
    np.testing.assert_allclose(score(SSIM(), given), np.mean([x[5:-5, 5:-5] for x in both]), rtol=0, atol=1e-6)


def test_equal_images_are_as_good_as_it_gets():
    same = replace(pictures(), stylized=pictures().content.contiguous())
    assert score(PSNR(), same) == 100 and score(SSIM(), same) == pytest.approx(1)


def test_kid_agrees_with_torchmetrics():
    first, second = hashed(3, (40, 24)), hashed(4, (40, 24)).square()
    np.testing.assert_allclose(float(discrepancy(first, second)), float(poly_mmd(first, second)), rtol=1e-4)
    # Unbiased: of two halves of one set it may be below 0, and is close to it.
    halves = [float(discrepancy(hashed(9 + k, (40, 24)), hashed(99 + k, (40, 24)))) for k in range(8)]
    assert min(halves) < 0 < max(halves) and abs(np.mean(halves)) < 0.01


def by_definition(first, second):
    first, second = first.double().numpy(), second.double().numpy()
    covariances = np.cov(first, rowvar=False), np.cov(second, rowvar=False)
    root = scipy.linalg.sqrtm(covariances[0] @ covariances[1])
    gap = first.mean(0) - second.mean(0)
    return gap @ gap + np.trace(covariances[0]) + np.trace(covariances[1]) - 2 * np.trace(root).real


@pytest.mark.parametrize(("n", "m", "dim"), [(40, 60, 24), (200, 30, 24), (300, 300, 24)])
def test_equals_the_matrix_square_root(n, m, dim):
    generator = torch.Generator().manual_seed(n)
    first = torch.randn(n, dim, generator=generator, dtype=torch.float64)
    second = 0.5 * torch.randn(m, dim, generator=generator, dtype=torch.float64) + 0.3
    np.testing.assert_allclose(frechet_distance(first, second).item(), by_definition(first, second), rtol=1e-9)


def test_a_set_and_itself_are_at_distance_zero_even_if_singular():
    features = torch.randn(20, 64, dtype=torch.float64)
    assert abs(frechet_distance(features, features).item()) < 1e-9


def test_known_gaussians():
    """Two sets that differ by a shift d are at distance |d|^2; by a scale s, at (1 - s)^2 tr C."""
    features = torch.randn(500, 8, dtype=torch.float64)
    np.testing.assert_allclose(frechet_distance(features, features + 2).item(), 8 * 4, rtol=1e-9)
    spread = torch.trace(torch.cov(features.T)).item()
    centred = features - features.mean(0)
    np.testing.assert_allclose(frechet_distance(centred, 3 * centred).item(), 4 * spread, rtol=1e-9)


def test_too_few_samples_and_bad_values_are_refused():
    with pytest.raises(ValueError, match="1 samples"):
        frechet_distance(torch.zeros(1, 4), torch.zeros(5, 4))
    with pytest.raises(ValueError, match="not finite"):
        frechet_distance(torch.full((3, 4), torch.nan), torch.zeros(5, 4))


def test_frechet_extrapolated_to_endless_samples():
    first, second = (torch.randn(n, 8, generator=torch.Generator().manual_seed(n)) for n in (3000, 4000))
    plain, endless = frechet_distance(first[:200], second), frechet_infinity(first[:200], second, smallest=60)
    assert plain > 0 and abs(endless) < plain / 3  # Both are of one distribution: the truth is 0.
    assert frechet_infinity(first[:200], second, smallest=5000) == plain


def test_directions_and_similarities_are_cosines():
    encoder = ToyStyleEncoder().requires_grad_(False).eval()
    given = pictures(styles=1, frames=2)
    toward = replace(given, style=Style(given.stylized[:, 0]), stylized=given.stylized[:, :1].expand(-1, 2, -1, -1, -1))
    assert score(ClipStyle(style_encoder=encoder, size=None), toward) == pytest.approx(1, abs=1e-5)
    before, after = (encoder.embed_images(images[0]) for images in (given.content, given.stylized))
    wanted = encoder.embed_images(given.style.image) - encoder.embed_texts([encoder.neutral])
    expected = torch.nn.functional.cosine_similarity(after - before, wanted).mean()
    assert score(ClipDirection(style_encoder=encoder, size=None), given) == pytest.approx(float(expected), abs=1e-5)


def test_stand_ins_are_named_by_score():
    metric = ArtFID(weights="stand_in")
    by_score = dict.fromkeys(("fid", "fid_infinity"), "texture_moments") | {"lpips": "texture_distance"}
    assert metric.stand_ins == {"art_fid": "texture_moments, texture_distance", **by_score}
    assert [len(digest) for digest in metric.weights.values()] == [64]
    with pytest.raises(FileNotFoundError, match="weights 'art_inception' are missing"):
        ArtFID(weights="published")


def test_one_style_only_has_a_value_and_a_warning():
    metric = ArtFID(weights="stand_in")
    metric.update(pictures(styles=1))
    with pytest.warns(UserWarning, match="one style image only"):
        assert metric.compute()["fid"] > 0
    with pytest.warns(UserWarning, match="3 stylized and 1 distinct style images"):
        assert np.isnan(score(KID(weights="stand_in"), pictures(styles=1)))


def test_few_images_are_warned_of():
    metric = ArtFID(weights="stand_in", variant="corrected")
    metric.update(pictures())
    with pytest.warns(UserWarning, match="6 images are fewer than the 640 features"):
        metric.compute()
    metric.style = [*metric.stylized]
    metric.update(pictures())
    metric.style[1:] = metric.stylized[1:]
    with pytest.warns(UserWarning, match="12 images .*extrapolated it is below 0, hence nan"):
        assert metric.compute()["art_fid"].isnan()


@pytest.mark.parametrize("make", [PSNR, ToyMetric, lambda: ArtFID(weights="stand_in")])
def test_images_that_are_no_numbers_are_refused(make):
    images = pictures()
    images.stylized[0, 0, 0, 0, 0] = float("nan")
    with pytest.raises(ValueError, match="the stylized images hold 1 values that are NaN or infinite"):
        make().update(images)


def test_a_style_image_is_looked_at_where_it_is_one():
    images = pictures()
    images.style.image[1, 0, 0, 0] = float("inf")
    with pytest.raises(ValueError, match="the style images hold 1 values"):
        ColorMatch().update(images)
    ColorMatch().update(replace(images, style=replace(images.style, has_image=torch.tensor([True, False]))))


def test_an_image_is_looked_at_once(monkeypatch):
    feature_cache.CACHE.clear()
    metric = ArtFID(weights="stand_in")
    seen = Counter()
    for network, name in ((metric.inception, "forward"), (metric.network, "describe")):
        look = getattr(network, name)
        monkeypatch.setattr(network, name, lambda x, name=name, look=look: seen.update([name] * len(x)) or look(x))
    given = pictures(styles=4, frames=3)
    for _ in range(2):
        metric.update(given)
        # 12 stylized images and 4 styles; 12 stylized images and 3 photographs, not 12.
        assert seen == {"forward": 16, "describe": 15}
        given = replace(given, content=given.content.clone())


def test_a_changed_image_is_another_image():
    cache = feature_cache.FeatureCache(limit=100)
    images = torch.zeros(2, 3, 2, 2)
    images[1] = 1
    calls = []

    def means(batch):
        calls.append(batch.shape[0])
        return [batch.mean((1, 2, 3))]

    assert cache.features(images, ("mean",), means)[0].tolist() == [0, 1]
    images[0] = 0.5
    assert cache.features(images, ("mean",), means)[0].tolist() == [0.5, 1]
    assert calls == [2, 1]
    cache.features(torch.linspace(0, 1, 60).view(60, 1, 1, 1).expand(-1, 3, 2, 2).contiguous(), ("mean",), means)
    assert len(cache) == 25


def test_the_photographs_flow_is_searched_once_for_all_styles(monkeypatch):
    """Also where styles come one after the other; another scene has a flow of its own."""
    flow = Raft(weights="stand_in")
    searched = []
    search = flow.displacement
    monkeypatch.setattr(flow, "displacement", lambda *frames: searched.append(1) or search(*frames))
    metric = WarpConsistency(correspondence=flow, flow_from="content", weights="stand_in")
    given = pictures(styles=3, frames=2, side=40)
    rows = [given.map(lambda tensor, i=row: tensor[i : i + 1].clone()) for row in range(3)]
    for row in rows:
        metric.update(row)
    assert len(searched) == 1
    metric.update(replace(given, content=given.content.flip(-1)))
    assert len(searched) == 2
    # That is what the corrected variant does unless it is told otherwise; there and back.
    for flow_from, times in ((None, 2), ("stylized", 6)):
        searched.clear()
        metric = WarpConsistency(correspondence=flow, flow_from=flow_from, variant="corrected", weights="stand_in")
        for row in rows:
            metric.update(row)
        assert len(searched) == times


def test_frames_are_neighbours_by_their_numbers():
    given = pictures(styles=1, frames=4, side=40)

    def found(*views: int, numbers: tuple[int, ...] = ()) -> dict[str, float]:
        metric = WarpConsistency(correspondence=Raft(weights="stand_in"), weights="stand_in")
        rows = given.content[:, list(views)], given.stylized[:, list(views)]
        metric.update(Comparison(*rows, numbers=numbers))
        with warnings.catch_warnings(action="ignore"):  # of a range without pairs
            return {name: float(value) for name, value in metric.scores().items()}

    some, one, other = found(0, 1, 2, 3, numbers=(0, 1, 3, 7)), found(0, 1), found(0, 3)
    assert some["warp_rmse_short"] == pytest.approx(one["warp_rmse_short"], rel=1e-6)
    assert some["warp_rmse_long"] == pytest.approx(other["warp_rmse_short"], rel=1e-6)
    with pytest.raises(ValueError, match="2 views have 1 numbers"):
        found(0, 1, numbers=(0,))


@pytest.mark.parametrize("variant", ["reference", "corrected"])
def test_a_correspondence_of_a_wrong_shape_is_named(variant):
    class Last(ToyCorrespondence):
        def __call__(self, source, target):
            flow = super().__call__(source, target)
            object.__setattr__(flow, "displacement", flow.displacement.movedim(1, -1))  # unchecked, as outside of tests
            return flow

        def displacement(self, source, target):
            return self(source, target).displacement

    metric = WarpConsistency(correspondence=Last(), variant=variant, weights="stand_in")
    shown, scenes = pictures(styles=1), ToyScenes(num_scenes=1, size=(70, 70)).read(0, range(3))
    with pytest.raises(UserError, match=r"\Agiven the .*correspondence Last.* of shape \[2, 70, 70, 2\]; expected"):
        metric.update(replace(shown, cameras=scenes.cameras, depth=scenes.depth))
    with pytest.raises(UserError, match="frames without depth or cameras"):
        metric.update(shown)


def test_a_style_that_hides_all_motion_does_not_hide_it_from_the_corrected_variant():
    """Stylized frames without any texture give the flow nothing to hold on to; the photographs do."""
    wide = smooth_image(5, [1, 3, 42, 60]) * 0.5 + 0.5 * smooth_image(6, [1, 3, 42, 60])
    content = torch.stack([wide[..., 3 * frame : 3 * frame + 42] for frame in range(3)], dim=1)
    flat = torch.linspace(0.2, 0.8, 3).view(1, 3, 1, 1, 1).expand(-1, -1, 3, 42, 42).contiguous()
    given = replace(pictures(styles=1, frames=3, side=42), content=content, stylized=flat)
    metric = WarpConsistency(correspondence=Raft(weights="stand_in"), variant="corrected", weights="stand_in")
    metric.update(given)
    with warnings.catch_warnings(action="ignore"):  # of the long range
        found = metric.compute()
    # Grey changes by 0.3 a frame, wherever a pixel goes; what the motion brings into view cannot be compared.
    assert found["warp_rmse_short"] == pytest.approx(0.3, abs=1e-5) and 0.5 < found["warp_coverage_short"] < 1


def test_what_is_no_score_is_told_of_its_metric():
    two = type("Two", (PSNR,), {"compute": lambda self: torch.zeros(2)})()
    two.update(torch.zeros(1, 3, 8, 8), torch.ones(1, 3, 8, 8))
    with pytest.raises(UserError, match=r"the metric Two gives tensor\(\[0., 0.\]\) as psnr; expected one number"):
        two.scores()
