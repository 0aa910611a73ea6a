"""A fitted scene repainted with strokes that are Gaussians."""

from dataclasses import dataclass, replace
from typing import Annotated, NamedTuple

import torch
from jaxtyping import Float, Int
from kornia.geometry.conversions import rotation_matrix_to_quaternion
from scipy.spatial import KDTree
from torch import Tensor
from torch.nn.functional import interpolate, normalize, pad

from anystyle.contracts import Method, Renderer
from anystyle.geometry.harmonics import constant_from_rgb, rgb_from_constant
from anystyle.methods.colors import fit_colors
from anystyle.ranges import Count, NonNegative, Range
from anystyle.stylizer import Stylizer
from anystyle.types import Cameras, Gaussians, OnProgress, Scene, Style, StyleEmbedding, no_progress
from anystyle_methods.flow import blur, flow, structure_tensor


class Layer(NamedTuple):
    """Strokes of one size, in pixels of a picture whose shorter side is :data:`SHORT_SIDE`."""

    spacing: float
    width: float
    length: float
    detail: float  # of the photograph, as a mean absolute difference from its blur, above which no stroke is painted
    bristles: int


SHORT_SIDE = 384
LAYERS = (Layer(14.6, 5.5, 20, 0.035, 3), Layer(7.1, 3, 11, 0.05, 2), Layer(3.5, 1.5, 6, torch.inf, 1))
"""Large strokes where little is to be seen, small ones everywhere, nearer to the viewer."""
OPACITY = 0.92
LIFT = 5  # pixels, by which a stroke lies in front of the surface: a share of the depth is far with a long lens
PAINTING = 0.35  # weight of the painting's own flow beside the scene's, which decides where a surface has no direction
NEIGHBORS = 12  # Gaussians whose centres make a surface's normal
MIN_PIXELS, MIN_OPACITY = 1.0, 0.2  # of a Gaussian that a stroke may be painted at


class Brush(Method):
    """Brush strokes on the surfaces of a scene, in the colours that the style branch paints.

    The scene takes these colours as it does in the single pass. Strokes lie on it, each a few flat, long Gaussians side
    by side: they follow the flow of the photographs (Litwinowicz 1997), and that of the painting where these have none;
    large ones first, smaller ones where there is detail (Hertzmann 1998). They are part of the scene, and the same from
    wherever it is seen.

    Args:
        size: Relative size of strokes; at 1 they are 5, 3 and 1.5 pixels of 384 wide.
        jitter: How much the lightness of strokes varies, in standard deviations of the painting's.
        seed: Seed of the strokes' positions and lightness.
    """

    def __init__(
        self, *, size: Annotated[float, Range(ge=0.1, le=10)] = 1.0, jitter: NonNegative = 0.5, seed: Count = 0
    ) -> None:
        self.size, self.jitter, self.seed = size, jitter, seed

    @torch.no_grad()
    def __call__(
        self,
        stylizer: Stylizer,
        scene: Scene,
        style: Style,
        embedding: StyleEmbedding,
        *,
        on_progress: OnProgress = no_progress,
    ) -> Gaussians:
        gaussians, renderer = scene.gaussians or stylizer.unstyled(scene), stylizer.renderer
        painted = rgb_from_constant(stylizer.branch(scene, embedding).color[0, ..., 0])
        painted = painted.clamp(0, 1).movedim(-1, 1).float()  # V 3 H W
        with torch.enable_grad():
            if scene.gaussians is None:
                base = stylizer.restyle(scene, embedding).detach()
            else:
                alpha = None if scene.views.alpha is None else scene.views.alpha[0]
                base = fit_colors(
                    gaussians, scene.cameras, painted, renderer, steps=2, largest=True, alpha=alpha
                ).detach()
            pixels = pixels_shown(gaussians, scene.cameras, renderer)
        canvas = _Canvas.of(scene, gaussians, pixels)
        photographs = rgb_from_constant(scene.attributes.color[0, ..., 0]).movedim(-1, 1).float()
        picture = painted if style.image is None else style.image.to(painted)
        pixel = min(painted.shape[-2:]) / SHORT_SIDE
        unit = self.size * embedding.scale * pixel
        generator = torch.Generator().manual_seed(self.seed)
        own = structure_tensor(picture, 1.5, 5.0).mean(0, keepdim=True)  # of one painting, or of all views
        own = interpolate(own, painted.shape[-2:], mode="bilinear")
        spread = self.jitter * float(picture.mean(1).std())
        layers = [base]
        for depth, layer in enumerate(LAYERS, start=1):
            sized = layer._replace(spacing=layer.spacing * unit, width=layer.width * unit, length=layer.length * unit)
            tensor = structure_tensor(photographs, 1.5, 1.2 * sized.width) + PAINTING * own
            detail = (photographs - blur(photographs, sized.width)).abs().mean(1, keepdim=True)
            chosen = canvas.choose(sized, blur(detail, 0.7 * sized.width)[:, 0], generator)
            colors = blur(painted, 0.5 * sized.width)
            lift = pixel * LIFT * (1 + depth) / 2
            layers.append(canvas.strokes(chosen, sized, tensor, colors, lift, spread, generator))
        missing = base.harmonics.shape[2] - 1
        layers[1:] = [replace(one, harmonics=pad(one.harmonics, (0, 0, 0, missing))) for one in layers[1:]]
        return Gaussians.cat(layers, dim=1)


def pixels_shown(gaussians: Gaussians, cameras: Cameras, renderer: Renderer) -> Float[Tensor, "V N"]:
    """How many pixels of each view each Gaussian makes."""
    rgb = torch.full_like(gaussians.means[0], 0.5).requires_grad_()
    harmonics = constant_from_rgb(rgb)[None, :, None]
    shown = []
    for view in range(cameras.intrinsics.shape[1]):
        render = renderer(replace(gaussians.detach(), harmonics=harmonics), cameras.select([view])).color
        shown.append(torch.autograd.grad(render[..., 0, :, :].sum(), rgb, retain_graph=True)[0][:, 0])
    return torch.stack(shown)


@dataclass(frozen=True)
class _Canvas:
    """Where strokes can be painted: places on surfaces, each with the view that shows it largest."""

    points: Float[Tensor, "N 3"]
    normals: Float[Tensor, "N 3"]  # towards that view
    rays: Float[Tensor, "N 3"]  # unit vectors from its camera
    views: Int[Tensor, " N"]  # that view
    pixels: Int[Tensor, "N 2"]  # column and row there
    scales: Float[Tensor, " N"]  # world units per pixel of the nearest view: so no stroke looks too large
    density: Float[Tensor, " N"]  # points per unit of area
    cameras: Cameras  # of all views

    @classmethod
    def of(cls, scene: Scene, gaussians: Gaussians, shown: Float[Tensor, "V N"]) -> "_Canvas":
        """The centres of Gaussians that views show enough of."""
        cameras, (height, width) = scene.cameras, scene.cameras.size
        seen = (shown.sum(0) >= MIN_PIXELS) & (gaussians.opacities[0] >= MIN_OPACITY)
        points, shown = gaussians.means[0, seen], shown[:, seen]
        views = shown.argmax(0)
        homogeneous = torch.cat([points, torch.ones_like(points[:, :1])], dim=1)
        local = torch.einsum("vij,nj->vni", cameras.camera_from_world[0, :, :3], homogeneous)
        depth = local[..., 2].clamp_min(1e-6)  # V N
        focal = cameras.intrinsics[0].diagonal(dim1=1, dim2=2)[:, :2].mean(1)
        scale = depth / focal[:, None]
        pixels = torch.einsum("vij,vnj->vni", cameras.intrinsics[0, :, :2], local / depth[..., None])
        size = torch.tensor([width, height]).to(pixels)
        visible = (shown > 0.05 * shown.amax(0)) & ((pixels >= 0) & (pixels < size)).all(-1)
        own = views[None]
        best = scale.gather(0, own)[0]
        nearest = scale.masked_fill(~visible, torch.inf).amin(0).minimum(best).maximum(0.4 * best)
        place = pixels.gather(0, own[..., None].expand(-1, -1, 2))[0]
        inside = visible.gather(0, own)[0]
        tree = KDTree(points.cpu().numpy())
        distances, index = tree.query(points.cpu().numpy(), k=min(NEIGHBORS + 1, len(points)))
        around = points[torch.from_numpy(index).to(points.device)]
        offsets = around - around.mean(1, keepdim=True)
        normals = torch.linalg.eigh(torch.einsum("nki,nkj->nij", offsets, offsets))[1][..., 0]
        rays = normalize(points - cameras.world_from_camera[0, views, :3, 3], dim=1)
        towards = -(normals * rays).sum(1, keepdim=True)
        normals = normals * towards.sign()
        normals = normalize(torch.where(towards.abs() < 0.4, normals - rays, normals), dim=1)  # grazing, hence unsure
        radius = torch.from_numpy(distances[:, -1]).to(points)
        density = distances.shape[1] / (torch.pi * radius.square().clamp_min(1e-20))
        fields = points, normals, rays, views, place.long(), nearest, density
        return cls(*(field[inside] for field in fields), cameras=cameras)

    def choose(self, layer: Layer, detail: Float[Tensor, "V H W"], generator: torch.Generator) -> Int[Tensor, " M"]:
        """Places for the strokes of a layer: as far apart as it says on average, where there is no more detail."""
        x, y = self.pixels.unbind(1)
        share = 1 / ((layer.spacing * self.scales).square() * self.density)
        wanted = torch.rand(len(share), generator=generator).to(share) < share
        return (wanted & (detail[self.views, y, x] < layer.detail)).nonzero()[:, 0]

    def strokes(
        self,
        chosen: Int[Tensor, " M"],
        layer: Layer,
        tensor: Float[Tensor, "V 3 H W"],
        colors: Float[Tensor, "V 3 H W"],
        lift: float,
        spread: float,
        generator: torch.Generator,
    ) -> Gaussians:
        """Strokes at these places, each of some bristles side by side, a Gaussian each."""
        direction, clarity = flow(tensor)
        views, (x, y) = self.views[chosen], self.pixels[chosen].unbind(1)
        rays, normals, scales = self.rays[chosen], self.normals[chosen], self.scales[chosen]
        focal = self.cameras.intrinsics[0, views].diagonal(dim1=1, dim2=2)[:, :2]
        in_image = torch.cat([direction[views, :, y, x] / focal, torch.zeros_like(focal[:, :1])], dim=1)
        in_world = torch.einsum("nij,nj->ni", self.cameras.world_from_camera[0, views, :3, :3], in_image)
        # Along the ray onto the surface.
        along = in_world - (in_world * normals).sum(1, keepdim=True) / (rays * normals).sum(1, keepdim=True) * rays
        along = normalize(along, dim=1)
        across = torch.linalg.cross(normals, along)
        lengths, widths = layer.length * scales * (0.6 + 0.8 * clarity[views, y, x]), layer.width * scales
        centers = self.points[chosen] - rays * (lift * scales)[:, None]
        color = colors[views, :, y, x] + spread * self._noise(chosen, generator)
        rotation = rotation_matrix_to_quaternion(torch.stack([along, across, normals], dim=2))
        bristles = []
        for number in range(layer.bristles):
            aside = (2.2 * number - 1.1 * (layer.bristles - 1)) / layer.bristles * widths
            ahead = 0.15 * lengths[:, None] * self._noise(chosen, generator)
            sizes = torch.stack([0.5 * lengths, 0.55 / layer.bristles * widths, 0.08 * widths], dim=1)
            shade = (color + 0.5 * spread * self._noise(chosen, generator)).clamp(0, 1)
            means = centers + across * aside[:, None] + along * ahead
            fields = means, rotation, sizes, torch.full_like(widths, OPACITY), constant_from_rgb(shade)[:, None]
            bristles.append(Gaussians(*(field[None] for field in fields)))
        return Gaussians.cat(bristles, dim=1)

    def _noise(self, chosen: Int[Tensor, " M"], generator: torch.Generator) -> Float[Tensor, "M 1"]:
        return torch.randn(len(chosen), 1, generator=generator).to(self.points)
