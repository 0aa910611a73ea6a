"""Gaussians fitted to posed photographs through a renderer."""

import logging
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import interpolate

from anystyle.contracts import Renderer
from anystyle.geometry.harmonics import constant_from_rgb
from anystyle.reconstructions.exposure import Exposures
from anystyle.reconstructions.initial import InitialGaussians
from anystyle.reconstructions.options import FitOptions, FitResult, HeldoutQuality, Progress
from anystyle.reconstructions.photometric import match_colors, photometric_loss, psnr, ssim, unexplained
from anystyle.types import Cameras, Gaussians

logger = logging.getLogger(__name__)


PARAMETERS = ("offsets", "scales", "rotations", "opacities", "colors", "harmonics")
DECAY = {"offsets": 0.05, "scales": 0.2, "opacities": 0.2}
"""What is left of a learning rate at the end; of the others 0.3."""

MIN_OPACITY, MAX_FOOTPRINTS = 0.02, 60.0
"""A Gaussian is removed under this opacity, or over this scale in footprints."""

NEAREST = 0.03
"""A Gaussian is a floater nearer to a camera than this share of the median depth."""

MIN_GAIN = 0.03
"""A rise of PSNR in dB that counts as a gain."""


@torch.no_grad()
def background(renderer: Renderer, gaussians: Gaussians, cameras: Cameras) -> Float[Tensor, "3 1 1"]:
    """The colour that a renderer shows where there is nothing."""
    nothing = replace(gaussians, opacities=torch.zeros_like(gaussians.opacities)).map(lambda tensor: tensor[:, :1])
    return renderer(nothing, cameras.select([0])).color[0, 0].mean((1, 2))[:, None, None]


class Fit:
    """A fit that can be stopped and taken up again between any two steps.

    Args:
        images: sRGB in [0, 1].
        cameras: Of one scene, for images of this size.
        initial: What to begin with.
        renderer: Differentiable, on the device of the images; with any background.
        options: How to fit.
        heldout: Views that no step sees.
    """

    def __init__(
        self,
        images: Float[Tensor, "V 3 H W"],
        cameras: Cameras,
        initial: InitialGaussians,
        renderer: Renderer,
        options: FitOptions,
        *,
        heldout: tuple[int, ...] = (),
    ) -> None:
        self.images, self.cameras, self.renderer, self.options = images, cameras, renderer, options
        self.heldout = heldout
        self.training = [view for view in range(len(images)) if view not in heldout]
        size = (max(images.shape[-2] // 2, 16), max(images.shape[-1] // 2, 16))
        self.half_images, self.half_cameras = interpolate(images, size=size, mode="area"), cameras.resized(size)
        self.anchors, self.footprints, self.pixels = initial.means, initial.footprints, initial.pixels
        self.parameters = self._parameters(initial)
        self.behind = background(renderer, self.gaussians(), cameras)
        self.nearest = NEAREST * float((self.footprints * cameras.intrinsics[0, 0, 0, 0]).median())
        self.exposures = Exposures(cameras, self.training)
        rates = self._rates()
        groups = [{"params": [self.parameters[name]], "name": name, "lr": rates[name]} for name in PARAMETERS]
        self.optimizer = torch.optim.Adam(groups, betas=(0.9, 0.99), eps=1e-15, fused=True)
        self.exposure_optimizer = torch.optim.Adam([self.exposures.values], lr=options.exposure_lr)
        self.generator = torch.Generator().manual_seed(options.seed)
        self.step = 0
        self.order: list[int] = []
        self.recent: list[float] = []
        self.end = options.num_steps
        self.quality: HeldoutQuality | None = None
        self.best, self.stale = float("-inf"), 0

    def _parameters(self, initial: InitialGaussians) -> dict[str, Tensor]:
        n = len(initial.means)
        opacity = torch.full((n,), self.options.opacity)
        values = {
            "offsets": torch.zeros(n, 3),
            "scales": initial.scales.log()[:, None].repeat(1, 3),
            "rotations": torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(n, 1),
            "opacities": opacity.logit(),
            "colors": constant_from_rgb(initial.colors)[:, None],
            "harmonics": torch.zeros(n, (self.options.degree + 1) ** 2 - 1, 3),
        }
        return {name: value.to(initial.means.device).requires_grad_() for name, value in values.items()}

    def _rates(self) -> dict[str, float]:
        o = self.options
        rates = (o.means_lr, o.scales_lr, o.rotations_lr, o.opacities_lr, o.colors_lr, o.colors_lr / 20)
        return dict(zip(PARAMETERS, rates, strict=True))

    def gaussians(self) -> Gaussians:
        """The Gaussians as they are, a batch of one scene."""
        p = self.parameters
        return Gaussians(
            means=(self.anchors + self.footprints[:, None] * p["offsets"])[None],
            rotations=p["rotations"][None],
            scales=p["scales"].exp()[None],
            opacities=p["opacities"].sigmoid()[None],
            harmonics=torch.cat([p["colors"], p["harmonics"]], dim=1)[None],
        )

    def advance(self) -> float:
        """Take one step, on one view, and return the PSNR before it."""
        fraction = self.step / self.options.num_steps if self.step < self.end else 1.0
        rates = self._rates()
        for group in self.optimizer.param_groups:
            group["lr"] = rates[group["name"]] * DECAY.get(group["name"], 0.3) ** fraction
        if not self.order:
            self.order = [self.training[i] for i in torch.randperm(len(self.training), generator=self.generator)]
        view = self.order.pop()
        coarse = fraction < self.options.half_resolution
        images, cameras = (self.half_images, self.half_cameras) if coarse else (self.images, self.cameras)
        target = images[view, None]
        renders = self.renderer(self.gaussians(), cameras.select([view]))
        passing = 1 - renders.alpha[0, :, None]
        color = self.exposures.apply(renders.color[0] - passing * self.behind, view)
        random = torch.rand(3, generator=self.generator).to(color)[:, None, None]
        color = color + passing * (random if self.options.random_background else self.behind)
        loss = photometric_loss(color, target, dssim=self.options.dssim) + self._penalty()
        loss.backward()
        self.optimizer.step()
        self.optimizer.zero_grad(set_to_none=True)
        if self.options.exposure_lr:
            self.exposure_optimizer.param_groups[0]["lr"] = self.options.exposure_lr * 0.1**fraction
            self.exposure_optimizer.step()
            self.exposure_optimizer.zero_grad(set_to_none=True)
            self.exposures.center()
        self.step += 1
        every = self.options.prune_every
        if every and self.step % every == 0 and fraction < 0.8:
            self._prune()
        return float(psnr(color.detach(), target))

    def _penalty(self) -> Tensor | float:
        o, p = self.options, self.parameters
        loss = o.opacity_weight * p["opacities"].sigmoid().mean() if o.opacity_weight else 0.0
        if o.scale_weight:
            loss = loss + o.scale_weight * (p["scales"].exp() / self.footprints[:, None]).mean()
        return loss

    @torch.no_grad()
    def _prune(self) -> None:
        p = self.parameters
        largest = p["scales"].amax(1).exp()
        distance = torch.cdist(self.gaussians().means[0], self.cameras.world_from_camera[0, :, :3, 3]).amin(1)
        dead = (p["opacities"].sigmoid() < MIN_OPACITY) | (largest > MAX_FOOTPRINTS * self.footprints)
        dead |= distance < self.nearest
        keep = (~dead).nonzero()[:, 0]
        if len(keep) < len(dead):
            self._select(keep)

    def _select(self, index: Int[Tensor, " n"]) -> None:
        """Keep some of the Gaussians, and their part of the optimiser's state."""
        self.anchors, self.footprints = self.anchors[index], self.footprints[index]
        self.pixels = self.pixels[index]
        for group in self.optimizer.param_groups:
            old = group["params"][0]
            new = old.detach()[index].requires_grad_()
            state = self.optimizer.state.pop(old, {})
            self.optimizer.state[new] = {
                key: value[index] if value.shape == old.shape else value for key, value in state.items()
            }
            group["params"][0] = self.parameters[group["name"]] = new

    def run(
        self, on_progress: Callable[[Progress], None] | None = None, on_checkpoint: Callable[[], None] | None = None
    ) -> FitResult:
        """Take steps until nothing is gained, or the last; then those of the end, on all views.

        Args:
            on_progress: Called after every evaluation.
            on_checkpoint: Called where the state is worth being written: after it.
        """
        started, first = time.monotonic(), self.step
        while self.step < self.last_step:
            self.recent = [*self.recent[1 - len(self.training) :], self.advance()]
            if self.step % self.options.evaluate_every and self.step not in (self.end, self.last_step):
                continue
            if self.step <= self.end:
                self._evaluate()
            pace = (time.monotonic() - started) / (self.step - first)
            if on_progress is not None:
                on_progress(self.progress(pace))
            if on_checkpoint is not None:
                on_checkpoint()
        return self.result()

    @property
    def last_step(self) -> int:
        """Where the fit ends, as far as is known."""
        return self.end + (self.options.final_steps if self.heldout else 0)

    def progress(self, pace: float) -> Progress:
        """Where the fit is, at so many seconds a step."""
        return Progress(
            step=self.step,
            num_steps=self.last_step,
            train_psnr=sum(self.recent) / max(len(self.recent), 1),
            heldout_psnr=self.quality and self.quality.psnr,
            num_gaussians=len(self.anchors),
            seconds_left=pace * (self.last_step - self.step),
        )

    def _evaluate(self) -> None:
        self.quality = self.heldout_quality()
        reached = sum(self.recent) / len(self.recent) if self.quality is None else self.quality.psnr
        self.stale = 0 if reached > self.best + MIN_GAIN else self.stale + 1
        self.best = max(self.best, reached)
        if self.options.patience and self.stale >= self.options.patience:
            logger.info("nothing was gained in %d evaluations: the fit ends at step %d", self.stale, self.step)
            self.end = self.step
        if self.step == self.end and self.options.final_steps:
            self._include_heldout()

    def _include_heldout(self) -> None:
        """From now on steps see all views; those held out begin with the exposure of the views beside them."""
        with torch.no_grad():
            for view in self.heldout:
                self.exposures.values[view] = self.exposures.of(view)
        self.training = list(range(len(self.images)))
        self.exposures.train(self.training)
        self.order = []

    def heldout_quality(self) -> HeldoutQuality | None:
        """How the views held out are rendered, if there are any."""
        if not self.heldout:
            return None
        renders, photographs = torch.cat([self.render(view) for view in self.heldout]), self.images[list(self.heldout)]
        matched = torch.stack([match_colors(*pair) for pair in zip(renders, photographs, strict=True)])
        return HeldoutQuality(
            psnr=float(psnr(renders, photographs).mean()),
            ssim=float(ssim(renders, photographs).mean()),
            matched_psnr=float(psnr(matched, photographs).mean()),
        )

    def result(self) -> FitResult:
        """What is fitted so far."""
        exposures = torch.stack([self.exposures.of(view) for view in range(len(self.images))]).detach()
        return FitResult(
            gaussians=self.gaussians().detach(),
            pixels=self.pixels,
            gains=1 + exposures[:, :3],
            biases=exposures[:, 3:],
            steps=self.step,
            train_psnr=sum(self.recent) / max(len(self.recent), 1),
            heldout=self.quality,
            unexplained=self._unexplained(),
        )

    def _unexplained(self) -> float:
        shares = [unexplained(self.render(view), self.images[view, None]) for view in self.training]
        return float(torch.cat(shares).median())

    def state_dict(self) -> dict[str, Any]:
        """All that a fit of the same photographs and options needs to go on; ``torch.save`` can write it."""
        return {
            "anchors": self.anchors,
            "footprints": self.footprints,
            "pixels": self.pixels,
            "parameters": {name: value.detach() for name, value in self.parameters.items()},
            "optimizer": self.optimizer.state_dict(),
            "exposures": self.exposures.values.detach(),
            "exposure_optimizer": self.exposure_optimizer.state_dict(),
            "generator": self.generator.get_state(),
            "step": self.step,
            "training": self.training,
            "order": self.order,
            "recent": self.recent,
            "end": self.end,
            "quality": self.quality and tuple(self.quality),
            "best": self.best,
            "stale": self.stale,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from what :meth:`state_dict` gave."""
        self.anchors, self.footprints, self.pixels = (state[name] for name in ("anchors", "footprints", "pixels"))
        for group in self.optimizer.param_groups:
            value = state["parameters"][group["name"]].clone().requires_grad_()
            group["params"][0] = self.parameters[group["name"]] = value
        self.optimizer.load_state_dict(state["optimizer"])
        with torch.no_grad():
            self.exposures.values.copy_(state["exposures"])
        self.exposure_optimizer.load_state_dict(state["exposure_optimizer"])
        self.training = list(state["training"])
        self.exposures.train(self.training)
        self.generator.set_state(state["generator"])
        self.step, self.order, self.recent = state["step"], list(state["order"]), list(state["recent"])
        self.end = state["end"]
        self.quality = state["quality"] and HeldoutQuality(*state["quality"])
        self.best, self.stale = state["best"], state["stale"]

    @torch.no_grad()
    def render(self, view: int) -> Float[Tensor, "1 3 H W"]:
        """One view as its photograph would be exposed, cut to [0, 1]."""
        color = self.renderer(self.gaussians(), self.cameras.select([view])).color[0]
        return self.exposures.apply(color, view).clamp(0, 1)
