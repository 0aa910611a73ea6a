"""Optimisation steps of one scene for one style."""

import time
from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.utils import get_total_norm

from anystyle.contracts import LinearView, Loss
from anystyle.errors import UserError
from anystyle.geometry.harmonics import constant_from_rgb, rgb_from_constant
from anystyle.losses.features import objective
from anystyle.methods.colors import KEPT
from anystyle.methods.gaussian_parameters import GaussianParameters
from anystyle.stylizer import Stylizer
from anystyle.types import Gaussians, Renders, Scene, Style, StyleEmbedding, Stylization
from anystyle.types.progress import OnProgress, Progress
from anystyle.types.seeds import seeded
from anystyle_methods.order import canonical_order

FLOOR = 1e-6  # least variance, so that the square root of a covariance is invertible


class ColorMap(NamedTuple):
    """``matrix c + offset`` of colours ``c``; the matrix is of symmetric square roots, which change hues least."""

    matrix: Float[Tensor, "3 3"]
    offset: Float[Tensor, "3"]

    def __call__(self, colors: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
        return colors @ self.matrix.T + self.offset

    def of_images(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M 3 H W"]:
        """The mapped images, clipped to [0, 1]."""
        return self(images.movedim(1, -1)).clamp(0, 1).movedim(-1, 1)


def color_map(content: Float[Tensor, "M 3 H W"], style: Float[Tensor, "1 3 h w"]) -> ColorMap:
    """The map that matches mean and covariance of the pixels of all contents together to the style's.

    ``A = S_style^(1/2) S_content^(-1/2)`` and ``b = m_style - A m_content`` with means ``m`` and covariances ``S``.
    """
    (mean, root), (style_mean, style_root) = (_moments(images) for images in (content, style))
    matrix = style_root @ torch.linalg.inv(root)
    return ColorMap(matrix.to(content), (style_mean - matrix @ mean).to(content))


def _moments(images: Tensor) -> tuple[Float[Tensor, "3"], Float[Tensor, "3 3"]]:
    """Mean, and the symmetric square root of the covariance."""
    pixels = images.movedim(1, 0).flatten(1).double()  # 3 S
    values, vectors = torch.linalg.eigh(pixels.cov())
    return pixels.mean(1), vectors @ values.clamp_min(FLOOR).sqrt().diag() @ vectors.T


class SceneLoop:
    """An optimisation of one scene for one style, at the size of its image, by steps on one view each.

    ``rates`` are the initial learning rates by name of :data:`~anystyle.methods.gaussian_parameters.NAMES`, of which
    ``decay`` is left at the end. The seed is that of the order of views and of random crops.
    """

    def __init__(
        self,
        stylizer: Stylizer,
        scene: Scene,
        style: Style,
        embedding: StyleEmbedding,
        losses: Mapping[str, Loss],
        *,
        rates: Mapping[str, float],
        decay: float,
        seed: int,
        keep_harmonics: bool,
    ) -> None:
        self.stylizer, self.scene, self.style, self.embedding = stylizer, scene, style, embedding
        self.losses = {name: loss.train().to(scene.views.images.device) for name, loss in losses.items()}
        self.rates, self.decay = rates, decay
        self.generator = torch.Generator().manual_seed(seed)
        self.order = canonical_order(scene.views.images[0])
        # Selected once, as losses keep the features of a tensor that they have seen.
        self.views = [scene.views.select([view]) for view in range(scene.views.images.shape[1])]
        with torch.no_grad():
            given = stylizer.unstyled(scene)
        self._begin(given if keep_harmonics else replace(given, harmonics=given.harmonics[:, :, :1]))
        self.unstyled: dict[int, Renders] = {}
        # Where nothing but constant colours changes, a view stays the same linear map of them.
        constant = self.before.harmonics.shape[2] == 1 and self.before.means.dtype == torch.float32
        self.only_colors = constant and [*rates] == ["colors"]
        self.linear_views: dict[int, LinearView] = {}

    def _begin(self, gaussians: Gaussians) -> None:
        self.before = gaussians.detach()
        self.splats = GaussianParameters(self.before, self.rates, self.before.scales[0].mean(-1))

    def recolor_before(self) -> None:
        """Match the colours of photographs and Gaussians to the style's; renders are linear in colours."""
        assert self.style.image is not None
        mapped = color_map(self.scene.views.images[0], self.style.image)
        self.views = [replace(view, images=mapped.of_images(view.images[0])[None]) for view in self.views]
        self._begin(with_mapped_colors(self.before, mapped))

    def run(self, num_steps: int, report_every: int, on_progress: OnProgress) -> None:
        """Take all steps; views are shuffled again after every pass."""
        left: list[int] = []
        recent: deque[float] = deque(maxlen=len(self.order))
        started = time.monotonic()
        for step in range(1, num_steps + 1):
            left = left or [self.order[i] for i in torch.randperm(len(self.order), generator=self.generator)]
            recent.append(self._advance(left.pop(), (step - 1) / num_steps))
            if step % report_every == 0 or step == num_steps:
                seconds = (time.monotonic() - started) / step * (num_steps - step)
                line = f"step {step} of {num_steps}: loss {sum(recent) / len(recent):.4g}, {seconds:.0f} s left"
                on_progress(Progress(line, step / num_steps, self.thumbnail()))

    def _advance(self, view: int, fraction: float) -> float:
        """Take one step, when this ``fraction`` of all is done, and return the loss before it."""
        self.splats.adam.rates = {name: rate * self.decay**fraction for name, rate in self.rates.items()}
        with seeded(int(torch.randint(2**31, (), generator=self.generator))), torch.enable_grad():
            loss = self.loss(view)
            loss.backward()
        norm = get_total_norm([value.grad for value in self.splats.parameters.values() if value.grad is not None])
        if not norm.isfinite():  # Adam would make every number NaN, and the loss with them, for all steps that follow
            names = ", ".join(self.losses)
            raise UserError(f"the gradient of {names} is not finite; `anystyle plugins check loss NAME` finds which")
        self.splats.adam.step()
        return float(loss.detach())

    def loss(self, view: int) -> Tensor:
        """The weighted sum of all losses on one view."""
        cameras, gaussians, views = self.scene.cameras.select([view]), self.splats.gaussians(), self.views[view]
        known = self.scene.geometry
        maps = {"depth": known.depth[:, [view]], "confidence": known.confidence[:, [view]]}
        points = None if known.pointmap is None else known.pointmap[:, [view]]
        geometry = replace(known, cameras=cameras, **maps, pointmap=points)
        result = Stylization(
            views=replace(views, cameras=None),
            style=self.style,
            embedding=self.embedding,
            scene=replace(self.scene, views=views, geometry=geometry, gaussians=self.before, clusters=None),
            gaussians=gaussians,
            renders=self._render(gaussians, view),
            unstyled=self._unstyled(view) if any(loss.needs_unstyled for loss in self.losses.values()) else None,
        )
        return objective(self.losses, result)[0]

    def _render(self, gaussians: Gaussians, view: int) -> Renders:
        if view not in self.linear_views and self.only_colors:
            self._keep_linear_view(view)
        if view not in self.linear_views:
            return self.stylizer.render(gaussians, self.scene.cameras.select([view]))
        linear = self.linear_views[view]
        colors = rgb_from_constant(gaussians.harmonics[0, :, 0]).clamp_min(0)
        color = _LinearRender.apply(colors, linear) + linear.background
        return replace(linear.render, color=color.clamp(0, 1)[None, None])

    @torch.no_grad()
    def _keep_linear_view(self, view: int) -> None:
        """Keep a view's map of colours, as far as memory goes."""
        linear = self.stylizer.renderer.linear_view(self.before, self.scene.cameras.select([view]))
        kept = sum(one.nbytes for one in self.linear_views.values())
        if linear is None or kept + linear.nbytes > KEPT:
            self.only_colors = False
        else:
            self.linear_views[view] = linear

    @torch.no_grad()
    def _unstyled(self, view: int) -> Renders:
        if view not in self.unstyled:
            self.unstyled[view] = self.stylizer.render(self.before, self.scene.cameras.select([view]))
        return self.unstyled[view]

    @torch.no_grad()
    def thumbnail(self) -> Tensor:
        """The first view as it is now."""
        return self.stylizer.render(self.splats.gaussians(), self.scene.cameras.select([0])).color[0, 0]

    @torch.no_grad()
    def result(self, *, recolored: bool) -> Gaussians:
        """The current Gaussians; if ``recolored``, with the colours of their renders matched to the style's."""
        gaussians = self.splats.gaussians().detach()
        if not recolored:
            return gaussians
        assert self.style.image is not None
        views = [self.stylizer.render(gaussians, self.scene.cameras.select([view])).color[0] for view in self.order]
        return with_mapped_colors(gaussians, color_map(torch.cat(views), self.style.image))


class _LinearRender(torch.autograd.Function):
    """A linear view of colours, whose gradient is its transpose."""

    @staticmethod
    def forward(ctx: Any, colors: Float[Tensor, "N 3"], view: LinearView) -> Float[Tensor, "3 H W"]:
        ctx.view = view
        return view(colors)

    @staticmethod
    def backward(ctx: Any, *grads: Float[Tensor, "3 H W"]) -> tuple[Float[Tensor, "N 3"], None]:
        return ctx.view.transposed(grads[0]), None


def with_mapped_colors(gaussians: Gaussians, mapped: ColorMap) -> Gaussians:
    """Gaussians with mapped constant colours, clipped to [0, 1]; higher harmonics are mapped by the matrix."""
    constant, higher = gaussians.harmonics[:, :, :1], gaussians.harmonics[:, :, 1:]
    constant = constant_from_rgb(mapped(rgb_from_constant(constant)).clamp(0, 1))
    return replace(gaussians, harmonics=torch.cat([constant, higher @ mapped.matrix.T], dim=2))
