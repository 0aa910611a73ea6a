"""Gaussians fitted to posed photographs through a renderer."""

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import interpolate

from anystyle.contracts import Renderer
from anystyle.geometry.harmonics import constant_from_rgb
from anystyle.reconstructions.exposure import Exposures
from anystyle.reconstructions.gaussian_parameters import NAMES, GaussianParameters
from anystyle.reconstructions.initial import InitialGaussians
from anystyle.reconstructions.loop import Loop
from anystyle.reconstructions.options import FitOptions, FitResult, HeldoutQuality, Progress
from anystyle.reconstructions.photometric import match_colors, photometric_loss, psnr, ssim, unexplained
from anystyle.types import Cameras, Gaussians

logger = logging.getLogger(__name__)


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


class Fit(Loop):
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
        super().__init__(
            [view for view in range(len(images)) if view not in heldout],
            every=options.evaluate_every,
            seed=options.seed,
        )
        self.images, self.cameras, self.renderer, self.options = images, cameras, renderer, options
        self.heldout = heldout
        size = (max(images.shape[-2] // 2, 16), max(images.shape[-1] // 2, 16))
        self.half_images, self.half_cameras = interpolate(images, size=size, mode="area"), cameras.resized(size)
        self.pixels = initial.pixels
        self.splats = GaussianParameters(_gaussians(initial, options), self._rates(), initial.footprints)
        self.behind = background(renderer, self.gaussians(), cameras)
        self.nearest = NEAREST * float((initial.footprints * cameras.intrinsics[0, 0, 0, 0]).median())
        self.exposures = Exposures(cameras, self.training)
        self.exposure_optimizer = torch.optim.Adam([self.exposures.values], lr=options.exposure_lr)
        self.end = options.num_steps
        self.quality: HeldoutQuality | None = None
        self.best, self.stale = float("-inf"), 0

    @property
    def parameters(self) -> dict[str, Tensor]:
        """What is learnt, by name."""
        return self.splats.parameters

    def _rates(self) -> dict[str, float]:
        o = self.options
        rates = (o.means_lr, o.scales_lr, o.rotations_lr, o.opacities_lr, o.colors_lr, o.colors_lr / 20)
        return dict(zip(NAMES, rates, strict=True))

    def gaussians(self) -> Gaussians:
        """The Gaussians as they are, a batch of one scene."""
        return self.splats.gaussians()

    def advance(self) -> float:
        """Take one step, on one view, and return the PSNR before it."""
        fraction = self.step / self.options.num_steps if self.step < self.end else 1.0
        self.splats.set_rates({name: lr * DECAY.get(name, 0.3) ** fraction for name, lr in self._rates().items()})
        view = self.next_view()
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
        self._shrink()
        self.splats.step()
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
        o = self.options
        return o.opacity_weight * self.parameters["opacities"].sigmoid().mean() if o.opacity_weight else 0.0

    @torch.no_grad()
    def _shrink(self) -> None:
        """Add the gradient of the mean scale in footprints, for those Gaussians that the view shows.

        Adam takes whole steps however small a gradient is: what no view shows would shrink to nothing, and leave holes
        where a new view looks past the photographs.
        """
        scales = self.parameters["scales"]
        if self.options.scale_weight and scales.grad is not None:
            shown = (scales.grad != 0).any(1, keepdim=True)
            footprints = scales.exp() / self.splats.units[:, None]
            scales.grad += self.options.scale_weight * footprints * shown / (3 * shown.sum().clamp_min(1))

    @torch.no_grad()
    def _prune(self) -> None:
        p = self.parameters
        largest = p["scales"].amax(1).exp()
        distance = torch.cdist(self.gaussians().means[0], self.cameras.world_from_camera[0, :, :3, 3]).amin(1)
        dead = (p["opacities"].sigmoid() < MIN_OPACITY) | (largest > MAX_FOOTPRINTS * self.splats.units)
        dead |= distance < self.nearest
        keep = (~dead).nonzero()[:, 0]
        if len(keep) < len(dead):
            self.splats.select(keep)
            self.pixels = self.pixels[keep]

    def run(
        self, on_progress: Callable[[Progress], None] | None = None, on_checkpoint: Callable[[], None] | None = None
    ) -> FitResult:
        """Take steps until nothing is gained, or the last; then those of the end, on all views.

        Args:
            on_progress: Called after every evaluation.
            on_checkpoint: Called where the state is worth being written: after it.
        """
        self.steps(lambda pace: on_progress and on_progress(self.progress(pace)), on_checkpoint)
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
            train_psnr=self.mean,
            heldout_psnr=self.quality and self.quality.psnr,
            num_gaussians=len(self.splats),
            seconds_left=pace * (self.last_step - self.step),
        )

    def at_turn(self) -> bool:
        """Views that were held out come in at the end of the first steps."""
        return self.step == self.end

    def look(self) -> None:
        """Measure views held out, and end where nothing is gained; not in the final steps, which see all views."""
        if self.step > self.end:
            return
        self.quality = self.heldout_quality()
        reached = self.mean if self.quality is None else self.quality.psnr
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
            train_psnr=self.mean,
            heldout=self.quality,
            unexplained=self._unexplained(),
        )

    def _unexplained(self) -> float:
        shares = [unexplained(self.render(view), self.images[view, None]) for view in self.training]
        return float(torch.cat(shares).median())

    def state_dict(self) -> dict[str, Any]:
        """All that a fit of the same photographs and options needs to go on; ``torch.save`` can write it."""
        return super().state_dict() | {
            "pixels": self.pixels,
            "splats": self.splats.state_dict(),
            "exposures": self.exposures.values.detach(),
            "exposure_optimizer": self.exposure_optimizer.state_dict(),
            "end": self.end,
            "quality": self.quality and tuple(self.quality),
            "best": self.best,
            "stale": self.stale,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from what :meth:`state_dict` gave."""
        super().load_state_dict(state)
        self.pixels = state["pixels"]
        self.splats.load_state_dict(state["splats"])
        with torch.no_grad():
            self.exposures.values.copy_(state["exposures"])
        self.exposure_optimizer.load_state_dict(state["exposure_optimizer"])
        self.exposures.train(self.training)
        self.end = state["end"]
        self.quality = state["quality"] and HeldoutQuality(*state["quality"])
        self.best, self.stale = state["best"], state["stale"]

    @torch.no_grad()
    def render(self, view: int) -> Float[Tensor, "1 3 H W"]:
        """One view as its photograph would be exposed, cut to [0, 1]."""
        color = self.renderer(self.gaussians(), self.cameras.select([view])).color[0]
        return self.exposures.apply(color, view).clamp(0, 1)


def _gaussians(initial: InitialGaussians, options: FitOptions) -> Gaussians:
    """Round Gaussians at the initial centres, of one opacity."""
    count, like = len(initial.means), initial.means
    colors = constant_from_rgb(initial.colors)[:, None]
    return Gaussians(
        means=like[None],
        rotations=torch.tensor([1.0, 0.0, 0.0, 0.0]).to(like).repeat(1, count, 1),
        scales=initial.scales[None, :, None].repeat(1, 1, 3),
        opacities=like.new_full((1, count), options.opacity),
        harmonics=torch.cat([colors, like.new_zeros(count, (options.degree + 1) ** 2 - 1, 3)], dim=1)[None],
    )
