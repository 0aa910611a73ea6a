"""Every part of the network against the published implementation."""

import anysplat_reference as reference
import pytest
import torch

from anystyle.injectors.zero_conv import ZeroConv
from anystyle.nn import dpt, tokens
from anystyle.nn.reference_view import Strategy
from anystyle.types import Attributes, Cameras, Geometry, Inject, Tokens
from anystyle_anysplat import heads, keys
from anystyle_anysplat.heads import CameraHead, GaussianHead, GeometryHead
from anystyle_anysplat.transformer import Aggregator, Dino, Embedder
from oracle import assert_matches, fill_sorted, golden, hashed

GOLDEN = golden("anystyle_golden")


def raw_maps(attributes: Attributes) -> torch.Tensor:
    """Attributes as the published head lays them out, B V 84 H W."""
    assert attributes.confidence is not None
    parts = [attributes.opacity[..., None], attributes.scale, attributes.rotation, attributes.color.flatten(4)]
    return torch.cat([*parts, attributes.confidence[..., None]], dim=-1).movedim(-1, 2)


def levels(first: int, dim: int, grid: tuple[int, int] = (2, 3)) -> dict[int, Tokens]:
    count = 5 + grid[0] * grid[1]
    return {k: Tokens(hashed(first + k, (1, 2, count, dim), -1, 1), grid=grid, special=5) for k in range(4)}


class TestPose:
    record = GOLDEN["pose_enc"]

    def cameras(self, size: tuple[int, int]) -> Cameras:
        return heads.decode_pose(torch.tensor(self.record["enc"]), size, focal_epsilon=1e-3)

    def test_decoding_is_the_published_one(self) -> None:
        cameras = self.cameras(tuple(self.record["hw"]))
        torch.testing.assert_close(cameras.camera_from_world[..., :3, :], torch.tensor(self.record["extrinsic_w2c"]))
        torch.testing.assert_close(cameras.intrinsics, torch.tensor(self.record["intrinsic_px"]))

    def test_points_of_pixels(self) -> None:
        depth = hashed(1043, (1, 2, 4, 6), 0.5, 3)
        geometry = Geometry(self.cameras((4, 6)), depth, torch.ones_like(depth))
        assert_matches(geometry.points(pixel_center=0.0), GOLDEN["unproject"]["points"])


class TestRope:
    def test_rotation_is_the_published_one(self) -> None:
        angles = tokens.rotary(tokens.grid_positions((2, 3), 5), 64, base=100.0, like=torch.zeros(1))
        assert_matches(tokens.rotate(hashed(1001, (1, 2, 11, 64), -1, 1), angles), GOLDEN["rope"]["out"])


@pytest.fixture(scope="module")
def dino() -> Dino:
    dino = Dino(dim=32, depth=2, heads=4, patch_size=14, grid=5, mlp_ratio=4.0)
    names = reference.fill(
        dino,
        keys.backbone_names,
        own="embedder.patches.",
        published="aggregator.patch_embed.",
        unused={"mask_token": (1, 32)},
    )
    assert names == GOLDEN["dino_tiny"]["keys"]
    return dino


def patches_of(*, dim: int, heads: int, grid: int, reference: Strategy = "first") -> Embedder:
    return Embedder(
        embed="conv",
        dim=dim,
        depth=0,
        heads=heads,
        mlp_ratio=4.0,
        registers=4,
        patch_size=14,
        grid=grid,
        reference=reference,
    )


class TestEmbedder:
    def test_positions_are_resampled_as_published(self, dino: Dino) -> None:
        assert_matches(dino.positions((3, 6)), GOLDEN["dino_tiny"]["pos_interp"])

    def test_dino_on_other_sizes(self, dino: Dino) -> None:
        out = dino(hashed(1002, (2, 3, 42, 84), -1, 1))
        assert_matches(out, GOLDEN["dino_tiny"]["x_norm_patchtokens"])

    def test_dino_on_its_own_size(self, dino: Dino) -> None:
        images = hashed(1003, (1, 3, 70, 70), -1, 1)
        assert_matches(dino(images), GOLDEN["dino_tiny"]["square_native"])

    def test_the_reference_has_camera_and_register_tokens_of_its_own(self) -> None:
        embedder = patches_of(dim=8, heads=1, grid=1, reference="middle")
        stem = embedder(hashed(1, (2, 3, 3, 14, 28)))
        assert stem.special == 5 and stem.reference is not None and stem.reference.tolist() == [1, 1]
        own, shared = torch.cat([embedder.camera_token, embedder.register_token], dim=2)[0]
        torch.testing.assert_close(stem.data[:, :, :5], torch.stack([shared, own, shared]).expand(2, -1, -1, -1))


def aggregator(dim: int, depth: int, heads: int, taps: tuple[int, ...]) -> Aggregator:
    return Aggregator(
        dim=dim,
        depth=depth,
        heads=heads,
        mlp_ratio=4.0,
        layer_scale=0.01,
        rope_base=100.0,
        taps=taps,
        checkpointing=False,
    )


def test_aggregator_with_its_special_tokens() -> None:
    record = GOLDEN["aggregator_tiny"]
    parts = torch.nn.ModuleDict(
        {
            "embedder": patches_of(dim=64, heads=4, grid=5),
            "aggregator": aggregator(64, 3, 4, (0, 2)),
        }
    )
    names = reference.fill(parts, keys.backbone_names, published="aggregator.")
    assert len(names) == record["n_keys"]
    with torch.no_grad():
        stem = parts["embedder"](hashed(1004, (1, 3, 3, 42, 84)))
        features = parts["aggregator"](stem)
    assert stem.special == record["patch_start_idx"] and list(features) == record["layers"]
    assert_matches(features[0].data, record["out0"])
    assert_matches(features[2].data, record["out1"])


def with_injectors(injectors: torch.nn.ModuleDict, style: torch.Tensor) -> Inject:
    return lambda site, tokens: injectors[site](tokens, style) if site in injectors else tokens


def test_injector() -> None:
    injector = ZeroConv(dim=64, style_dim=512, hidden=32)
    state = fill_sorted(injector.state_dict())
    injector.load_state_dict(state)
    zeros = Tokens(torch.zeros(1, 2, 3, 64), grid=(1, 3))
    assert_matches(injector(zeros, reference.style_vector()).data, GOLDEN["style_injector_1d"]["out"])


def test_styled_aggregator_at_full_width() -> None:
    record = GOLDEN["aggregator_injection_d5"]
    # Five layers have five published injectors, of which those of layers 0 and 4 are called; the others only count.
    parts = torch.nn.ModuleDict(
        {
            "aggregator": aggregator(1024, 5, 16, (0, 4)),
            "injectors": torch.nn.ModuleDict(
                {f"aggregator/{layer}": ZeroConv(dim=1024, style_dim=512) for layer in (0, 4, 5, 6, 7)}
            ),
        }
    )
    names = reference.fill(parts, keys.branch_names, published="aggregator_injection.")
    assert len(names) == record["n_keys"]
    stem = Tokens(hashed(1005, (1, 2, 9, 1024), -1, 1), grid=(2, 2), special=5)
    with torch.no_grad():
        features = parts["aggregator"](stem, with_injectors(parts["injectors"], reference.style_vector()))
    assert_matches(features[0].data, record["out0"])
    assert_matches(features[4].data, record["out1"])


def test_camera_head() -> None:
    record = GOLDEN["camera_head_tiny"]
    head = CameraHead(dim=64, depth=2, heads=4, mlp_ratio=4.0, layer_scale=0.01, iterations=4)
    names = reference.fill(head, keys.backbone_names, own="geometry_head.camera.", published="camera_head.")
    assert names == record["keys"]
    passes = head(hashed(1007, (1, 3, 4, 64), -1, 1)[:, :, 0])
    torch.testing.assert_close(passes, torch.tensor(record["iters"]), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("name", ["uv_grid_w3_h2_aspect2", "uv_embed_dim8", "uv_embed_w6_h4_aspect1.5_dim16"])
def test_positions_of_maps(name: str) -> None:
    record = GOLDEN[name]
    if name.startswith("uv_grid"):
        x, y = dpt.uv_grid((2, 3), 2.0)
        found = torch.stack([x.expand(2, 3), y[:, None].expand(2, 3)], dim=-1)
        torch.testing.assert_close(found.float(), torch.tensor(record), rtol=1e-6, atol=1e-7)
        return
    grid, aspect, channels = ((2, 3), 2.0, 8) if name == "uv_embed_dim8" else ((4, 6), 1.5, 16)
    found = 10 * dpt.add_positions_(torch.zeros(1, channels, *grid), aspect)[0].movedim(0, -1)
    if name == "uv_embed_dim8":
        torch.testing.assert_close(found, torch.tensor(record), rtol=1e-5, atol=1e-6)
    else:
        assert_matches(found, record)


@pytest.mark.parametrize("chunk", [1, 8])
def test_depth_head(chunk: int) -> None:
    record = GOLDEN["depth_head_tiny"]
    camera = CameraHead(dim=32, depth=1, heads=4, mlp_ratio=4.0, layer_scale=0.01, iterations=1)
    depth = dpt.Dpt(dim=32, features=16, channels=(8, 12, 16, 16), hidden=32, outputs=2)
    names = reference.fill(depth, keys.backbone_names, own="geometry_head.depth.", published="depth_head.")
    assert len(names) == record["n_keys"]
    head = GeometryHead(camera=camera, depth=depth, taps=(0, 1, 2, 3), chunk=chunk, focal_epsilon=1e-3)
    with torch.no_grad():
        geometry = head(levels(1010, 32), torch.zeros(1, 2, 3, 28, 42))
    assert_matches(geometry.depth[..., None], record["depth"])
    assert_matches(geometry.confidence, record["conf"])


def gaussian_head(dim: int, channels: tuple[int, ...], chunk: int = 4) -> GaussianHead:
    decoder = dpt.Dpt(dim=dim, features=256, channels=channels, hidden=128, outputs=84)
    return GaussianHead(decoder, sh_degree=4, taps=(0, 1, 2, 3), chunk=chunk)


@pytest.mark.parametrize("chunk", [1, 4])
def test_gaussian_head(chunk: int) -> None:
    record = GOLDEN["gs_head_tiny"]
    head = gaussian_head(32, (8, 12, 16, 16), chunk)
    names = reference.fill(head, keys.backbone_names, own="gaussian_head.", published="gaussian_param_head.")
    assert len(names) == record["n_keys"]
    with torch.no_grad():
        attributes = head(levels(1010, 32), hashed(1014, (1, 2, 3, 28, 42)))
    assert_matches(raw_maps(attributes), record["out"])


def test_styled_gaussian_head_at_full_width() -> None:
    record = GOLDEN["gs_head_style_full"]
    head = gaussian_head(2048, (256, 512, 1024, 1024))
    injectors = torch.nn.ModuleDict(
        {
            site.name: ZeroConv(dim=site.dim, style_dim=512, hidden=256 if site.name == "head/direct" else 1024)
            for site in head.sites
        }
    )
    parts = torch.nn.ModuleDict({"gaussian_head": head, "injectors": injectors})
    names = reference.fill(parts, keys.branch_names, published="gaussian_param_head_style.")
    assert len(names) == record["n_keys"]
    with torch.no_grad():
        attributes = head(
            levels(1020, 2048), hashed(1014, (1, 2, 3, 28, 42)), with_injectors(injectors, reference.style_vector())
        )
    assert_matches(raw_maps(attributes), record["out"])
