"""The steps of one scene towards one style."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Loss
from anystyle.geometry.harmonics import constant_from_rgb, rgb_from_constant
from anystyle.methods.contract import Progress
from anystyle.reconstructions.gaussian_parameters import GaussianParameters
from anystyle.reconstructions.loop import Loop
from anystyle.reconstructions.order import canonical_order
from anystyle.stylizer import Stylizer
from anystyle.types import Gaussians, Renders, Scene, Style, StyleEmbedding, Stylization

FLOOR = 1e-6
"""Variances are at least this: a direction without any colour has no scale."""


class ColorMap(NamedTuple):
    """``matrix c + offset`` of colours ``c``.

    Args:
        matrix: Positive square roots of covariances, so that hues turn as little as can be.
        offset: Moves the mean.
    """

    matrix: Float[Tensor, "3 3"]
    offset: Float[Tensor, "3"]

    def __call__(self, colors: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
        """The colours, not cut."""
        return colors @ self.matrix.T + self.offset

    def of_images(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M 3 H W"]:
        """The images, cut to [0, 1]."""
        return self(images.movedim(1, -1)).clamp(0, 1).movedim(-1, 1)


def color_map(content: Float[Tensor, "M 3 H W"], style: Float[Tensor, "1 3 h w"]) -> ColorMap:
    """The map that gives the pixels of all contents together the mean and the covariance of the style's.

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
    """How Gaussians move.

    Args:
        num_steps: Steps of one view each.
        rates: Learning rates at the start, by name of what moves.
        decay: What is left of them at the end.
        split_every: Steps between two splits; 0 for none.
        split_fraction: Of the Gaussians, so many are split each time.
        report_every: Steps between two reports.
        seed: Of the order of views.
    """

    num_steps: int
    rates: Mapping[str, float]
    decay: float
    split_every: int
    split_fraction: float
    report_every: int
    seed: int


class SceneLoop(Loop):
    """An optimisation of one scene that can be stopped and taken up again between any two steps.

    Args:
        stylizer: Renders.
        scene: A batch of one.
        style: A batch of one, its image as large as losses are to see it.
        embedding: Of the style.
        losses: What is minimised, weighted.
        schedule: How.
    """

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
        self._begin(given if stylizer.keep_harmonics else replace(given, harmonics=given.harmonics[:, :, :1]))
        self.unstyled: dict[int, Renders] = {}

    def _begin(self, gaussians: Gaussians) -> None:
        self.before = gaussians.detach()
        self.splats = GaussianParameters(self.before, self.schedule.rates, self.before.scales[0].mean(-1))
        self.gradients = torch.zeros_like(self.splats.units)

    def recolor_before(self) -> None:
        """Give the photographs, and with them the Gaussians, the colours of the style: renders are linear in theirs."""
        assert self.style.image is not None
        mapped = color_map(self.views.images[0], self.style.image)
        self.views = replace(self.views, images=mapped.of_images(self.views.images[0])[None])
        self._begin(with_mapped_colors(self.before, mapped))

    @property
    def last_step(self) -> int:
        """The number of steps."""
        return self.schedule.num_steps

    def advance(self) -> float:
        """Take one step, on one view, and return the loss before it."""
        schedule, view = self.schedule, self.next_view()
        fraction = self.step / schedule.num_steps
        self.splats.set_rates({name: rate * schedule.decay**fraction for name, rate in schedule.rates.items()})
        # Losses that draw crops draw the same ones where a stopped run goes on.
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
        """Nothing is measured beside the loss."""

    def run(self, on_progress: Callable[[Progress], None], on_checkpoint: Callable[[], None] | None) -> None:
        """Take all steps that are left."""

        def tell(pace: float) -> None:
            left = pace * (self.last_step - self.step)
            line = f"step {self.step} of {self.last_step}: loss {self.mean:.4g}, {len(self.splats)} Gaussians"
            done = self.step / self.last_step
            on_progress(Progress(f"{line}, {left:.0f} s left", self.thumbnail(), done))

        self.steps(tell, on_checkpoint)

    @torch.no_grad()
    def thumbnail(self) -> Tensor:
        """The first view as it is now."""
        return self.stylizer.render(self.splats.gaussians(), self.cameras.select([0])).color[0, 0]

    @torch.no_grad()
    def result(self, *, recolored: bool) -> Gaussians:
        """The Gaussians as they are; recoloured so that their renders have the colours of the style."""
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
        """Go on from what :meth:`state_dict` gave."""
        super().load_state_dict(state)
        self.splats.load_state_dict(state["splats"])
        self.gradients, self.before = state["gradients"], Gaussians(**state["before"])


def with_mapped_colors(gaussians: Gaussians, mapped: ColorMap) -> Gaussians:
    """Gaussians whose constant colours are mapped and cut to [0, 1]; what depends on the direction is turned alike."""
    constant, higher = gaussians.harmonics[:, :, :1], gaussians.harmonics[:, :, 1:]
    constant = constant_from_rgb(mapped(rgb_from_constant(constant)).clamp(0, 1))
    return replace(gaussians, harmonics=torch.cat([constant, higher @ mapped.matrix.T], dim=2))
