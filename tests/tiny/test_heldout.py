"""The figures of the held-out protocol, against closed forms."""

import json
import math
from pathlib import Path

import pytest
import torch
import torch.nn.functional as F

from anystyle.geometry.rotations import matrix_from_wxyz
from anystyle.geometry.similarity import similarity_of_cameras
from anystyle_tiny.evaluation.geometry import depth_error, mean_motion, pose_errors, psnr
from anystyle_tiny.evaluation.records import BETTER, baseline_figures, geometry_figures, kept, style_figures
from anystyle_tiny.evaluation.styles import correlation, edges, fraction_of_second, rises


def poses(count: int, seed: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    found = torch.eye(4, dtype=torch.float64).repeat(count, 1, 1)
    turns = torch.randn(count, 4, generator=generator, dtype=torch.float64) * 0.3 + torch.tensor([1.0, 0, 0, 0])
    found[:, :3, :3] = matrix_from_wxyz(F.normalize(turns, dim=-1))
    found[:, :3, 3] = torch.randn(count, 3, generator=generator, dtype=torch.float64)
    return found


def test_a_similarity_of_cameras_is_found_and_undone():
    source = poses(4, 0)
    turn, shift = poses(1, 1)[0, :3, :3], torch.tensor([0.3, -2.0, 1.0], dtype=torch.float64)
    target = source.clone()
    target[:, :3, :3] = turn @ source[:, :3, :3]
    target[:, :3, 3] = 2.5 * source[:, :3, 3] @ turn.T + shift
    found = similarity_of_cameras(source, target)
    assert float(found.scale) == pytest.approx(2.5)
    assert torch.allclose(found.poses(source), target, atol=1e-9)
    # Cameras on one spot leave the scale open: it is kept.
    alone = similarity_of_cameras(source[:1], target[:1])
    assert float(alone.scale) == 1.0 and torch.allclose(alone.poses(source[:1]), target[:1], atol=1e-9)


def test_errors_of_poses_do_not_depend_on_frame_or_unit():
    true = poses(3, 2).float()
    frame = poses(1, 3)[0].float()
    moved = frame @ true
    moved[:, :3, 3] *= 4
    turned, off = pose_errors(moved, true)
    assert float(turned.max()) < 0.1 and float(off.max()) < 0.1
    tilted = true.clone()
    angle = torch.tensor(math.radians(5.0))
    tilt = torch.tensor([[1, 0, 0], [0, angle.cos(), -angle.sin()], [0, angle.sin(), angle.cos()]])
    tilted[1, :3, :3] = true[1, :3, :3] @ tilt
    assert float(pose_errors(tilted, true)[0][0]) == pytest.approx(5.0, abs=0.05)


def test_depth_and_psnr():
    true = torch.tensor([[[1.0, 2.0], [4.0, 0.0]]])
    assert depth_error(3 * true + 5 * (true == 0), true) == pytest.approx(0.0, abs=1e-6)
    # The median ratio is 1; one of three known pixels is off by half.
    assert depth_error(torch.tensor([[[1.0, 2.0], [6.0, 9.0]]]), true) == pytest.approx(0.5 / 3, abs=1e-5)
    assert psnr(torch.zeros(2, 3, 4, 4), torch.full((2, 3, 4, 4), 0.1)) == pytest.approx([20.0, 20.0], abs=1e-3)


def test_the_mean_motion_is_the_best_constant():
    rotations = matrix_from_wxyz(F.normalize(torch.tensor([[[1.0, 0.1, 0, 0]], [[1.0, -0.1, 0, 0]]]), dim=-1))
    directions = F.normalize(torch.tensor([[[1.0, 0.2, 0]], [[1.0, -0.2, 0]]]), dim=-1)
    turned, toward = mean_motion(rotations, directions)
    assert torch.allclose(turned[0], torch.eye(3), atol=1e-6)
    assert torch.allclose(toward[0], torch.tensor([1.0, 0, 0]), atol=1e-6)


def test_the_share_of_a_palette_moves_with_the_pixels():
    red, blue = torch.tensor([[0.9, 0.1, 0.1]]), torch.tensor([[0.1, 0.1, 0.9], [0.1, 0.9, 0.9]])
    images = torch.stack([(1 - part) * red[0] + part * blue[0] for part in torch.linspace(0, 1, 10)])
    shares = fraction_of_second(images[:, :, None, None].expand(-1, 3, 4, 4), red, blue)
    assert float(shares[0]) == pytest.approx(0.0, abs=1e-4) and float(shares[-1]) == pytest.approx(1.0, abs=1e-4)
    assert rises(shares.tolist())
    assert not rises([0.1, 0.3, 0.3, 0.4])


def test_edges_keep_their_places_whatever_the_colours():
    picture = torch.zeros(1, 3, 16, 16)
    picture[..., 5:] = 0.5
    assert float(correlation(edges(picture), edges(0.8 - picture))) == pytest.approx(1.0, abs=1e-4)
    assert abs(float(correlation(edges(picture), edges(picture.mT)))) < 0.3
    assert float(correlation(edges(picture), edges(torch.zeros_like(picture)))) == pytest.approx(0.0, abs=1e-3)


def test_figures_of_known_records():
    styles = {
        "chosen_image": [0.0, 0.0, 1.0, 0.0],  # two styles, two views: three of four are right
        "chosen_text": [1.0, 1.0, 0.0, 0.0],
        "color": [0.2, 0.2, 0.4, 0.4],
        "unstyled_color": [0.5, 0.5, 0.5, 0.5],
        "edge_correlation": [0.5, 1.0, 0.5, 1.0],
    }
    strips = [{"fractions": [0.1, 0.2, 0.3]}, {"fractions": [0.1, 0.3, 0.2]}]
    found, unstyled = style_figures([styles], strips, 2)
    assert found == pytest.approx(
        {
            "style_retrieval_image": 0.75,
            "style_retrieval_text": 0.0,
            "color_match_ratio": 0.6,
            "edge_correlation": 0.75,
            "interpolation_monotone": 0.5,
        }
    )
    assert unstyled["style_retrieval_image"] == 0.5 and unstyled["color_match_ratio"] == 1.0
    geometry = {
        "rotation_deg": [1.0, 9.0, 2.0],
        "direction_deg": [3.0, 4.0, 90.0],
        "depth_abs_rel": [0.2],
        "psnr_input_views": [20.0, 30.0],
        "psnr_novel_views": [10.0, 20.0],
    }
    figures = geometry_figures([geometry])
    assert figures["rotation_error_median_deg"] == 2.0 and figures["psnr_input_views"] == 25.0
    motions = {"rotations": torch.eye(3).flatten().tolist(), "directions": [0.0, 0.0, 1.0]}
    baseline = baseline_figures([{**geometry, **motions}])
    assert baseline["rotation_error_median_deg"] == pytest.approx(0.0, abs=0.05)
    assert {*figures, *found, "retrieval_text_to_image", "retrieval_image_to_text"} == set(BETTER)


def test_a_record_is_made_once_and_again_where_its_seal_is_another(tmp_path: Path):
    made: list[int] = []

    def make() -> dict[str, dict[str, list[float]]]:
        made.append(1)
        return {"scene": {"x": [0.1 + len(made)]}}

    file = tmp_path / "scene" / "record.json"
    first = kept(file, "a", make)
    assert kept(file, "a", make) == first == json.loads(json.dumps(first)) and len(made) == 1
    assert kept(file, "b", make) != first and len(made) == 2
    file.write_text("{", encoding="utf-8")
    assert kept(file, "b", make)["scene"]["x"] == [3.1]
