"""Test inputs of contracts: small, smooth, seeded, and the same on every machine."""

from dataclasses import replace

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Backbone, neutral_embedding
from anystyle.geometry.cameras import look_at
from anystyle.testing.toy.backbone import ToyBackbone
from anystyle.testing.toy.style_encoder import ToyStyleEncoder
from anystyle.types import Cameras, Comparison, Gaussians, Renders, Style, StyleEmbedding, Stylization, Views
from anystyle.types.seeds import seeded

SIZE = (64, 80)
TEXTS = ("red and orange", "deep blue", "green")


def generator(seed: int) -> torch.Generator:
    """A new generator for each input, so that none depends on those made before it."""
    return torch.Generator().manual_seed(seed)


def noise(like: Tensor, seed: int = 0) -> Tensor:
    """Normal noise of the shape and device of a tensor."""
    return torch.randn(like.shape, generator=generator(seed)).to(like)


def images(number: int, size: tuple[int, int], seed: int = 0) -> Float[Tensor, "M 3 H W"]:
    """Smooth colours with some grain, in [0, 1]; image ``i`` is the same whatever ``number`` is."""
    rows = []
    for index in range(number):
        source = generator(1000 * seed + index)
        coarse = torch.rand(1, 3, 4, 4, generator=source)
        smooth = F.interpolate(coarse, size=size, mode="bilinear", align_corners=True)
        rows.append(0.8 * smooth + 0.2 * torch.rand(1, 3, *size, generator=source))
    return torch.cat(rows)


def views(batch: int, number: int, size: tuple[int, int], seed: int = 0) -> Views:
    """Photographs of ``batch`` scenes without cameras; a scene's do not depend on the others'."""
    scenes = [images(number, size, seed=seed + scene) for scene in range(batch)]
    return Views(images=torch.stack(scenes), names=tuple(f"view_{index}" for index in range(number)))


def views_of(backbone: Backbone, batch: int, number: int, shape: tuple[int, int]) -> Views:
    """Photographs for a backbone, of ``shape`` in patches; with cameras if it reads any."""
    given = views(batch, number, (shape[0] * backbone.patch_size, shape[1] * backbone.patch_size))
    return replace(given, cameras=cameras(batch, number, given.size)) if backbone.reads_cameras else given


def cameras(batch: int, number: int, size: tuple[int, int]) -> Cameras:
    """Cameras side by side on an arc of radius 4 around the origin, all looking at it; each scene's arc is tilted."""
    turn, tilt = 0.15 * torch.arange(number).expand(batch, -1), 0.1 * torch.arange(batch)[:, None].expand(-1, number)
    eyes = 4 * torch.stack([-turn.sin() * tilt.cos(), tilt.sin(), -turn.cos() * tilt.cos()], dim=-1)
    focal = float(max(size))
    intrinsics = torch.tensor([[focal, 0.0, size[1] / 2], [0.0, focal, size[0] / 2], [0.0, 0.0, 1.0]])
    return Cameras(look_at(eyes, torch.zeros_like(eyes)), intrinsics.repeat(batch, number, 1, 1), size)


def gaussians(batch: int, number: int, coefficients: int = 4, seed: int = 0) -> Gaussians:
    """Gaussians that :func:`cameras` see, of distinct depths; a scene's do not depend on the other scenes."""
    rows = []
    for scene in range(batch):
        source = generator(7000 + 1000 * seed + scene)
        # No two at one depth: renderers may draw those in any order.
        heights = torch.linspace(-1, 1, number)[torch.randperm(number, generator=source)]
        means = torch.cat([torch.rand(number, 2, generator=source) * 2 - 1, heights[:, None]], dim=-1)
        rotations = F.normalize(torch.randn(number, 4, generator=source), dim=-1)
        scales = 0.05 + 0.25 * torch.rand(number, 3, generator=source)
        opacities = 0.2 + 0.7 * torch.rand(number, generator=source)
        harmonics = 0.4 * torch.randn(number, coefficients, 3, generator=source)
        rows.append(Gaussians(means[None], rotations[None], scales[None], opacities[None], harmonics[None]))
    return Gaussians.cat(rows)


def style_encoder() -> ToyStyleEncoder:
    """The frozen style encoder that losses, metrics and trainings are given."""
    return ToyStyleEncoder().requires_grad_(False).eval()


def stylization(
    batch: int = 1, number: int = 2, size: tuple[int, int] = SIZE, *, image: bool = True, text: bool = True
) -> Stylization:
    """A stylization whose Gaussians and renders are leaves that take gradients; no scene's depend on the others."""
    given = views(batch, number, size)
    with seeded(0), torch.no_grad():
        backbone = ToyBackbone(dim=12, depth=2).freeze()
        scene = backbone.encode(given)
        gaussians = backbone.adapter(scene.attributes, scene.geometry, scene.clusters)
    style = Style(
        image=images(batch, (48, 40), seed=50) if image else None,
        text=tuple(TEXTS[row % len(TEXTS)] for row in range(batch)) if text else None,
        names=tuple(f"style_{row}" for row in range(batch)),
    )
    encoder = style_encoder()
    vector = encoder.embed_texts(style.text or ()) if style.image is None else encoder.embed_images(style.image)
    grain = torch.stack([torch.rand(scene.shape, generator=generator(77)) for scene in given.images])
    alpha = torch.full_like(scene.geometry.depth, 0.95)
    renders = Renders(0.7 * given.images.flip(2) + 0.3 * grain, 1.1 * scene.geometry.depth * alpha, alpha)
    return Stylization(
        # In training photographs come with cameras and depth; here they are those of the scene.
        views=replace(given, cameras=scene.cameras, depth=scene.geometry.depth),
        style=style,
        embedding=StyleEmbedding(vector, F.normalize(vector - neutral_embedding(encoder), dim=-1)),
        scene=replace(scene, gaussians=gaussians.map(lambda tensor: 0.9 * tensor)),
        gaussians=gaussians.map(lambda tensor: tensor.clone().requires_grad_()),
        renders=renders.map(lambda tensor: tensor.clone().requires_grad_()),
        identity=renders.map(lambda tensor: tensor.flip(1).clone().requires_grad_()),
    )


def comparison(batch: int = 1, number: int = 3) -> Comparison:
    """What metrics compare, with cameras and depth."""
    result = stylization(batch, number).comparison().detach()
    names = tuple(f"scene_{row}" for row in range(batch))
    return replace(result, scenes=names, styles=tuple(f"style_{row}" for row in range(batch)))
