"""Metrics against numpy, SciPy, torch's own transformer and scenes that are known."""

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial.distance import cdist
from torch import nn

from anystyle.correspondences.rendered_depth import RenderedDepth
from anystyle.data.images import read_square
from anystyle.errors import UserError
from anystyle.testing.oracle import smooth_image
from anystyle.types import Comparison, Frames, Style
from anystyle_metrics import dino
from anystyle_metrics.csd import CSD
from anystyle_metrics.met3r import Met3rDepth
from anystyle_metrics.structure_distance import StructureDistance
from anystyle_metrics.style_sets import StyleSet, csls, gaps, named
from tests.support.known_scene import photographed_wall
from tests.support.real_data import real


def scores(metric, content, stylized, style=None, **known):
    given = None if style is None else Style(image=style[None])
    metric.reset()
    metric.update(Comparison(content[None], stylized[None], given, **known))
    return {name: float(value) for name, value in metric.scores().items()}


def noise_like(images):
    return torch.rand(images.shape, generator=torch.Generator().manual_seed(1))


def theirs(network):
    """The same network of torch's own layers."""
    layers = []
    for block in network.blocks:
        dim = block.norm1.weight.shape[0]
        layer = nn.TransformerEncoderLayer(
            dim, dim // 64, 4 * dim, activation="gelu", layer_norm_eps=1e-6, batch_first=True, norm_first=True
        )
        weights = {"self_attn.in_proj": block.attn.qkv, "self_attn.out_proj": block.attn.proj}
        weights |= {"linear1": block.mlp.fc1, "linear2": block.mlp.fc2, "norm1": block.norm1, "norm2": block.norm2}
        state = {}
        for name, part in weights.items():
            joint = "_" if name.endswith("in_proj") else "."
            state |= {f"{name}{joint}{key}": tensor for key, tensor in part.state_dict().items()}
        layer.load_state_dict(state)
        layers.append(layer.train())  # in eval they take another path; there is no dropout
        layer.dropout.p = layer.dropout1.p = layer.dropout2.p = layer.self_attn.dropout = 0.0
    return layers


@torch.no_grad()
def test_dino_is_torchs_own_transformer():
    torch.manual_seed(0)
    network = dino.Dino(128, 16, depth=3)
    for parameter in network.parameters():
        nn.init.normal_(parameter, std=0.2)
    for block in network.blocks:
        block.ls1.gamma.fill_(1), block.ls2.gamma.fill_(1)
    images = smooth_image(1, [2, 3, 224, 224])
    mean, std = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])
    patches = ((images - mean[:, None, None]) / std[:, None, None]).unfold(2, 16, 16).unfold(3, 16, 16)
    patches = torch.einsum("bcijuv,dcuv->bijd", patches, network.patch_embed["proj"].weight).flatten(1, 2)
    x = torch.cat([network.cls_token.expand(2, -1, -1), patches + network.patch_embed["proj"].bias], 1)
    x = x + network.pos_embed
    *first, last = theirs(network)
    for layer in first:
        x = layer(x)
    keys = nn.functional.linear(last.norm1(x), last.self_attn.in_proj_weight, last.self_attn.in_proj_bias)[..., 128:256]
    torch.testing.assert_close(network.keys(images), keys, rtol=1e-4, atol=1e-4)
    tokens = network.norm(last(x))[:, 1:].mT.unflatten(2, (14, 14))
    torch.testing.assert_close(network.maps(images), tokens, rtol=1e-4, atol=1e-4)


def test_published_files_are_loaded_and_named(tmp_path, monkeypatch):
    network = dino.Dino(*dino.SIZES["dino_vits16"])
    state = {key: tensor for key, tensor in network.state_dict().items() if ".ls" not in key}
    torch.save(state, tmp_path / "dino_deitsmall16_pretrain.pth")
    monkeypatch.setenv("ANYSTYLE_WEIGHTS", str(tmp_path))
    loaded, source = dino.load("dino_vits16", "published")
    images = smooth_image(2, [1, 3, 64, 112])
    torch.testing.assert_close(loaded.maps(images), network.eval().maps(images))
    assert loaded.maps(images).shape == (1, 384, 4, 7) and source.stand_in is None
    metric = Met3rDepth(weights="published")
    assert metric.stand_ins == {} and list(metric.weights) == ["dino_deitsmall16_pretrain.pth"]
    assert StructureDistance().stand_ins == {"structure_distance": "efficientnet_lite0"}


def test_structure_distance_is_scipys_cosines():
    content, stylized = smooth_image(3, [2, 3, 224, 288]), smooth_image(4, [2, 3, 224, 288])
    metric = StructureDistance(weights="stand_in")
    similarities = [
        [1 - cdist(keys, keys, "cosine") for keys in metric.network.keys(images).double().numpy()]
        for images in (content, stylized)
    ]
    expected = np.square(np.subtract(*similarities)).mean()
    np.testing.assert_allclose(scores(metric, content, stylized)["structure_distance"], expected, rtol=1e-4)


def test_structure_distance_puts_real_pictures_where_a_person_would():
    photo, painting = (read_square(real(path), 224) for path in ("photos/photo_00.jpg", "styles/style_00.jpg"))
    blurred = torch.from_numpy(gaussian_filter(photo.numpy(), (0, 0, 2, 2)))
    rows = [photo, photo.flip(1), blurred, painting, noise_like(photo)]
    same, recoloured, soft, pasted, noise = (
        scores(StructureDistance(weights="stand_in"), photo, row)["structure_distance"] for row in rows
    )
    assert same == 0 < recoloured < pasted < noise and 0 < soft < pasted


@torch.no_grad()
def test_met3r_warps_features_as_scipy_does():
    images, cameras, depth = photographed_wall(3)
    metric = Met3rDepth(weights="stand_in")
    maps = metric._features(images).double().numpy()
    poses, matrices = (each[0].double().numpy() for each in (cameras.world_from_camera, cameras.intrinsics))
    height, width = depth.shape[-2:]
    rows, columns = np.meshgrid(np.arange(2, height, 4), np.arange(2, width, 4), indexing="ij")

    def sampled(features, x, y):
        places = [y * features.shape[1] / height - 0.5, x * features.shape[2] / width - 0.5]
        return np.stack([map_coordinates(channel, places, order=1, mode="nearest") for channel in features])

    frames = Frames(images, depth, cameras.world_from_camera[0], cameras.intrinsics[0])
    pairs = []
    for first, second in ((0, 1), (1, 0), (1, 2), (2, 1)):
        pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(rows.shape)])
        rays = np.einsum("ij,jhw->ihw", np.linalg.inv(matrices[first]), pixels)
        points = rays * depth[first].double().numpy()[rows, columns]
        motion = np.linalg.inv(poses[second]) @ poses[first]
        local = np.einsum("ij,jhw->ihw", motion[:3, :3], points) + motion[:3, 3, None, None]
        x, y, z = np.einsum("ij,jhw->ihw", matrices[second], local)
        one, other = sampled(maps[first], pixels[0], pixels[1]), sampled(maps[second], x / z, y / z)
        cosines = (one * other).sum(0) / np.linalg.norm(one, axis=0) / np.linalg.norm(other, axis=0)
        views = [frames.map(lambda tensor, view=view: tensor[view : view + 1]) for view in (first, second)]
        pairs.append(cosines[RenderedDepth()(*views).visible[0].numpy()[rows, columns]].mean())
    found = scores(metric, images, images, cameras=cameras, depth=depth[None])["met3r_depth"]
    np.testing.assert_allclose(found, 1 - np.mean(pairs), rtol=1e-3)


def test_met3r_prefers_views_of_one_scene():
    images, cameras, depth = photographed_wall(4)
    known = {"cameras": cameras, "depth": depth[None]}
    scene, other, noise = (
        scores(Met3rDepth(weights="stand_in"), images, row, **known)["met3r_depth"]
        for row in (images, images[:1].expand_as(images), noise_like(images))
    )
    assert scene < 0.9 * other < other < noise


def test_views_are_neighbours_by_their_numbers():
    images, cameras, depth = photographed_wall(4)

    def found(metric, views, numbers=()):
        known = {"cameras": cameras.select(views), "depth": depth[None, views], "numbers": numbers}
        return scores(metric, images[views], images[views], **known)

    some = found(Met3rDepth(weights="stand_in"), [0, 1, 2, 3], (0, 1, 3, 4))["met3r_depth"]
    pairs = [found(Met3rDepth(weights="stand_in"), views)["met3r_depth"] for views in ([0, 1], [2, 3])]
    assert some == pytest.approx(np.mean(pairs), rel=1e-5)
    with pytest.warns(UserWarning, match="no two views"):
        assert np.isnan(found(Met3rDepth(weights="stand_in"), [0, 1], (0, 2))["met3r_depth"])


def test_csd_is_the_cosine_of_the_style_heads_outputs(tmp_path):
    torch.manual_seed(0)
    options = CSD.example(tmp_path)
    saved = torch.load(options["file"])["model_state_dict"]
    state = {key.removeprefix("module.").removeprefix("backbone."): tensor for key, tensor in saved.items()}
    layer = nn.TransformerEncoderLayer(
        64, 1, 256, activation=lambda x: x * torch.sigmoid(1.702 * x), batch_first=True, norm_first=True
    ).eval()
    names = {"attn": "self_attn", "mlp.c_fc": "linear1", "mlp.c_proj": "linear2", "ln_1": "norm1", "ln_2": "norm2"}
    block = {key.removeprefix("transformer.resblocks.0."): tensor for key, tensor in state.items() if "resbl" in key}
    pairs = ((own, name, key) for own, name in names.items() for key in block if key.startswith(own))
    layer.load_state_dict({name + key.removeprefix(own): block[key] for own, name, key in pairs})
    stats = torch.tensor([[0.48145466, 0.4578275, 0.40821073], [0.26862954, 0.26130258, 0.27577711]])

    def described(images):
        mean, std = stats[..., None, None]
        patches = nn.functional.conv2d((images - mean) / std, state["conv1.weight"], stride=56).flatten(2).mT
        tokens = torch.cat([state["class_embedding"].expand(len(images), 1, -1), patches], 1)
        tokens = tokens + state["positional_embedding"]
        normed = nn.functional.layer_norm(tokens, (64,), state["ln_pre.weight"], state["ln_pre.bias"])
        last = nn.functional.layer_norm(layer(normed)[:, 0], (64,), state["ln_post.weight"], state["ln_post.bias"])
        return nn.functional.normalize(last @ state["last_layer_style"], dim=-1)

    views, style = torch.rand(2, 3, 224, 224), torch.rand(3, 224, 224)
    with torch.no_grad():
        expected = (described(views) @ described(style[None])[0]).mean()
    metric = CSD(**options)
    assert scores(metric, views, views, style)["csd"] == pytest.approx(float(expected), abs=1e-5)
    assert scores(metric, views, style.expand_as(views), style)["csd"] == pytest.approx(1)
    assert set(metric.weights) == {"csd.pth"}


@pytest.mark.parametrize("styles", [3, 14])
def test_csls_and_gaps_are_those_of_numpy(styles):
    similar = np.random.default_rng(0).uniform(-1, 1, (styles, styles + 1)).astype(np.float32)
    results, nearest = (np.sort(similar, axis)[::-1] if axis == 0 else np.sort(similar)[:, ::-1] for axis in (0, 1))
    expected = 2 * similar - results[:10].mean(0) - nearest[:, :10].mean(1, keepdims=True)
    np.testing.assert_allclose(csls(torch.from_numpy(similar)), expected, atol=1e-6)
    square = similar[:, :styles]
    alike = (square + square.T) / 2
    others = [max(alike[i, j] for j in range(styles) if j != i) for i in range(styles)]
    np.testing.assert_allclose(gaps(torch.from_numpy(square)), np.diag(alike) - others, atol=1e-6)


class Colours(StyleSet):
    """Mean colours as vectors, in which a grey style is a hub."""

    better = named("colours")

    def vectors(self, images):
        return nn.functional.normalize(images.mean((2, 3)), dim=-1)[:, None]

    def similar(self, rows, styles):
        return rows @ styles.mT

    def value(self, similar, own):
        return (similar.argmax(1) == own).double()


def test_a_hub_is_corrected_and_styles_that_are_not_told_apart_are_counted():
    colour = torch.tensor([[1.0, 0.2, 0.2], [0.2, 1, 0.2], [0.2, 0.2, 1], [0.7, 0.7, 0.7]])[..., None, None]
    shown = colour.expand(-1, 3, 8, 8) * 0.3 + 0.35
    rows, style = torch.cat([shown[:3], shown[3:]])[:, None], colour.expand(-1, 3, 8, 8).clone()
    metric = Colours()
    metric.update(rows, style=style, scenes=("one",) * 4)
    assert metric.compute()["colours"] < metric.compute()["colours_csls"] == 1 and metric.compute()["colours_gap"] > 0
    style[:2, :, :4], style[:2, :, 4:] = colour[:1], colour[1:2]  # each half is the other one's
    turned = style.clone()
    turned[1] = style[1].flip(1)  # another style, whose halves are as unlike
    for shown, counted in ((style, "1 of 3"), (turned, "2 of 4")):
        metric.reset()
        metric.update(rows, style=shown, scenes=("one",) * 4)
        with pytest.warns(UserWarning, match=f"colours does not tell {counted} styles from another"):
            metric.compute()


def test_csd_needs_its_own_weights(tmp_path):
    views = torch.rand(1, 3, 32, 32)
    with pytest.raises(UserError, match=r"csd_vit_l.*CSD-ViT-L"):
        scores(CSD(), views, views, views[0])
    torch.save({"model_state_dict": {"module.last_layer_style": torch.zeros(1, 1)}}, tmp_path / "other.pth")
    with pytest.raises(UserError, match="does not fit"):
        scores(CSD(file=str(tmp_path / "other.pth")), views, views, views[0])
