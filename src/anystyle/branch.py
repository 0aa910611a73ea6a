"""The style branch: trainable copies of a backbone's parts, with an injector at each chosen site."""

import copy
from collections.abc import Callable, Sequence
from dataclasses import replace

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.contracts import Backbone, Injector, StylePredictor, style_tokens
from anystyle.types import Attributes, Cameras, Scene, Site, Source, StyleEmbedding, Tokens, contiguous

ATTRIBUTES = ("opacity", "scale", "rotation", "color")
COLOR = "color"
"""The site that every branch offers: the colour coefficients of all pixels as the Gaussian head gives them."""


def sites_of(backbone: Backbone, sh_degree: int = 0) -> tuple[Site, ...]:
    """Where style may enter, in the order of the computation: the backbone's own sites, then :data:`COLOR`.

    At ``COLOR`` a token is a pixel, with its colour coefficients up to ``sh_degree``.
    """
    return (*backbone.sites, Site(COLOR, 3 * (sh_degree + 1) ** 2))


class StyleBranch(StylePredictor):
    """Predicts styled attributes for an encoded scene (paper, equations 5 and 6).

    The aggregator is copied if one of its sites is chosen, for otherwise its features are those of the scene; the
    Gaussian head if one of the aggregator's or its own is. With :data:`COLOR` alone nothing is copied, and a further
    style costs the injector alone. At initialisation every injector is the identity and the copies compute what the
    originals do, so a stylized scene equals the unstyled one bit for bit.

    Args:
        backbone: The network to copy from; left as it is.
        sites: Where style enters, of :func:`sites_of`.
        make_injector: Builds the injector of a site.
        styled: The attributes taken from this branch, of ``opacity, scale, rotation, color``; the paper styles
            rotation and colour, its ablation "all geometry" all four.
        sh_degree: Degree of the styled colours; the published weights use the constant coefficient alone.
        single_view: Each surface point takes its styled colour from one view, so that strokes that were painted view
            by view do not average out; see :func:`single_view_colors`. For injectors that
            paint pictures: with it even a style that changes nothing repaints the scene.
    """

    def __init__(
        self,
        backbone: Backbone,
        *,
        sites: Sequence[Site],
        make_injector: Callable[[Site], Injector],
        styled: Sequence[str] = ("rotation", "color"),
        sh_degree: int = 0,
        single_view: bool = False,
    ) -> None:
        super().__init__()
        if not set(styled) <= set(ATTRIBUTES) or len(set(styled)) != len(styled):
            raise ValueError(f"styled attributes are {list(styled)}; choose each once from {', '.join(ATTRIBUTES)}")
        chosen = {site.name for site in sites}
        in_aggregator = any(site.name in chosen for site in backbone.aggregator.sites)
        has_head = in_aggregator or any(site.name in chosen for site in backbone.gaussian_head.sites)
        self.styled, self.sh_degree, self.single_view = tuple(styled), sh_degree, single_view
        self.aggregator = copy.deepcopy(backbone.aggregator).requires_grad_() if in_aggregator else None
        self.gaussian_head = copy.deepcopy(backbone.gaussian_head).requires_grad_() if has_head else None
        self.injectors = nn.ModuleDict({site.name: make_injector(site) for site in sites})
        self.reads_tokens = any(isinstance(one, Injector) and one.reads_tokens for one in self.injectors.values())

    @property
    def sources(self) -> tuple[Source, ...]:
        """The published weights that injectors started from, each once."""
        injectors = (injector for injector in self.injectors.values() if isinstance(injector, Injector))
        return tuple(dict.fromkeys(source for injector in injectors for source in injector.sources))

    @property
    def paints_strokes(self) -> bool:
        """Whether the scale of an embedding changes what is painted."""
        return any(isinstance(one, Injector) and one.at_scale(1.0) is not None for one in self.injectors.values())

    def _at_scale(self, scale: float) -> dict[str, nn.Module]:
        injectors = dict(self.injectors.items())
        if scale != 1:
            scaled = {site: one.at_scale(scale) for site, one in injectors.items() if isinstance(one, Injector)}
            injectors |= {site: one for site, one in scaled.items() if one is not None}
        return injectors

    def forward(self, scene: Scene, embedding: StyleEmbedding) -> Attributes:
        """The attributes of ``scene`` in each style; scenes and styles are paired row by row."""
        injectors = self._at_scale(embedding.scale)

        def inject(site: str, tokens: Tokens) -> Tokens:
            if site not in injectors:
                return tokens
            injector = injectors[site]
            reads_tokens = isinstance(injector, Injector) and injector.reads_tokens
            return injector(tokens, style_tokens(embedding).data[:, 0] if reads_tokens else embedding.vector)

        attributes = scene.attributes
        if self.gaussian_head is not None:
            features = scene.features if self.aggregator is None else contiguous(self.aggregator(scene.stem, inject))
            attributes = self.gaussian_head(features, scene.views.images, inject)
        attributes = attributes.with_degree(self.sh_degree)
        if COLOR in self.injectors:
            color = attributes.color  # B V H W 3 K
            pixels = Tokens(color.flatten(4).flatten(2, 3), grid=(color.shape[2], color.shape[3]))
            attributes = replace(attributes, color=inject(COLOR, pixels).data.reshape(color.shape))
        if self.single_view and scene.gaussians is None:
            attributes = replace(attributes, color=_single_view(scene, attributes.color))
        return attributes


def _single_view(scene: Scene, color: Float[Tensor, "B V H W 3 K"]) -> Float[Tensor, "B V H W 3 K"]:
    """Single-view texturing of the pixels' colours; fused pixels are one point."""
    if scene.clusters is None:
        points = scene.geometry.points()
    else:
        points = scene.clusters.means.take_along_dim(scene.clusters.index[..., None], dim=1)
    points = points.view(*color.shape[:4], 3)
    with torch.autocast(color.device.type, enabled=False):  # positions need all their bits
        return single_view_colors(color.flatten(4), points, scene.cameras).view_as(color)


def single_view_colors(
    color: Float[Tensor, "B V H W C"], points: Float[Tensor, "B V H W 3"], cameras: Cameras, tolerance: float = 0.15
) -> Float[Tensor, "B V H W C"]:
    """Repaint points by the first view that sees them, so that views which were painted one by one agree.

    As surfaces are textured from photographs (Lempitsky and Ivanov, CVPR 2007), but with few and large patches: views
    come in the order of their distance from the origin of the scene's frame, where bundled backbones place the view
    that differs least from all others. Colours are interpolated bicubically and differentiable; the choice of views is
    constant. A view sees a point whose distance along z is within the ``tolerance`` of that of the pixel it falls on;
    points that no view sees keep their colours.
    """
    rows = zip(color, points, cameras.world_from_camera, cameras.intrinsics, strict=True)
    return torch.stack([_repainted(*row, tolerance) for row in rows])


def _repainted(
    color: Float[Tensor, "V H W C"],
    points: Float[Tensor, "V H W 3"],
    world_from_camera: Float[Tensor, "V 4 4"],
    intrinsics: Float[Tensor, "V 3 3"],
    tolerance: float,
) -> Float[Tensor, "V H W C"]:
    height, width = color.shape[1:3]
    limit = points.new_tensor([width, height])
    flat, painted = points.detach().flatten(0, 2), color.flatten(0, 2).clone()
    left = torch.arange(len(flat), device=flat.device)
    for view in world_from_camera[:, :3, 3].norm(dim=-1).argsort().tolist():
        rotation, origin = world_from_camera[view, :3, :3], world_from_camera[view, :3, 3]
        depth = (points[view].detach() - origin) @ rotation[:, 2]  # H W
        in_camera = (flat[left] - origin) @ rotation
        z = in_camera[:, 2]
        xy = (in_camera @ intrinsics[view].mT)[:, :2] / z.clamp_min(1e-8)[:, None]
        inside = ((xy >= 0) & (xy < limit)).all(1) & (z > 0)
        column, row = torch.where(inside[:, None], xy, 0).long().unbind(1)
        expected = depth[row, column]
        seen = inside & ((z - expected).abs() <= tolerance * expected)
        grid, picture = (2 * xy[seen] / limit - 1)[None, None], color[view].movedim(-1, 0)[None].to(xy.dtype)
        sampled = F.grid_sample(picture, grid, mode="bicubic", padding_mode="border", align_corners=False)
        painted[left[seen]] = sampled[0, :, 0].mT.to(color.dtype)
        left = left[~seen]
    return painted.view_as(color)
