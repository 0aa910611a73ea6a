"""Parts in closed form or against the published code: positions, the adapter, pictures, losses, cameras of points."""

import math
from pathlib import Path

import pytest
import torch
from torch import Tensor

from anystyle.geometry.projection import covariances
from anystyle.geometry.transforms import matrix_from_vector
from anystyle.losses.content import Content
from anystyle.losses.style import StyleLoss
from anystyle.nn.tokens import rotary, rotate
from anystyle.testing.inputs import stylization
from anystyle.testing.oracle import hashed, smooth_image
from anystyle.types import Attributes, Cameras, Geometry, Renders, Stylization, Tokens
from anystyle.vision import networks, weights
from anystyle_backbones.styl3r import Styl3r
from anystyle_backbones.styl3r.losses import Identity
from anystyle_backbones.styl3r.pointmaps import cameras_of, focal_of, points_of
from anystyle_backbones.styl3r.style_encoder import middle_squares
from anystyle_backbones.styl3r.transformer import angles_of
from tests.support import oracle
from tests.support import styl3r_reference as reference
from tests.support.style_cases import filled_vgg_file
from tests.support.style_cases import stylization as stylized

GOLDEN = reference.record()


def test_rope() -> None:
    record = GOLDEN["rope"]
    tokens = hashed(290, (1, 2, 6, 16), -1, 1)
    angles = rotary(torch.tensor(record["positions"]).float(), 16, base=100.0, like=tokens)
    oracle.check(rotate(tokens, angles), record["rotated"], "rope")


def test_the_intrinsics_stand_below_the_first_column() -> None:
    tokens = Tokens(torch.zeros(1, 1, 7, 8), (2, 3), special=1)
    places = torch.tensor([[2.0, 0], [0, 0], [0, 1], [0, 2], [1, 0], [1, 1], [1, 2]])
    expected = rotary(places, 8, base=100.0, like=tokens.data)
    found = angles_of(tokens, dim=8, base=100.0)
    assert torch.equal(found.cos, expected.cos) and torch.equal(found.sin, expected.sin)


def geometry_at(points: Tensor) -> Geometry:
    shape = points.shape[:-1]
    eye = torch.eye(4).expand(*shape[:2], 4, 4)
    return Geometry(Cameras(eye, eye[..., :3, :3], shape[2:]), torch.ones(shape), torch.ones(shape), points)


def test_adapter() -> None:
    record = GOLDEN["adapter"]
    raw, means = hashed(301, (40, 82), -1, 1), hashed(300, (40, 3), -2, 2)
    raw[:, :3] *= 400
    opacities = hashed(302, (40,), 0, 1)
    shape = (1, 1, 5, 8)
    attributes = Attributes(
        opacity=torch.logit(opacities).view(shape),
        scale=raw[:, :3].view(*shape, 3),
        rotation=raw[:, 3:7].view(*shape, 4),
        color=raw[:, 7:].view(*shape, 3, 25),
    )
    example = Styl3r.example(Path()) | {"sh_degree": 4, "scale_unit": 0.001}
    adapter, geometry = Styl3r(**example).adapter, geometry_at(means.view(*shape, 3))
    assert adapter.cluster(geometry, attributes) is None
    gaussians = adapter(attributes, geometry, None)
    assert torch.equal(gaussians.means[0], means)
    torch.testing.assert_close(gaussians.opacities[0], opacities, rtol=1e-5, atol=1e-6)
    oracle.check(gaussians.scales[0], record["scales"], "scales")
    oracle.check(gaussians.rotations[0].roll(-1, dims=-1), record["rotations"], "rotations_xyzw")
    oracle.check(covariances(gaussians.rotations, gaussians.scales)[0].flatten(1), record["covariances"], "covariances")
    oracle.check(gaussians.harmonics[0].mT.flatten(1), record["harmonics"], "harmonics")
    assert bool((gaussians.scales == 0.3).any()) and bool((gaussians.scales < 0.3).any())


@pytest.mark.parametrize(
    ("name", "index", "shape"), [("style_wide", 326, (3, 300, 403)), ("style_tall", 328, (3, 389, 200))]
)
def test_style_pictures_are_cut_as_published(name: str, index: int, shape: tuple[int, ...]) -> None:
    pictures = (smooth_image(index, shape) * 255).floor()[None] / 255  # of 8 bits, truncated as published
    oracle.check(middle_squares(pictures, 256)[0], GOLDEN["preprocessing"][name], "preprocessing")
    learnt = middle_squares(pictures.clone().requires_grad_(), 256)
    assert learnt.requires_grad and float((learnt.detach() - middle_squares(pictures, 256)).abs().mean()) < 0.02


class TestLosses:
    @pytest.fixture(autouse=True)
    def vgg(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv(weights.FOLDERS, str(filled_vgg_file(gain=False).parent))

    renders, photographs = (smooth_image(index, (2, 3, 3, 48, 64)) for index in (340, 342))
    styles = smooth_image(344, (2, 3, 64, 80))

    def result(self) -> Stylization:
        return stylized(self.renders, self.photographs, self.styles)

    def test_features(self) -> None:
        record = GOLDEN["losses"]["vgg"]
        found = networks.load("vgg19")(self.renders.flatten(0, 1), list(record))
        for features, expected in zip(found, record.values(), strict=True):
            oracle.check(features, expected, "vgg")

    def test_the_objective_is_made_of_options(self) -> None:
        record, result = GOLDEN["losses"], self.result()
        content, style = Content(size=None, weight=1.0)(result), StyleLoss(size=None, weight=10.0)(result)
        assert content.item() == pytest.approx(record["content"], rel=1e-4)
        assert 10 * style.item() == pytest.approx(record["style_times_10"], rel=1e-4)
        assert (content + 10 * style).item() == pytest.approx(record["stylization_total"], rel=1e-4)

    def test_identity(self) -> None:
        record = GOLDEN["losses"]
        maps = torch.ones(2, 3, 48, 64)
        result = Stylization(**{**vars(self.result()), "identity": Renders(self.renders, maps, maps)})
        assert Identity()(result).item() == pytest.approx(record["identity_total"], rel=1e-4)
        plain = Identity(pixels=0.0)(result).item()
        assert record["identity_total"] - plain == pytest.approx(record["identity_pixels_times_70"], rel=1e-4)

    def test_identity_needs_its_renders(self) -> None:
        with pytest.raises(ValueError, match="in the style of the first photograph, and there are none"):
            Identity()(self.result())
        assert Identity().needs_identity and stylization().identity is not None


class TestCamerasOfPoints:
    size = (48, 64)

    def scene(self, focal: float = 50.0) -> tuple[Tensor, Tensor]:
        """World points that three cameras see at their pixels, and the cameras' poses."""
        motions = torch.tensor(
            [[0.0, 0, 0, 0, 0, 0], [0.1, -0.3, 0.05, 0.8, 0.1, -0.2], [-0.2, 0.6, 0.1, -1.0, 0.3, 0.5]]
        )
        pose = torch.eye(4).repeat(3, 1, 1)
        pose[:, :3, :3], pose[:, :3, 3] = matrix_from_vector(motions[:, :3]), motions[:, 3:]
        lens = torch.tensor([[focal, 0, 32], [0, focal, 24], [0, 0, 1]]).expand(1, 3, 3, 3)
        depth = 2 + 3 * smooth_image(5, (3, 3, *self.size))[:, 0]
        cameras = Cameras(pose[None], lens, self.size)
        return Geometry(cameras, depth[None], torch.ones_like(depth)[None]).points(), pose

    def test_they_are_found(self) -> None:
        points, pose = self.scene()
        cameras = cameras_of(points)
        assert torch.equal(cameras.world_from_camera[0, 0], torch.eye(4))
        torch.testing.assert_close(cameras.world_from_camera[0], pose, rtol=1e-4, atol=1e-4)
        assert cameras.intrinsics[0, :, 0, 0].tolist() == pytest.approx([50.0] * 3, rel=1e-4)
        assert cameras.intrinsics[0, 0, :2, 2].tolist() == [32, 24]

    def test_a_fifth_of_wrong_points_moves_them_little(self) -> None:
        points, pose = self.scene()
        wrong = hashed(9, points.shape[:-1]) < 0.2
        points = torch.where(wrong[..., None], points + hashed(10, points.shape, -2, 2), points)
        torch.testing.assert_close(cameras_of(points).world_from_camera[0], pose, rtol=0, atol=0.02)

    def test_scenes_are_fitted_each_by_itself(self) -> None:
        cameras = cameras_of(torch.cat([self.scene(40.0)[0], self.scene(60.0)[0]]))
        assert cameras.intrinsics[:, 0, 0, 0].tolist() == pytest.approx([40.0, 60.0], rel=1e-4)
        torch.testing.assert_close(cameras.world_from_camera[0], self.scene(40.0)[1], rtol=1e-4, atol=1e-4)

    @pytest.mark.parametrize("value", [0.0, -3.0, 1e4])
    def test_points_that_nothing_could_see_give_cameras_nevertheless(self, value: float) -> None:
        cameras = cameras_of(torch.full((1, 2, *self.size, 3), value))
        rotation = cameras.world_from_camera[..., :3, :3]
        torch.testing.assert_close(rotation @ rotation.mT, torch.eye(3).expand_as(rotation), rtol=0, atol=1e-4)
        assert bool(cameras.world_from_camera.isfinite().all()) and bool((cameras.intrinsics[..., 0, 0] > 0).all())

    def test_the_field_of_view_has_bounds(self) -> None:
        centred = hashed(3, (50, 2), -20, 20).double()
        points = torch.cat([centred, torch.full((50, 1), 1e6)], dim=1)[None].double()
        assert focal_of(points, centred, 40).item() == pytest.approx(20 / math.tan(math.radians(5)))

    def test_points_are_exponential_in_their_distance(self) -> None:
        found = points_of(torch.tensor([[0.0, 0, 0], [3.0, 0, 4.0], [0, -1e-4, 0]]))
        assert found[0].tolist() == [0, 0, 0]
        assert found[1].norm().item() == pytest.approx(math.exp(5) - 1, rel=1e-5)
        assert found[2, 1].item() == pytest.approx(-1e-4, rel=1e-3)
