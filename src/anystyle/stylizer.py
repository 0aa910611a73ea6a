"""The method: Figure 2 of the paper, top to bottom."""

import contextlib
from collections.abc import Iterator, Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.branch import StyleBranch
from anystyle.contracts import Backbone, Renderer, StyleEncoder, neutral_embedding
from anystyle.errors import UserError
from anystyle.types import Cameras, Gaussians, Renders, Scene, StyleEmbedding, Views


class Stylizer(nn.Module):
    """Photographs and a style in, a stylized Gaussian scene out.

    The backbone and the style encoder are frozen; only the style branch is trained.

    Args:
        backbone: The reconstruction network.
        style_encoder: Embeds images and texts in one space.
        branch: Predicts styled attributes.
        renderer: A differentiable rasteriser.

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
    ) -> None:
        super().__init__()
        self.backbone = backbone.freeze()
        self.style_encoder = style_encoder.requires_grad_(False).eval()
        self.branch = branch
        self.renderer = renderer
        self.autocast = False  # for `precision=reference`; see pipeline/load.py

    def train(self, mode: bool = True) -> "Stylizer":
        """Set the mode of the style branch; the frozen parts stay in ``eval``."""
        super().train(mode)
        self.style_encoder.eval()
        return self

    @property
    def device(self) -> torch.device:
        """The device of the parameters."""
        return next(self.parameters()).device

    @contextlib.contextmanager
    def _precision(self, device: torch.device) -> Iterator[None]:
        # Otherwise autocast is left to the caller, such as a training.
        with torch.autocast(device.type, torch.bfloat16) if self.autocast else contextlib.nullcontext():
            yield

    @torch.no_grad()
    def encode(self, views: Views) -> Scene:
        """Compute everything that does not depend on style; once per scene."""
        with self._precision(views.images.device):
            return self.backbone.encode(views)

    @torch.no_grad()
    def embed(
        self, *, text: str | Sequence[str] | None = None, image: Float[Tensor, "B 3 h w"] | None = None
    ) -> StyleEmbedding:
        """Embed styles given as texts or as images; :meth:`StyleEmbedding.toward` interpolates between two.

        Args:
            text: One description, or one a style.
            image: sRGB in [0, 1].

        Raises:
            UserError: Neither is given, or both are.
        """
        if (text is None) == (image is None):
            raise UserError("a style is either a text or an image; mix two embeddings with `toward`")
        if image is not None:
            vector = self.style_encoder.embed_images(image)
        else:
            assert text is not None
            vector = self.style_encoder.embed_texts([text] if isinstance(text, str) else list(text))
        direction = F.normalize(vector - neutral_embedding(self.style_encoder), dim=-1)
        return StyleEmbedding(vector=vector, direction=direction)

    def restyle(self, scene: Scene, embedding: StyleEmbedding) -> Gaussians:
        """Give an encoded scene a style (paper, equations 5 and 6); several styles of one scene are one batch.

        Raises:
            UserError: There are several scenes and not as many styles, or the scene has Gaussians of its own, which
                :class:`anystyle.methods.branch.Branch` colours.
        """
        if scene.gaussians is not None:
            raise UserError("a fitted or given scene takes its style by a method: Branch()(stylizer, scene, ...)")
        scene = _paired(scene, embedding)
        with self._precision(scene.views.images.device):
            styled = self.branch(scene, embedding)
        attributes = scene.attributes.with_(styled, self.branch.styled)
        return self.backbone.adapter(attributes, scene.geometry, scene.clusters)

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


def _paired(scene: Scene, embedding: StyleEmbedding) -> Scene:
    num_styles = embedding.vector.shape[0]
    if scene.batch == num_styles:
        return scene
    if scene.batch != 1:
        raise UserError(f"{scene.batch} scenes cannot take {num_styles} styles; give one style a scene, or one scene")
    return scene.expand(num_styles)
