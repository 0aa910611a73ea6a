"""What contracts feed to plugins: small, smooth, seeded, and the same on every machine."""

import math
from dataclasses import replace

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import neutral_embedding
from anystyle.testing.subject import seeded
from anystyle.testing.toy.backbone import ToyBackbone
from anystyle.testing.toy.correspondence import ToyCorrespondence
from anystyle.testing.toy.loss import ToyLoss
from anystyle.testing.toy.style_encoder import ToyStyleEncoder
from anystyle.types import Cameras, Comparison, Frames, Gaussians, Renders, Style, StyleEmbedding, Stylization, Views


def generator(seed: int) -> torch.Generator:
    """A generator of its own for each input, so that none depends on those made before it."""
    return torch.Generator().manual_seed(seed)


def images(number: int, size: tuple[int, int], seed: int = 0) -> Float[Tensor, "M 3 H W"]:
    """Smooth colours with some grain, in [0, 1]; image ``i`` is the same whatever ``number`` is."""
    rows = []
    for index in range(number):
        source = generator(1000 * seed + index)
        coarse = torch.rand(1, 3, 4, 4, generator=source)
        smooth = F.interpolate(coarse, size=size, mode="bilinear", align_corners=True)
        grain = torch.rand(1, 3, *size, generator=source)
        rows.append(0.8 * smooth + 0.2 * grain)
    return torch.cat(rows)


def views(batch: int, number: int, size: tuple[int, int], seed: int = 0) -> Views:
    """Photographs of ``batch`` scenes without cameras; a scene's do not depend on the others'."""
    scenes = [images(number, size, seed=seed + scene) for scene in range(batch)]
    return Views(images=torch.stack(scenes), names=tuple(f"view_{index}" for index in range(number)))


def cameras(batch: int, number: int, size: tuple[int, int]) -> Cameras:
    """Cameras side by side on an arc of radius 4 around the origin, all looking at it; each scene's arc is tilted."""
    height, width = size
    focal = float(max(size))
    intrinsics = torch.tensor([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]])
    poses = torch.stack(
        [torch.stack([_pose(0.15 * view, 0.1 * scene) for view in range(number)]) for scene in range(batch)]
    )
    return Cameras(world_from_camera=poses, intrinsics=intrinsics.expand(batch, number, 3, 3), size=size)


def gaussians(batch: int, number: int, coefficients: int = 4, seed: int = 0) -> Gaussians:
    """Gaussians within reach of :func:`cameras`, of distinct depths; a scene's do not depend on the others'."""
    rows = []
    for scene in range(batch):
        source = generator(7000 + 1000 * seed + scene)
        # No two at one depth: where depths tie, the order of drawing is a renderer's own affair.
        heights = torch.linspace(-1, 1, number)[torch.randperm(number, generator=source)]
        across = torch.rand(number, 2, generator=source) * 2 - 1
        rows.append(
            {
                "means": torch.cat([across, heights[:, None]], dim=-1),
                "rotations": F.normalize(torch.randn(number, 4, generator=source), dim=-1),
                "scales": 0.05 + 0.25 * torch.rand(number, 3, generator=source),
                "opacities": 0.2 + 0.7 * torch.rand(number, generator=source),
                "harmonics": 0.4 * torch.randn(number, coefficients, 3, generator=source),
            }
        )
    return Gaussians(**{name: torch.stack([scene[name] for scene in rows]) for name in rows[0]})


def frames(number: int, size: tuple[int, int]) -> Frames:
    """Frames of a plane that faces the first of :func:`cameras`, with all that is known of them."""
    seen = cameras(1, number, size)
    return Frames(
        images=images(number, size),
        depth=torch.full((number, *size), 4.0),
        world_from_camera=seen.world_from_camera[0],
        intrinsics=seen.intrinsics[0],
    )


def _pose(turn: float, tilt: float) -> Float[Tensor, "4 4"]:
    cos, sin = math.cos(turn), math.sin(turn)
    yaw = torch.tensor([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])
    cos, sin = math.cos(tilt), math.sin(tilt)
    pitch = torch.tensor([[1.0, 0.0, 0.0], [0.0, cos, -sin], [0.0, sin, cos]])
    rotation = yaw @ pitch
    pose = torch.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -4.0 * rotation[:, 2]
    return pose


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
