"""Every metric against the scores of the published scripts, on the same filled networks."""

import numpy as np
import pytest
import torch

from anystyle.contracts import Correspondence
from anystyle.metrics.art_fid import ArtFID
from anystyle.metrics.art_score import ArtScore
from anystyle.metrics.color_match import ColorMatch
from anystyle.metrics.lpips import LPIPS, LPIPSGray
from anystyle.metrics.warp_consistency import WarpConsistency, corrected_warp, reference_warp
from anystyle.testing.oracle import assert_matches, hashed, smooth_image
from anystyle.types import Comparison, Flow, Frames, Style
from anystyle.vision import lpips
from anystyle.vision.statistics import hellinger, rgb_uv_histogram
from anystyle_metrics.cfsd import CFSD, structural_distance
from anystyle_metrics.optical_flow.raft import Raft
from tests.support.judging_cases import filled_folder, nine_frames, six_pairs
from tests.support.oracle import golden

END_TO_END = golden("golden_metrics")["artfid_end_to_end"]


@pytest.fixture(autouse=True)
def filled(monkeypatch):
    monkeypatch.setenv("ANYSTYLE_WEIGHTS", str(filled_folder()))


def comparisons():
    for content, stylized, style in six_pairs():
        yield Comparison(content[None, None], stylized[None, None], Style(style[None]))


def judged(metric):
    each = [metric(comparison) for comparison in comparisons()]
    return metric.scores(), each


@pytest.mark.parametrize("backbone", ["alex", "vgg"])
def test_lpips_in_every_range(backbone):
    record = golden("golden_metrics")["lpips"][backbone]
    first = smooth_image(4001, [2, 3, 64, 96])
    second = (0.6 * first + 0.4 * smooth_image(4003, [2, 3, 64, 96])).clamp(0, 1)
    network = lpips.load(backbone, "published")
    torch.testing.assert_close(network(first, second), torch.tensor(record["value"]), rtol=1e-4, atol=1e-6)
    scaled = network((255 * first + 1) / 2, (255 * second + 1) / 2)
    torch.testing.assert_close(scaled, torch.tensor(record["value_0_255"]), rtol=1e-4, atol=1e-6)
    gray = [images.mean(1, keepdim=True).expand(-1, 3, -1, -1) for images in (first, second)]
    torch.testing.assert_close(network(*gray), torch.tensor(record["value_gray_1ch"]), rtol=1e-4, atol=1e-6)


@pytest.mark.slow
def test_art_fid_end_to_end():
    metric = ArtFID(weights="published")
    assert metric.stand_ins == {} and sorted(len(digest) for digest in metric.weights.values()) == [64, 64]
    with pytest.warns(UserWarning, match="one image alone has no covariance"):
        found, _ = judged(metric)
    assert_matches(torch.cat(metric.stylized), END_TO_END["activations"]["tar"], rtol=1e-3, atol=1e-3)
    assert_matches(torch.cat(metric.style), END_TO_END["activations"]["sty"], rtol=1e-3, atol=1e-3)
    keys = {"lpips": "lpips", "fid": "fid_exact", "fid_infinity": "fid_exact", "art_fid": "artfid_exact"}
    for name, key in keys.items():
        np.testing.assert_allclose(float(found[name]), END_TO_END[key], rtol=1e-4)


@pytest.mark.parametrize(
    ("make", "key", "each"),
    [
        (lambda: LPIPS(weights="published"), "lpips", None),
        (lambda: LPIPSGray(weights="published"), "lpips_gray", None),
        (lambda: ColorMatch(), "cm_loss", "cm_per_image"),
        (lambda: ArtScore(weights="published"), None, "artscore"),
        (lambda: ArtScore(weights="published", variant="corrected"), None, "artscore_square_resize"),
    ],
)
def test_one_score_an_image(make, key, each):
    found, rows = judged(make())
    (value,) = found.values()
    if key:
        np.testing.assert_allclose(float(value), END_TO_END[key], rtol=1e-4)
    if each:
        np.testing.assert_allclose([float(row) for row in rows], END_TO_END[each], rtol=1e-4, atol=2e-6)


def test_histograms():
    record = golden("anystyle_golden")["rgb_uv_hist"]
    first, second = hashed(1080, (1, 3, 16, 16)), hashed(1081, (1, 3, 16, 16)).square()
    one, other = rgb_uv_histogram(first), rgb_uv_histogram(second)
    assert_matches(one, record["hist1"], atol=1e-8)
    np.testing.assert_allclose(float(hellinger(one, other)), record["hellinger"], rtol=1e-4)
    assert_matches(rgb_uv_histogram(hashed(1082, (1, 3, 300, 200))), record["hist_resized"], atol=1e-8)


def test_structural_distance():
    record = golden("anystyle_golden")["patch_simi"]
    stylized, content = hashed(1090, (8, 3, 4), 0, 4), hashed(1091, (8, 3, 4), 0, 4)
    np.testing.assert_allclose(float(structural_distance(stylized, content)), record["value"], rtol=1e-4)


def test_structural_distance_end_to_end():
    # Similarities of this network are nearly flat: the published score is rounding in its second digit.
    found, _ = judged(CFSD(weights="published"))
    np.testing.assert_allclose(float(found["cfsd"]), END_TO_END["cfsd"], rtol=5e-2)


def test_structural_distance_where_the_softmax_is_not_flat(tmp_path, monkeypatch):
    # The same file with a first convolution eight times as strong.
    from anystyle.vision import weights

    name = weights.row("vgg19").file
    state = torch.load(filled_folder() / name, weights_only=True)
    state["features.0.weight"] *= 8
    torch.save(state, tmp_path / name)
    monkeypatch.setenv("ANYSTYLE_WEIGHTS", str(tmp_path))
    found, _ = judged(CFSD(weights="published"))
    np.testing.assert_allclose(float(found["cfsd"]), golden("golden_metrics")["cfsd_scaled"]["value"], rtol=1e-4)


def test_warp_of_a_given_flow():
    frames = nine_frames()
    network = lpips.load("vgg", "published")
    records = golden("golden_metrics")["consistency"]["flow_given"]
    for record, index, reach, factor in zip(records, (4450, 4451), (3, 12), (3, 6), strict=True):
        noise = hashed(index, (1, 2, 128, 160), -reach, reach)
        padded = torch.nn.functional.pad(noise, (4, 4, 4, 4), mode="replicate")
        flow = factor * torch.nn.functional.avg_pool2d(padded, 9, stride=1)
        warped = reference_warp(frames[:1], frames[1:2], flow)
        assert_matches(warped.image, record["splat"], atol=1e-2)
        np.testing.assert_allclose(float(warped.seen.float().mean()), record["valid_fraction"], rtol=1e-6)
        error = (warped.image - warped.target).square().mean().sqrt() / 255
        np.testing.assert_allclose(float(error), record["rmse"], rtol=1e-4)
        distance = network((warped.image + 1) / 2, (warped.target + 1) / 2)
        np.testing.assert_allclose(float(distance), record["lpips"], rtol=1e-4)


def test_small_warps_of_both_variants():
    golden_pair, unit = (golden("anystyle_golden")[f"softsplat_pair{end}"] for end in ("", "_unit_range"))
    source = hashed(1130, (1, 3, 6, 8), 0, 255)
    target = (0.97 * source + hashed(1131, (1, 3, 6, 8), -6, 6)).clamp(0, 255)
    flow = hashed(1132, (1, 2, 6, 8), -1.5, 1.5)
    warped = reference_warp(source / 255, target / 255, flow)
    assert_matches(warped.image, golden_pair["warped"], atol=1e-2)
    assert int(warped.seen.sum()) == golden_pair["mask_ones"]
    error = (warped.image - warped.target).square().mean().sqrt() / 255
    np.testing.assert_allclose(float(error), golden_pair["rmse_all_pixels"], rtol=1e-4)
    meant = corrected_warp(source / 255, target / 255, flow, torch.ones(1, 6, 8, dtype=torch.bool))
    # Where the corrected mask sees, its image is the splat in the unit range.
    idx = torch.as_tensor(unit["warped"]["idx"])
    seen = meant.seen.expand(-1, 3, -1, -1).flatten()[idx]
    assert seen.sum() >= 10
    torch.testing.assert_close(
        meant.image.flatten()[idx][seen], torch.tensor(unit["warped"]["val"])[seen], rtol=1e-3, atol=1e-4
    )


@pytest.mark.slow
def test_consistency_with_raft():
    record = golden("golden_metrics")["consistency"]
    frames = nine_frames()[None]
    flow = Raft(weights="published", visibility="frame")
    metric = WarpConsistency(correspondence=flow, weights="published")
    metric.update(Comparison(frames, frames))
    found = metric.compute()
    for name in ("short", "long"):
        distance, error = record[name]
        np.testing.assert_allclose(float(found[f"warp_lpips_{name}"]), distance, rtol=1e-3)
        np.testing.assert_allclose(float(found[f"warp_rmse_{name}"]), error, rtol=1e-3)
    first = flow(Frames(frames[0, :1]), Frames(frames[0, 1:2])).displacement
    assert_matches(first, record["flow_first"], rtol=1e-3, atol=5e-3)


def test_a_hole_is_no_error_as_published_and_none_as_meant():
    # Half of the source is called invisible; what is left fits exactly.
    frames = smooth_image(9, [2, 3, 56, 56])
    frames[1] = frames[0]
    flow = torch.zeros(1, 2, 56, 56)
    visible = torch.zeros(1, 56, 56, dtype=torch.bool)
    visible[:, :, :28] = True
    frames[1, :, :, 28:] = 0.5
    meant = corrected_warp(frames[:1], frames[1:], flow, visible)
    assert float(meant.seen.float().mean()) == 0.5
    torch.testing.assert_close(meant.image, meant.target, rtol=0, atol=1e-5)

    class Still(Correspondence):
        def __call__(self, source: Frames, target: Frames) -> Flow:
            return Flow(flow, visible)

    for variant, close in (("corrected", True), ("reference", False)):
        metric = WarpConsistency(correspondence=Still(), variant=variant, weights="stand_in")
        metric.update(Comparison(frames[None], frames[None]))
        with pytest.warns(UserWarning, match="8 frames"):
            found = metric.compute()
        assert (float(found["warp_rmse_short"]) < 1e-5) is close
        assert float(found["warp_coverage_short"]) == (0.5 if close else 1.0)
        assert found["warp_rmse_long"].isnan()
