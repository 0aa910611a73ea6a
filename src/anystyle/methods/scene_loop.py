"""Optimisation steps of one scene for one style."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Loss
from anystyle.geometry.harmonics import constant_from_rgb, rgb_from_constant
from anystyle.methods.gaussian_parameters import GaussianParameters
from anystyle.methods.loop import Loop
from anystyle.methods.order import canonical_order
from anystyle.stylizer import Stylizer
from anystyle.types import Gaussians, Renders, Scene, Style, StyleEmbedding, Stylization
from anystyle.types.progress import OnProgress, Progress

FLOOR = 1e-6
"""Least variance, so that the square root of a covariance is invertible."""


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


@dataclass(frozen=True)
class Schedule:
    """Steps and initial learning rates of an optimisation; the rest is as :class:`Optimize` describes it."""

    num_steps: int
    rates: Mapping[str, float]
    decay: float
    split_every: int
    split_fraction: float
    report_every: int
    seed: int
    keep_harmonics: bool


class SceneLoop(Loop):
    """An optimisation of one scene for one style, at the size of its image; can be resumed between any two steps."""

    def __init__(
        self,
        stylizer: Stylizer,
        scene: Scene,
        style: Style,
        embedding: StyleEmbedding,
        losses: Mapping[str, Loss],
        schedule: Schedule,
    ) -> None:
        super().__init__(canonical_order(scene.views.images[0]), every=schedule.report_every, seed=schedule.seed)
        self.stylizer, self.scene, self.style, self.embedding = stylizer, scene, style, embedding
        self.losses, self.schedule = {name: loss.train() for name, loss in losses.items()}, schedule
        for loss in losses.values():
            loss.to(scene.views.images.device)
        self.views, self.cameras = scene.views, scene.cameras
        with torch.no_grad():
            given = stylizer.unstyled(scene)
        self._begin(given if schedule.keep_harmonics else replace(given, harmonics=given.harmonics[:, :, :1]))
        self.unstyled: dict[int, Renders] = {}

    def _begin(self, gaussians: Gaussians) -> None:
        self.before = gaussians.detach()
        self.splats = GaussianParameters(self.before, self.schedule.rates, self.before.scales[0].mean(-1))
        self.gradients = torch.zeros_like(self.splats.units)

    def recolor_before(self) -> None:
        """Match the colours of photographs and Gaussians to the style's; renders are linear in colours."""
        assert self.style.image is not None
        mapped = color_map(self.views.images[0], self.style.image)
        self.views = replace(self.views, images=mapped.of_images(self.views.images[0])[None])
        self._begin(with_mapped_colors(self.before, mapped))

    @property
    def last_step(self) -> int:
        return self.schedule.num_steps

    def advance(self) -> float:
        schedule, view = self.schedule, self.next_view()
        fraction = self.step / schedule.num_steps
        self.splats.set_rates({name: rate * schedule.decay**fraction for name, rate in schedule.rates.items()})
        # A resumed run must draw the same random crops.
        with torch.random.fork_rng(devices=[]), torch.enable_grad():
            torch.manual_seed(int(torch.randint(2**31, (), generator=self.generator)))
            loss = self.loss(view)
            loss.backward()
        if "colors" in self.splats.parameters and schedule.split_every:
            gradient = self.splats.parameters["colors"].grad
            assert gradient is not None
            self.gradients += gradient.flatten(1).norm(dim=1)
        self.splats.step()
        self.step += 1
        if schedule.split_every and self.step % schedule.split_every == 0 and self.step < schedule.num_steps:
            self._split()
        return float(loss.detach())

    def loss(self, view: int) -> Tensor:
        """The weighted sum of all losses on one view."""
        cameras, gaussians = self.cameras.select([view]), self.splats.gaussians()
        geometry = replace(
            self.scene.geometry,
            cameras=cameras,
            depth=self.scene.geometry.depth[:, [view]],
            confidence=self.scene.geometry.confidence[:, [view]],
        )
        views = self.views.select([view])
        result = Stylization(
            views=replace(views, cameras=None),
            style=self.style,
            embedding=self.embedding,
            scene=replace(self.scene, views=views, geometry=geometry, gaussians=self.before, clusters=None),
            gaussians=gaussians,
            renders=self.stylizer.render(gaussians, cameras),
            unstyled=self._unstyled(view) if any(loss.needs_unstyled for loss in self.losses.values()) else None,
        )
        return torch.stack([loss.weight * loss(result) for loss in self.losses.values()]).sum()

    @torch.no_grad()
    def _unstyled(self, view: int) -> Renders:
        if view not in self.unstyled:
            self.unstyled[view] = self.stylizer.render(self.before, self.cameras.select([view]))
        return self.unstyled[view]

    def _split(self) -> None:
        count = round(self.schedule.split_fraction * len(self.splats))
        index = self.splats.split(self.gradients.topk(count).indices)
        self.before = self.before.map(lambda tensor: tensor[:, index])
        self.gradients = torch.zeros_like(self.splats.units)

    def look(self) -> None:
        pass

    def run(self, on_progress: OnProgress, on_checkpoint: Callable[[], None] | None) -> None:
        """Take all remaining steps."""

        def report(pace: float) -> None:
            left = pace * (self.last_step - self.step)
            line = f"step {self.step} of {self.last_step}: loss {self.mean:.4g}, {len(self.splats)} Gaussians"
            on_progress(Progress(f"{line}, {left:.0f} s left", self.step / self.last_step, self.thumbnail()))

        self.steps(report, on_checkpoint)

    @torch.no_grad()
    def thumbnail(self) -> Tensor:
        """The first view as it is now."""
        return self.stylizer.render(self.splats.gaussians(), self.cameras.select([0])).color[0, 0]

    @torch.no_grad()
    def result(self, *, recolored: bool) -> Gaussians:
        """The current Gaussians; if ``recolored``, with the colours of their renders matched to the style's."""
        gaussians = self.splats.gaussians().detach()
        if not recolored:
            return gaussians
        assert self.style.image is not None
        views = [self.stylizer.render(gaussians, self.cameras.select([view])).color[0] for view in self.training]
        mapped = color_map(torch.cat(views), self.style.image)
        return with_mapped_colors(gaussians, mapped)

    def state_dict(self) -> dict[str, Any]:
        before = {name: getattr(self.before, name) for name in self.before.__dataclass_fields__}
        return super().state_dict() | {
            "splats": self.splats.state_dict(), "gradients": self.gradients, "before": before
        }  # fmt: skip

    def load_state_dict(self, state: dict[str, Any]) -> None:
        super().load_state_dict(state)
        self.splats.load_state_dict(state["splats"])
        self.gradients, self.before = state["gradients"], Gaussians(**state["before"])


def with_mapped_colors(gaussians: Gaussians, mapped: ColorMap) -> Gaussians:
    """Gaussians with mapped constant colours, clipped to [0, 1]; higher harmonics are mapped by the matrix."""
    constant, higher = gaussians.harmonics[:, :, :1], gaussians.harmonics[:, :, 1:]
    constant = constant_from_rgb(mapped(rgb_from_constant(constant)).clamp(0, 1))
    return replace(gaussians, harmonics=torch.cat([constant, higher @ mapped.matrix.T], dim=2))
