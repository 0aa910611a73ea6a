"""A stylized scene with all that led to it, made by the toy plugins: what losses and metrics are checked on."""

from dataclasses import replace

import torch
import torch.nn.functional as F

from anystyle.contracts import neutral_embedding
from anystyle.testing.inputs import generator, images, views
from anystyle.testing.subject import seeded
from anystyle.testing.toy.backbone import ToyBackbone
from anystyle.testing.toy.correspondence import ToyCorrespondence
from anystyle.testing.toy.loss import ToyLoss
from anystyle.testing.toy.style_encoder import ToyStyleEncoder
from anystyle.types import Comparison, Renders, Style, StyleEmbedding, Stylization

SIZE = (64, 80)
TEXTS = ("red and orange", "deep blue", "green")


def runtime() -> dict[str, object]:
    """What the framework passes to losses, metrics and methods that name it."""
    return {
        "style_encoder": ToyStyleEncoder().requires_grad_(False).eval(),
        "correspondence": ToyCorrespondence(),
        "losses": {"toy": ToyLoss()},
    }


def stylization(
    batch: int = 1, number: int = 2, size: tuple[int, int] = SIZE, *, image: bool = True, text: bool = True
) -> Stylization:
    """A stylization whose Gaussians and renders are leaves that take gradients; no scene's depend on the others."""
    given = views(batch, number, size)
    with seeded(0), torch.no_grad():
        backbone = ToyBackbone(dim=12, depth=2).freeze()
        scene = backbone.encode(given)
        gaussians = backbone.adapter(scene.attributes, scene.geometry, scene.clusters)
    # Photographs come with cameras and depth in training; here those of the scene, so that all is known.
    known = replace(given, cameras=scene.cameras, depth=scene.geometry.depth)
    style = Style(
        image=images(batch, (48, 40), seed=50) if image else None,
        text=tuple(TEXTS[row % len(TEXTS)] for row in range(batch)) if text else None,
        names=tuple(f"style_{row}" for row in range(batch)),
    )
    return Stylization(
        views=known,
        style=style,
        embedding=_embedding(style),
        scene=replace(scene, gaussians=gaussians.map(lambda tensor: 0.9 * tensor)),
        gaussians=gaussians.map(lambda tensor: tensor.clone().requires_grad_()),
        renders=_renders(known.images, scene.geometry.depth),
    )


def comparison(batch: int = 1, number: int = 3) -> Comparison:
    """What metrics compare, with all that can be known."""
    result = stylization(batch, number).comparison().detach()
    names = tuple(f"scene_{row}" for row in range(batch))
    return replace(result, scenes=names, styles=tuple(f"style_{row}" for row in range(batch)))


@torch.no_grad()
def _embedding(style: Style) -> StyleEmbedding:
    encoder = ToyStyleEncoder()
    if style.image is not None:
        vector = encoder.embed_images(style.image)
    else:
        assert style.text is not None
        vector = encoder.embed_texts(style.text)
    return StyleEmbedding(vector=vector, direction=F.normalize(vector - neutral_embedding(encoder), dim=-1))


def _renders(photographs: torch.Tensor, depth: torch.Tensor) -> Renders:
    noise = torch.stack([torch.rand(scene.shape, generator=generator(77)) for scene in photographs])
    color = 0.7 * photographs.flip(2) + 0.3 * noise
    alpha = torch.full_like(depth, 0.95)
    return Renders(color, 1.1 * depth * alpha, alpha).map(lambda tensor: tensor.clone().requires_grad_())
