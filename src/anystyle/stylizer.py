"""The method in one file: Figure 2 of the paper, top to bottom."""

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import replace

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.branch import StyleBranch
from anystyle.contracts import Backbone, Renderer, StyleEncoder, neutral_embedding
from anystyle.geometry.harmonics import rgb_from_constant
from anystyle.geometry.texturing import from_one_view
from anystyle.reconstructions.colors import FitColors, checked_steps, color_gaussians, colors_alone
from anystyle.types import Attributes, Cameras, Gaussians, Renders, Scene, StyleEmbedding, Views

PRECISIONS = ("fp32", "bf16", "reference")


class Stylizer(nn.Module):
    """Photographs and a style in, a stylized Gaussian scene out.

    The backbone and the style encoder are frozen; the style branch is what learns.

    Args:
        backbone: The reconstruction network.
        style_encoder: From images and texts to embeddings.
        branch: Predicts styled attributes.
        renderer: Shows scenes, and colours those whose Gaussians are not the backbone's.
        fit_colors: How these are coloured; see :func:`~anystyle.reconstructions.colors.color_gaussians`.
        keep_harmonics: Whether their harmonics above degree 0 stay as they are; they are dropped otherwise.

    Example:
        >>> stylizer = anystyle.load()
        >>> scene = stylizer.encode(views)
        >>> gaussians = stylizer.restyle(scene, stylizer.embed(text="thick swirling strokes in deep blue"))
        >>> renders = stylizer.render(gaussians, scene.cameras)
    """

    def __init__(
        self,
        *,
        backbone: Backbone,
        style_encoder: StyleEncoder,
        branch: StyleBranch,
        renderer: Renderer,
        fit_colors: FitColors = 6,
        keep_harmonics: bool = False,
    ) -> None:
        super().__init__()
        self.backbone = backbone.freeze()
        self.style_encoder = style_encoder.requires_grad_(False).eval()
        self.branch = branch
        self.renderer = renderer
        self.fit_colors: FitColors = checked_steps(fit_colors)
        self.keep_harmonics = keep_harmonics
        self.mixed = False

    def train(self, mode: bool = True) -> "Stylizer":
        """Set the mode of the style branch; what is frozen stays in ``eval``."""
        super().train(mode)
        self.style_encoder.eval()
        return self

    def set_precision(self, precision: str) -> "Stylizer":
        """Choose what inference computes in; weights lose what the precision cannot hold. Geometry is always fp32.

        Args:
            precision: ``fp32``; ``bf16``: weights and activations of transformers and Gaussian heads, half the memory;
                ``reference``: as the published code runs on a graphics card, the frozen transformers' weights in bf16
                and all matrix products of the rest.

        Raises:
            ValueError: There is no such precision.
        """
        for module in modules_in_bf16(precision, self.backbone, self.branch):
            module.to(torch.bfloat16)
        self.mixed = precision == "reference"
        return self

    @property
    def device(self) -> torch.device:
        """Where it computes."""
        return next(self.parameters()).device

    @contextlib.contextmanager
    def _precision(self, device: torch.device) -> Iterator[None]:
        # Where nothing is mixed, whoever trains has the say.
        with torch.autocast(device.type, torch.bfloat16) if self.mixed else contextlib.nullcontext():
            yield

    @torch.no_grad()
    def encode(self, views: Views) -> Scene:
        """Compute, once a scene, all that does not depend on style."""
        with self._precision(views.images.device):
            return self.backbone.encode(views)

    def encode_colors(self, views: Views) -> Scene:
        """What a branch needs that styles colours alone: the photographs' own colours, without any network.

        Raises:
            ValueError: Cameras are missing, or the branch reads more than colours.
        """
        if views.cameras is None or self.branch.gaussian_head is not None:
            raise ValueError("colours alone are encoded of views with cameras, for a style branch at placement=color")
        return colors_alone(views, views.cameras)

    @torch.no_grad()
    def embed(
        self, *, text: str | Sequence[str] | None = None, image: Float[Tensor, "B 3 h w"] | None = None
    ) -> StyleEmbedding:
        """Embed styles given as texts or as images; for a point between two, see :meth:`StyleEmbedding.toward`.

        Args:
            text: One description, or one a style.
            image: sRGB in [0, 1].

        Raises:
            ValueError: Neither is given, or both are.
        """
        if (text is None) == (image is None):
            raise ValueError("a style is either a text or an image; mix two embeddings with `toward`")
        if image is not None:
            vector = self.style_encoder.embed_images(image)
        else:
            assert text is not None
            vector = self.style_encoder.embed_texts([text] if isinstance(text, str) else list(text))
        direction = F.normalize(vector - neutral_embedding(self.style_encoder), dim=-1)
        return StyleEmbedding(vector=vector, direction=direction)

    def restyle(self, scene: Scene, embedding: StyleEmbedding) -> Gaussians:
        """Give an encoded scene a style; several styles of one scene are one batch.

        Raises:
            ValueError: There are several scenes, and not as many styles.
        """
        scene = _paired(scene, embedding)
        with self._precision(scene.views.images.device):
            styled = self.branch(scene, embedding)
        if scene.gaussians is not None:
            return self._recolored(scene, scene.gaussians, styled)
        attributes = scene.attributes.with_(styled, self.branch.styled)
        if self.branch.one_view:
            attributes = replace(attributes, color=_from_one_view(scene, attributes.color))
        return self.backbone.adapter(attributes, scene.geometry, scene.clusters)

    def _recolored(self, scene: Scene, gaussians: Gaussians, styled: Attributes) -> Gaussians:
        """Gaussians that are none of the backbone's, in the styled colours of pixels."""
        targets = rgb_from_constant(styled.color[..., 0]).clamp(0, 1).movedim(-1, 2).float()  # B V 3 H W
        rows: list[Gaussians] = []
        for row in range(len(targets)):
            given = gaussians.row(row)
            cameras = scene.cameras.row(row)
            origins = None if scene.origins is None else scene.origins[row]
            with torch.enable_grad():
                colored = color_gaussians(
                    given, cameras, targets[row], self.renderer, origins, self.fit_colors, keep=self.keep_harmonics
                )
                rows.append(colored)
        return Gaussians.cat(rows).detach()

    def unstyled(self, scene: Scene) -> Gaussians:
        """The reconstruction itself, with colours of the degree that styled ones have."""
        if scene.gaussians is not None:
            return scene.gaussians
        attributes = scene.attributes.with_degree(self.branch.sh_degree)
        return self.backbone.adapter(attributes, scene.geometry, scene.clusters)

    def render(self, gaussians: Gaussians, cameras: Cameras) -> Renders:
        """Render every scene from every camera; the cameras of one scene serve all styles of it."""
        batch = gaussians.means.shape[0]
        if cameras.intrinsics.shape[0] == 1 and batch > 1:
            cameras = cameras.expand(batch)
        return self.renderer(gaussians, cameras)

    def forward(self, views: Views, embedding: StyleEmbedding) -> Gaussians:
        """The single pass: encode, then restyle."""
        return self.restyle(self.encode(views), embedding)


def modules_in_bf16(precision: str, backbone: Backbone, branch: StyleBranch | None = None) -> list[nn.Module]:
    """The modules whose weights a precision keeps in bf16.

    Raises:
        ValueError: There is no such precision.
    """
    if precision not in PRECISIONS:
        raise ValueError(f"precision is {precision!r}; choose from {', '.join(PRECISIONS)}")
    parts: list[nn.Module] = [] if precision == "fp32" else [backbone.embedder, backbone.aggregator]
    if precision == "bf16":
        parts += [backbone.gaussian_head, *([branch] if branch else [])]
    return parts


def _from_one_view(scene: Scene, color: Float[Tensor, "B V H W 3 K"]) -> Float[Tensor, "B V H W 3 K"]:
    """Colours of pixels, where those that are fused are one point."""
    if scene.clusters is None:
        points = scene.geometry.points()
    else:
        points = scene.clusters.means.take_along_dim(scene.clusters.index[..., None], dim=1)
    return from_one_view(color.flatten(4), points.view(*color.shape[:4], 3), scene.cameras).view_as(color)


def _paired(scene: Scene, embedding: StyleEmbedding) -> Scene:
    styles = embedding.vector.shape[0]
    if scene.batch == styles:
        return scene
    if scene.batch != 1:
        raise ValueError(f"{scene.batch} scenes cannot take {styles} styles; give one style a scene, or one scene")
    return scene.expand(styles)
