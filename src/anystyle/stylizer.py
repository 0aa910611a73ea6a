"""The method: Figure 2 of the paper, top to bottom."""

import contextlib
import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Float
from PIL import Image
from torch import Tensor, nn

from anystyle.contracts import Backbone, Renderer, StyleEncoder, StylePredictor, neutral_embedding
from anystyle.errors import UserError
from anystyle.renderers.rasterizer import check
from anystyle.types import Cameras, Gaussians, Renders, Scene, StyleEmbedding, Tokens, Views
from anystyle.types.shapes import check_tensor, check_value


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
        self, *, backbone: Backbone, style_encoder: StyleEncoder, branch: StylePredictor, renderer: Renderer
    ) -> None:
        super().__init__()
        self.backbone = backbone.freeze()
        self.style_encoder = style_encoder.requires_grad_(False).eval()
        self.branch = branch
        self.renderer = renderer
        self.precision = "fp32"  # or one of those of pipeline/load.py, whose weights have been cast

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
        mixed = self.precision == "reference"  # otherwise autocast is left to the caller, such as a training
        before = torch.get_float32_matmul_precision()
        torch.set_float32_matmul_precision("high" if mixed and device.type == "cuda" else before)  # TF32, as published
        try:
            with torch.autocast(device.type, torch.bfloat16) if mixed else contextlib.nullcontext():
                yield
        finally:
            torch.set_float32_matmul_precision(before)

    @torch.no_grad()
    def encode(self, views: Views, *, colors: bool = True) -> Scene:
        """Compute everything that does not depend on style; once per scene.

        Args:
            views: Photographs of a scene, sides multiples of the backbone's patches.
            colors: Whether anything will read the unstyled colours.

        Raises:
            UserError: The images are not in [0, 1], do not fit the backbone's patches, or are not where the model is.
        """
        _expect(views, Views)
        multiple = self.backbone.patch_size
        if any(side % multiple for side in views.size):
            near = [max(1, round(side / multiple)) * multiple for side in views.size]
            raise UserError(
                f"the views are {views.size[0]} pixels high and {views.size[1]} wide, and sides are multiples of "
                f"{multiple} here; resize them, to {near[0]} and {near[1]} for example"
            )
        self._check_images(views.images, "views")
        with self._precision(views.images.device):
            return self.backbone.encode(views, colors=colors)

    @torch.no_grad()
    def embed(
        self,
        *,
        text: str | Sequence[str] | None = None,
        image: Float[Tensor, "B 3 h w"] | str | Path | Image.Image | None = None,
    ) -> StyleEmbedding:
        """Embed styles given as texts or as images; :meth:`StyleEmbedding.toward` interpolates between two.

        Args:
            text: One description, or one per style.
            image: sRGB in [0, 1]; or what :func:`anystyle.read_image` reads.

        Raises:
            UserError: Neither is given, or both are, or the image is of another shape or range.
        """
        if (text is None) == (image is None):
            raise UserError("a style is either a text or an image; mix two embeddings with `toward`")
        if image is not None:
            if isinstance(image, (str, Path, Image.Image)):
                from anystyle.data.images import read_image

                image = read_image(image, masked=True)[None].to(self.device)
            check_tensor(image, Float[Tensor, "B 3 h w"], "the style image")
            self._check_images(image, "style image")
            vector, tokens = self.vectors_and_tokens(image)
        else:
            given = text if isinstance(text, (list, tuple)) else [text]
            texts = [item for item in given if isinstance(item, str)]
            if not texts or len(texts) < len(given):
                raise UserError(f"{text!r:.80} is given; a text or a list of texts is expected")
            vector, tokens = self.style_encoder.embed_texts(texts), None
        direction = F.normalize(vector - neutral_embedding(self.style_encoder), dim=-1)
        return StyleEmbedding(vector=vector, direction=direction, tokens=tokens)

    def vectors_and_tokens(self, image: Float[Tensor, "B 3 h w"]) -> tuple[Float[Tensor, "B D"], Tokens | None]:
        """The embeddings of style images, and their tokens where the style branch reads them."""
        encoder = self.style_encoder
        return encoder.embed_both(image) if self.branch.reads_tokens else (encoder.embed_images(image), None)

    def restyle(self, scene: Scene, embedding: StyleEmbedding) -> Gaussians:
        """Give an encoded scene a style (paper, equations 5 and 6); several styles of one scene are one batch.

        Raises:
            UserError: There are several scenes and not as many styles, the embedding is another encoder's, or the scene
                has Gaussians of its own, which :class:`anystyle.methods.branch.Branch` colours.
        """
        _expect(scene, Scene)
        _expect(embedding, StyleEmbedding)
        self._check_placed(embedding.vector, "embedding")
        number, dim = embedding.vector.shape
        if not number or dim != self.style_encoder.dim:
            raise UserError(
                f"{number} embeddings of {dim} dimensions; this model's styles have {self.style_encoder.dim}; make "
                "them with this stylizer's `embed`"
            )
        if not (self.training or math.isfinite(embedding.vector.detach().abs().amax())):
            raise UserError("the embedding holds numbers that are not finite; make it with `embed`")
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
        _expect(gaussians, Gaussians)
        _expect(cameras, Cameras)
        batch = gaussians.means.shape[0]
        if cameras.intrinsics.shape[0] == 1:
            cameras = cameras.expand(batch)
        check(gaussians, cameras)
        if not self.training:
            _check_cameras(cameras)
        renders, (height, width) = self.renderer(gaussians, cameras), cameras.size
        where = f"the renderer {type(self.renderer).__qualname__}"
        check_value(renders, Renders, where, B=batch, V=cameras.intrinsics.shape[1], H=height, W=width)
        return renders

    def _check_images(self, images: Float[Tensor, "*batch 3 _ _"], what: str) -> None:
        """Refuse images that are empty, not sRGB in [0, 1], or not where the model is."""
        self._check_placed(images, what)
        if not images.numel():
            raise UserError(f"{what} of shape {list(images.shape)}: there are no pixels; give at least one")
        low, high = (value.item() for value in images.detach().aminmax())
        if not (low >= -0.01 and high <= 1.01):
            divide = "; divide by 255" if low >= 0 and 2 < high <= 255 else ""
            raise UserError(f"{what}: values from {low:g} to {high:g}; sRGB in [0, 1] is expected{divide}")

    def _check_placed(self, tensor: Tensor, what: str) -> None:
        """Refuse a tensor on another device than the model, or of another precision than it computes in."""
        own = next(self.parameters())
        if tensor.device != own.device or tensor.layout != torch.strided:
            raise UserError(f"{what}: on {tensor.device}, {tensor.layout}; a dense tensor on {own.device} is expected")
        mixed = self.precision == "reference" or torch.is_autocast_enabled(own.device.type)
        if tensor.dtype not in (torch.float32, own.dtype) and (tensor.dtype == torch.float64 or not mixed):
            raise UserError(f"{what}: {tensor.dtype}; this model computes in {own.dtype}; use .to({own.dtype})")

    def forward(self, views: Views, embedding: StyleEmbedding) -> Gaussians:
        """The single pass: encode, then restyle."""
        return self.restyle(self.encode(views, colors=self.branch.reads_colors), embedding)


def _expect(value: object, cls: type) -> None:
    if not isinstance(value, cls):
        raise UserError(f"a {type(value).__name__} is given; anystyle.types.{cls.__name__} is expected")


def _check_cameras(cameras: Cameras) -> None:
    """Refuse cameras that see nothing."""
    focal = cameras.intrinsics[..., (0, 1), (0, 1)]
    finite = bool(cameras.intrinsics.isfinite().all() & cameras.world_from_camera.isfinite().all())
    if not finite or not bool((focal > 0).all()) or min(cameras.size) < 1:
        raise UserError(
            f"a camera of {cameras.size[0]} x {cameras.size[1]} pixels has a focal length or a side that is not above "
            "0, or numbers that are not finite; intrinsics are in pixels"
        )


def _paired(scene: Scene, embedding: StyleEmbedding) -> Scene:
    num_styles = embedding.vector.shape[0]
    if scene.batch == num_styles:
        return scene
    if scene.batch != 1:
        raise UserError(f"{scene.batch} scenes cannot take {num_styles} styles; give one style per scene, or one scene")
    return scene.expand(num_styles)
