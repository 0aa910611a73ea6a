"""A fitted scene repainted with strokes that are Gaussians."""

from dataclasses import dataclass, replace
from typing import Annotated, NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from kornia.geometry.conversions import rotation_matrix_to_quaternion
from scipy.spatial import KDTree
from torch import Tensor
from torch.nn.functional import interpolate, normalize, pad

from anystyle.contracts import Method
from anystyle.errors import UserError
from anystyle.geometry.harmonics import constant_from_rgb, rgb_from_constant
from anystyle.methods.branch import painted
from anystyle.methods.colors import fit_colors, pixels_shown
from anystyle.ranges import Count, NonNegative, Range
from anystyle.stylizer import Stylizer
from anystyle.types import Cameras, Gaussians, OnProgress, Scene, Style, StyleEmbedding, no_progress
from anystyle_methods.flow import blur, flow, structure_tensor
from anystyle_methods.marks import PaintingTexture, marks


class Layer(NamedTuple):
    """Strokes of one size."""

    width: float  # of the painting's marks, as is the length
    length: float
    detail: float  # of the photograph, as a mean absolute difference from its blur, above which no stroke is painted


LAYERS = (Layer(1.8, 0.8, 0.035), Layer(1.0, 0.45, 0.05), Layer(0.5, 0.22, torch.inf))
"""Large strokes where little is to be seen, small ones everywhere, nearer to the viewer."""


class Stroke(NamedTuple):
    """In pixels of the views."""

    width: float
    length: float
    bristles: int
    lift: float  # in front of the surface


SHORT_SIDE = 384
SPACING = 1.35  # of the root of a stroke's area
BRISTLE, NARROWEST = 1.8, 1.5  # pixels of SHORT_SIDE
OPACITY = 0.92
SAME_COLOR, STEPS = 0.16, 4  # of photographs, as a mean absolute difference, within which a stroke goes on
LIFT = 5  # pixels, by which a stroke lies in front of the surface: a share of the depth is far with a long lens
PAINTING = 0.35  # weight of the painting's own flow beside the scene's, which decides where a surface has no direction
NEIGHBORS = 32  # Gaussians whose centres make a surface's normal
MIN_PIXELS, MIN_OPACITY = 1.0, 0.2  # of a Gaussian that a stroke may be painted at


class Brush(Method):
    """Brush strokes on the surfaces of a scene, in the colours that the style branch paints.

    The scene takes these colours as it does in the single pass. Strokes lie on it, each a few flat, long Gaussians side
    by side, as wide and long as the painting's marks, and with its texture (:mod:`anystyle_methods.marks`). They follow
    the flow of the photographs (Litwinowicz 1997), and that of the painting where these have none, and end where the
    photograph's colour changes; large ones first, smaller ones where there is detail (Hertzmann 1998). They are part of
    the scene, and the same from wherever it is seen.

    Args:
        size: Size of strokes, relative to the painting's marks where its shorter side is the views'.
        texture: How much the colours of strokes and of their bristles vary, relative to those of the painting's marks.
        seed: Seed of the strokes' positions and textures.
    """

    def __init__(
        self, *, size: Annotated[float, Range(ge=0.1, le=10)] = 1.0, texture: NonNegative = 1.0, seed: Count = 0
    ) -> None:
        self.size, self.texture, self.seed = size, texture, seed
        self._canvas: tuple[Scene, _Canvas] | None = None  # of the last scene, for its next style

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
        renderer = stylizer.renderer
        seen, colors = painted(stylizer, scene, embedding)
        gaussians = scene.gaussians or stylizer.unstyled(scene)
        with torch.enable_grad():
            if scene.gaussians is None:
                base = stylizer.restyle(scene, embedding)
            else:
                alpha = None if seen.views.alpha is None else seen.views.alpha[0]
                base = fit_colors(gaussians, seen.cameras, colors, renderer, steps=4, largest=True, alpha=alpha)
        if self._canvas is None or self._canvas[0] is not scene:
            self._canvas = scene, _Canvas.of(seen, gaussians, pixels_shown(gaussians, seen.cameras, renderer))
        canvas = self._canvas[1]
        picture, short = colors if style.image is None else style.image.to(colors), min(colors.shape[-2:])
        pixel, found, scale = short / SHORT_SIDE, marks(picture, short), self.size * embedding.scale
        generator = torch.Generator().manual_seed(self.seed)
        own = structure_tensor(picture, 1.5, 5.0).mean(0, keepdim=True)  # of one painting, or of all views
        own = interpolate(own, colors.shape[-2:], mode="bilinear")
        layers = [base.detach()]
        for depth, layer in enumerate(LAYERS, start=1):
            width = max(layer.width * scale * found.width, NARROWEST * pixel)
            length = max(layer.length * scale * found.length, 2 * width)
            smooth = blur(canvas.photographs, width)
            detail = blur((canvas.photographs - smooth).abs().mean(1, keepdim=True), 0.7 * width)[:, 0]
            chosen = canvas.choose(SPACING * (width * length) ** 0.5, detail < layer.detail, generator)
            field = flow(blur(canvas.edges, 1.2 * width) + PAINTING * own)
            stroke = Stroke(width, length, max(1, round(width / (BRISTLE * pixel))), pixel * LIFT * (1 + depth) / 2)
            texture = PaintingTexture(picture, short, width, self.texture)
            layers.append(canvas.strokes(chosen, stroke, field, smooth, blur(colors, 0.5 * width), texture, generator))
        mode, more = base.antialiased, (0, 0, 0, base.harmonics.shape[2] - 1)
        layers[1:] = [replace(one.marked(mode), harmonics=pad(one.harmonics, more)) for one in layers[1:]]
        return Gaussians.cat(layers, dim=1)


@dataclass(frozen=True)
class _Canvas:
    """Where strokes can be painted: places on surfaces, each with the view that shows it largest."""

    points: Float[Tensor, "N 3"]
    normals: Float[Tensor, "N 3"]  # towards that view
    flatness: Float[Tensor, " N"]  # of the surface there, in [0, 1]
    rays: Float[Tensor, "N 3"]  # unit vectors from its camera
    views: Int[Tensor, " N"]  # that view
    pixels: Int[Tensor, "N 2"]  # column and row there
    scales: Float[Tensor, " N"]  # world units per pixel of the nearest view: so no stroke looks too large
    density: Float[Tensor, " N"]  # points per unit of area
    cameras: Cameras  # of all views
    photographs: Float[Tensor, "V 3 H W"]
    edges: Float[Tensor, "V 3 H W"]  # their structure tensor

    @classmethod
    def of(cls, scene: Scene, gaussians: Gaussians, shown: Float[Tensor, "V N"]) -> "_Canvas":
        """The centres of Gaussians that views show enough of."""
        cameras, (height, width) = scene.cameras, scene.cameras.size
        seen = (shown.sum(0) >= MIN_PIXELS) & (gaussians.opacities[0] >= MIN_OPACITY)
        if not bool(seen.any()):
            raise UserError("no Gaussian covers enough of a pixel for strokes to lie on; give larger views.short_side=")
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
        extents, axes = torch.linalg.eigh(torch.einsum("nki,nkj->nij", offsets, offsets))
        flatness = 1 - (extents[:, 0] / extents[:, 1].clamp_min(1e-20)).clamp(0, 1).sqrt()
        normals = axes[..., 0]
        rays = normalize(points - cameras.world_from_camera[0, views, :3, 3], dim=1)
        towards = -(normals * rays).sum(1, keepdim=True)
        normals = normals * towards.sign()
        normals = normalize(torch.where(towards.abs() < 0.4, normals - rays, normals), dim=1)  # grazing, hence unsure
        radius = torch.from_numpy(distances[:, -1]).to(points)
        density = distances.shape[1] / (torch.pi * radius.square().clamp_min(1e-20))
        fields = points, normals, flatness, rays, views, place.long(), nearest, density
        photographs = rgb_from_constant(scene.attributes.color[0, ..., 0]).movedim(-1, 1).float()
        edges = structure_tensor(photographs, 1.5, 1.0)
        return cls(*(field[inside] for field in fields), cameras=cameras, photographs=photographs, edges=edges)

    def choose(self, spacing: float, free: Bool[Tensor, "V H W"], generator: torch.Generator) -> Int[Tensor, " M"]:
        """Places that are this many pixels apart on average, where views are free."""
        x, y = self.pixels.unbind(1)
        share = 1 / ((spacing * self.scales).square() * self.density)
        wanted = torch.rand(len(share), generator=generator).to(share) < share
        return (wanted & free[self.views, y, x]).nonzero()[:, 0]

    def strokes(
        self,
        chosen: Int[Tensor, " M"],
        stroke: Stroke,
        field: tuple[Float[Tensor, "V 2 H W"], Float[Tensor, "V H W"]],
        smooth: Float[Tensor, "V 3 H W"],
        colors: Float[Tensor, "V 3 H W"],
        texture: PaintingTexture,
        generator: torch.Generator,
    ) -> Gaussians:
        """Strokes at these places, each of some bristles side by side, a Gaussian each."""
        direction, clarity = field
        views, (x, y) = self.views[chosen], self.pixels[chosen].unbind(1)
        rays, normals, scales = self.rays[chosen], self.normals[chosen], self.scales[chosen]
        focal = self.cameras.intrinsics[0, views].diagonal(dim1=1, dim2=2)[:, :2]
        in_image = torch.cat([direction[views, :, y, x] / focal, torch.zeros_like(focal[:, :1])], dim=1)
        in_world = torch.einsum("nij,nj->ni", self.cameras.world_from_camera[0, views, :3, :3], in_image)
        # Along the ray onto the surface.
        along = in_world - (in_world * normals).sum(1, keepdim=True) / (rays * normals).sum(1, keepdim=True) * rays
        along = normalize(along, dim=1)
        across = torch.linalg.cross(normals, along)
        widths = stroke.width * scales
        lengths = stroke.length * self.flatness[chosen] * scales * (0.6 + 0.8 * clarity[views, y, x])
        back, ahead = (self._reach(chosen, sign * along, 0.5 * lengths, smooth) for sign in (-1, 1))
        lengths = (back + ahead).maximum(2 * widths)
        centers = self.points[chosen] + 0.5 * (ahead - back)[:, None] * along - rays * (stroke.lift * scales)[:, None]
        rotation = rotation_matrix_to_quaternion(torch.stack([along, across, normals], dim=2))
        sizes = torch.stack([0.5 * lengths, 0.55 / stroke.bristles * widths, 0.08 * widths], dim=1)
        color = colors[views, :, y, x]
        offsets = (torch.arange(stroke.bristles).to(color) - (stroke.bristles - 1) / 2) / stroke.bristles
        shades = color + texture.sample(color, stroke.width * offsets, generator)
        bristles = []
        for offset, shade in zip(offsets, shades.clamp(0, 1), strict=True):
            slip = 0.15 * lengths * torch.randn(len(chosen), generator=generator).to(lengths)
            means = centers + across * (2.2 * offset * widths)[:, None] + along * slip[:, None]
            fields = means, rotation, sizes, torch.full_like(widths, OPACITY), constant_from_rgb(shade)[:, None]
            bristles.append(Gaussians(*(field[None] for field in fields)))
        return Gaussians.cat(bristles, dim=1)

    def _reach(
        self,
        chosen: Int[Tensor, " M"],
        along: Float[Tensor, "M 3"],
        lengths: Float[Tensor, " M"],
        smooth: Float[Tensor, "V 3 H W"],
    ) -> Float[Tensor, " M"]:
        """How far strokes go in a direction, at most these lengths, until the colour is another."""
        views, (x, y) = self.views[chosen], self.pixels[chosen].unbind(1)
        limit = torch.tensor(smooth.shape[:1:-1]).to(along) - 1
        color, reach, goes = smooth[views, :, y, x], torch.zeros_like(lengths), torch.ones_like(views).bool()
        for step in range(1, STEPS + 1):
            points = self.points[chosen] + (step / STEPS * lengths)[:, None] * along
            pose = self.cameras.camera_from_world[0, views]
            local = (pose[:, :3, :3] @ points[..., None])[..., 0] + pose[:, :3, 3]
            places = (self.cameras.intrinsics[0, views] @ (local / local[:, 2:].clamp_min(1e-6))[..., None])[:, :2, 0]
            column, row = places.clamp_min(0).minimum(limit).long().unbind(1)
            goes = goes & ((smooth[views, :, row, column] - color).abs().mean(1) < SAME_COLOR)
            reach = torch.where(goes, step / STEPS * lengths, reach)
        return reach
