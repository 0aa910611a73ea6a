"""The optimisation of Gaussians through a renderer, towards posed photographs."""

import logging
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import interpolate

from anystyle.contracts import Renderer
from anystyle.errors import UserError
from anystyle.methods.adam import Adam
from anystyle.methods.gaussian_parameters import GaussianParameters
from anystyle.types import Cameras, Gaussians, OnProgress, Progress, no_progress
from anystyle_captures.free_space import FreeSpace
from anystyle_captures.initial import InitialGaussians, lift
from anystyle_captures.masks import Masks
from anystyle_captures.photometric import Quality, photometric_loss, psnr, quality_of, unexplained
from anystyle_captures.start import GivenGaussians

logger = logging.getLogger(__name__)
RATES = {
    "offsets": 0.06,  # of centres, in footprints of a pixel
    "scales": 0.06,  # of log scales
    "rotations": 0.0075,  # of quaternions
    "opacities": 0.075,  # of logits
    "colors": 0.03,  # of constant harmonics
    "harmonics": 0.0015,  # of the others
}
"""The learning rates. They do not fall: the scene is the mean of the last steps instead (Polyak and Juditsky 1992)."""
VISITS = 4
"""How often a pass of the final steps sees each view that was held out; the others once."""
SHOWN = 0.5
"""Opacity of a pixel above which the scene has a depth there."""
DSSIM = 0.2
"""Weight of 1 - SSIM beside L1, as in 3D Gaussian splatting."""
MIN_OPACITY, MAX_FOOTPRINTS, NEAREST = 0.02, 60.0, 0.03
"""A Gaussian is removed below this opacity, above this scale in footprints, or nearer to a camera than this fraction of
the median depth."""
MAX_OPACITY = 0.999
"""The largest opacity of the Gaussians that stand in for those left out."""
PRUNE_EVERY = 200
"""Steps between removals of Gaussians."""
NEAREST_EXPOSURES = 2
"""A held-out view takes the exposure of this many nearest training views."""


class InitialScene(NamedTuple):
    """What a fit begins with."""

    gaussians: InitialGaussians | GivenGaussians
    free_space: FreeSpace | None = None
    confirmed: float = 0.0  # fraction of the pixels whose depth by stereo another view confirms


@dataclass(frozen=True)
class FitOptions:
    """How Gaussians are fitted."""

    num_steps: int = 1000  # of one view each
    half_resolution: float = 0.6  # fraction of the steps that is taken at half the resolution
    dropout: float = 0.1  # fraction of the Gaussians that a step leaves out, as DropGaussian (Park et al. 2025)
    averaged: float = 0.2  # the fraction of the steps, and again of the final ones, that the scene is the mean of
    rate: float = 1.0  # factor on the learning rates of Gaussians and exposures
    degree: int = 0  # of the spherical harmonics
    exposure_lr: float = 0.003  # falls to a tenth; 0 disables exposure
    scale_weight: float = 0.0  # of the mean scale in footprints: only small Gaussians leave room for a style's strokes
    evaluate_every: int = 200
    final_steps: int = 0  # on all views, if some are held out; the reported quality precedes them
    seed: int = 0


@dataclass(frozen=True)
class FitResult:
    """A fitted scene."""

    gaussians: Gaussians
    gains: Float[Tensor, "V 3"]  # photographs are gain * render + bias
    biases: Float[Tensor, "V 3"]
    steps: int
    train_psnr: float  # dB, with each view's exposure
    unexplained: Float[Tensor, " V"]  # see :func:`unexplained`; NaN of photographs that it was not fitted to
    heldout: Quality | None  # before the final steps
    world_from_camera: Float[Tensor, "V 4 4"]  # as refined
    intrinsics: Float[Tensor, "V 3 3"]
    dropout: float
    cached: bool = False

    def cameras(self, size: tuple[int, int]) -> Cameras:
        """The cameras of all views, as refined, for images of a size."""
        return Cameras(self.world_from_camera[None], self.intrinsics[None], size)

    @torch.no_grad()
    def photographed(
        self, renderer: Renderer, cameras: Cameras, views: Sequence[int], *, masked: bool
    ) -> Float[Tensor, "M 3 H W"]:
        """Some views with the exposures of their photographs, clamped to [0, 1]; over white where there are masks."""
        behind, shown = background(renderer, self.gaussians, cameras), []
        for view in views:
            renders = renderer(self.gaussians, cameras.select([view]))
            gain, bias = self.gains[view, :, None, None], self.biases[view, :, None, None]
            alpha = renders.alpha[0, :, None] if masked else 1.0
            shown.append((renders.color[0] - (1 - alpha) * behind) * gain + bias * alpha + 1 - alpha)
        return torch.cat(shown).clamp(0, 1)

    def as_dict(self) -> dict[str, Any]:
        """Tensors and plain values that :meth:`from_dict` takes."""
        return {**vars(self), "gaussians": vars(self.gaussians), "heldout": self.heldout and tuple(self.heldout)}

    @classmethod
    def from_dict(cls, values: dict[str, Any], device: torch.device) -> "FitResult":
        """The result of :meth:`as_dict`, on a device."""
        tensors = {name: value.to(device) for name, value in values.items() if isinstance(value, Tensor)}
        gaussians = Gaussians(**values["gaussians"]).to(device)
        heldout = values["heldout"] and Quality(*values["heldout"])
        return cls(**{**values, **tensors, "gaussians": gaussians, "heldout": heldout})


class Exposures:
    """Gains and biases from renders to photographs, whose mean over the training views is the identity."""

    def __init__(self, cameras: Cameras, training: list[int]) -> None:
        self.centers = cameras.world_from_camera[0, :, :3, 3]
        values = torch.zeros(len(self.centers), 6, device=self.centers.device).requires_grad_()
        self.adam = Adam({"values": values}, {"values": 0.0})
        self.train(training)

    def train(self, training: list[int]) -> None:
        """Set the views whose exposure is learnt; the others take that of the nearest ones, by inverse distance."""
        # In double precision: products of matrices, which it takes, lose distances far from the origin, as on a map.
        distance = torch.cdist(self.centers.double(), self.centers[training].double()).float()  # V T
        nearest = distance.topk(min(NEAREST_EXPOSURES, len(training)), largest=False)
        weight = 1 / nearest.values.clamp_min(1e-9)
        blend = torch.zeros_like(distance).scatter(1, nearest.indices, weight / weight.sum(1, keepdim=True))
        blend[training] = torch.eye(len(training)).to(blend)
        self.training, self.blend = training, blend

    @property
    def values(self) -> Float[Tensor, "V 6"]:
        """Gain - 1 and bias of each view; those of views that are not trained stay zero."""
        return self.adam.parameters["values"]

    def of(self, view: int) -> Float[Tensor, " 6"]:
        """Gain - 1 and bias of a view."""
        return self.blend[view] @ self.values[self.training]

    def apply(
        self, images: Float[Tensor, "M 3 H W"], view: int, alpha: Float[Tensor, "M 1 H W"] | float = 1.0
    ) -> Float[Tensor, "M 3 H W"]:
        """Renders, which are multiplied by ``alpha``, with the exposure of a view."""
        gain, bias = self.of(view)[:, None, None].split(3)
        return images * (1 + gain) + bias * alpha

    @torch.no_grad()
    def center(self) -> None:
        """Subtract the mean over the training views, which the Gaussians can represent."""
        self.values[self.training] -= self.values[self.training].mean(0)


class FitLoop:
    """A fit, one view per step, which can be interrupted and resumed between any two steps."""

    def __init__(
        self,
        images: Float[Tensor, "V 3 H W"],
        cameras: Cameras,
        start: InitialScene,
        renderer: Renderer,
        options: FitOptions,
        *,
        heldout: tuple[int, ...] = (),
        masks: Masks | None = None,
    ) -> None:
        self.masks = masks
        # Photographs of which masks leave nothing teach nothing.
        self.useful = [view for view in range(len(images)) if masks is None or bool(masks.measured[view].any())]
        self.training = [view for view in self.useful if view not in heldout]
        self.generator = torch.Generator().manual_seed(options.seed)
        self.step = 0
        self.quality: Quality | None = None
        self.order, self.sums = list[int](), dict[str, Tensor]()  # views that are left of a pass; of parameters
        self.images, self.cameras, self.renderer, self.options = images, cameras, renderer, options
        self.heldout = [view for view in heldout if view in self.useful]
        self.half_size = (max(images.shape[-2] // 2, 16), max(images.shape[-1] // 2, 16))
        self.half_images = interpolate(images, size=self.half_size, mode="area")
        self.half_masks = None if masks is None else masks.resized(self.half_size)
        self.free_space = start.free_space
        depth = float((start.gaussians.footprints * cameras.intrinsics[0, 0, 0, 0]).median())
        self.nearest = NEAREST * depth
        self.splats = self._parameters(start.gaussians.gaussians(options.degree), start.gaussians.footprints)
        self._carve()
        self.background = background(renderer, self.gaussians(), cameras)
        self.exposures = Exposures(cameras, self.training)

    def gaussians(self) -> Gaussians:
        """The current Gaussians, a batch of one scene."""
        return self.splats.gaussians()

    def _parameters(self, gaussians: Gaussians, footprints: Float[Tensor, " N"]) -> GaussianParameters:
        rates = {name: self.options.rate * rate for name, rate in RATES.items()}
        return GaussianParameters(gaussians, rates, footprints)

    def advance(self) -> None:
        """Take one step, on one view."""
        options = self.options
        final = self.step >= options.num_steps
        done, stage = (self.step - options.num_steps, options.final_steps) if final else (self.step, options.num_steps)
        fraction = (1 + done / stage) / 2 if final else done / stage
        if not self.order:
            views = self.training + (VISITS - 1) * (self.heldout if final else [])
            self.order = [views[i] for i in torch.randperm(len(views), generator=self.generator).tolist()]
        view = self.order.pop()
        coarse = self.step < options.half_resolution * options.num_steps
        images, masks = (self.half_images, self.half_masks) if coarse else (self.images, self.masks)
        cameras = self.cameras.select([view]).resized((images.shape[-2], images.shape[-1]))
        target, gaussians = images[view, None], self.gaussians()
        kept = torch.rand(len(self.splats), generator=self.generator).to(images) >= options.dropout
        opacities = (gaussians.opacities * kept / (1 - options.dropout)).clamp_max(MAX_OPACITY)
        renders = self.renderer(replace(gaussians, opacities=opacities), cameras)
        # Over random colours, so that no Gaussian lets the background through where there is something.
        transmittance = 1 - renders.alpha[0, :, None]
        random = torch.rand(3, generator=self.generator).to(target)[:, None, None]
        behind = random - self.exposures.apply(self.background[None], view, 0.0)
        alpha = 1.0 if masks is None else 1 - transmittance
        color = self.exposures.apply(renders.color[0], view, alpha) + transmittance * behind
        if masks is not None:
            # Over the same colours, so that transparency is asked for where nothing is there.
            target = target + (1 - masks.alpha[view]) * (random - 1)
            color = torch.where(masks.valid[view], color, target)
        photometric_loss(color, target, dssim=DSSIM).backward()
        self._shrink()
        self.splats.adam.step()
        self.exposures.adam.rates["values"] = options.rate * options.exposure_lr * 0.1**fraction
        self.exposures.adam.step()
        self.exposures.center()
        last = max(1, round(options.averaged * stage))
        if done >= stage - last:
            self._average(last if done + 1 == stage else 0)
        self.step += 1
        if self.step % PRUNE_EVERY == 0 and done < stage - last:
            self._prune()

    @torch.no_grad()
    def _average(self, number: int) -> None:
        """Sum parameters up; after a ``number`` of steps, which 0 is not, they become their mean."""
        for name, value in self.splats.parameters.items():
            self.sums[name] = self.sums.get(name, 0) + value.detach()
            if number:
                value.copy_(self.sums.pop(name) / number)

    @torch.no_grad()
    def _shrink(self) -> None:
        """Add the gradient of the mean scale in footprints, for the Gaussians that the view shows.

        Adam takes whole steps for the smallest gradient: Gaussians outside of the view would shrink and leave holes.
        """
        scales = self.splats.parameters["scales"]
        if self.options.scale_weight and scales.grad is not None:
            shown = (scales.grad != 0).any(1)
            weight = shown * (self.options.scale_weight / (3 * shown.sum().clamp_min(1))) / self.splats.units
            scales.grad.addcmul_(scales.exp(), weight[:, None])

    @torch.no_grad()
    def _prune(self) -> None:
        scales, opacities = (self.splats.parameters[name] for name in ("scales", "opacities"))
        distance = torch.cdist(self.gaussians().means[0].double(), self.exposures.centers.double()).amin(1)
        keep = (opacities.sigmoid() >= MIN_OPACITY) & (scales.amax(1).exp() <= MAX_FOOTPRINTS * self.splats.units)
        self.splats.select((keep & (distance >= self.nearest)).nonzero()[:, 0])
        self._clear()
        self._carve()

    @torch.no_grad()
    def _clear(self) -> None:
        """Remove the Gaussians that lie where photographs see through: floaters, which other views would show."""
        if self.free_space is not None:
            self.splats.select((~self.free_space.contains(self.gaussians().means[0])).nonzero()[:, 0])

    @torch.no_grad()
    def _carve(self) -> None:
        """Remove the Gaussians that masks of the training views do not ask for."""
        if self.masks is not None:
            cameras = self.cameras.select(self.training)
            asked_for = self.masks.select(self.training).asked_for(self.gaussians().means[0], cameras)
            if self.step:
                asked_for &= self._share_in_empty_pixels() <= 0.5
            if not asked_for.any():
                raise UserError("masks leave nothing to fit: no place is shown by all photographs that it lies in")
            self.splats.select(asked_for.nonzero()[:, 0])

    @torch.enable_grad()
    def _share_in_empty_pixels(self) -> Float[Tensor, " N"]:
        """Which share of the pixels that each Gaussian covers in the training views is empty."""
        assert self.masks is not None
        gaussians = self.gaussians().detach()
        gray = torch.zeros_like(gaussians.harmonics[:, :, :1]).requires_grad_()
        covered = gray.new_zeros(2, gray.shape[1])  # empty pixels, all pixels
        for view in self.training:
            color = self.renderer(replace(gaussians, harmonics=gray), self.cameras.select([view])).color[0, 0]
            empty = self.masks.valid[view] & ~self.masks.measured[view]
            for row, pixels in zip(covered, (empty.expand_as(color).to(color), torch.ones_like(color)), strict=True):
                row += torch.autograd.grad(color, gray, pixels, retain_graph=True)[0][0, :, 0, 0]
        return covered[0] / covered[1].clamp_min(1e-6)

    def run(self, on_progress: OnProgress = no_progress, on_checkpoint: Callable[[], None] = lambda: None) -> FitResult:
        """Take all steps; the final ones are on all views."""
        started, first = time.monotonic(), self.step
        while self.step < self.last_step:
            self.advance()
            # Held-out views are included after the last step without them.
            if self.step % self.options.evaluate_every and self.step not in (self.last_step, self.options.num_steps):
                continue
            if self.step <= self.options.num_steps:
                self.quality = self.heldout_quality()
            if self.step == self.options.num_steps < self.last_step:
                self._include_heldout()
            pace = (time.monotonic() - started) / (self.step - first)
            shown, which = self.quality or self._quality(self.training[:1]), " on views held out" * bool(self.quality)
            left = pace * (self.last_step - self.step)
            line = f"step {self.step} of {self.last_step}: {shown.psnr:.1f} dB{which}, {left:.0f} s left"
            on_progress(Progress(line, self.step / self.last_step))
            on_checkpoint()
        self._carve()
        gains, biases = torch.stack([self.exposures.of(view) for view in range(len(self.images))]).detach().split(3, 1)
        unlike, fitted = torch.full((2, len(gains)), math.nan).to(gains)
        for view in self.training:
            given = self.render(view), self.images[view, None], self._measured([view])
            unlike[view], fitted[view] = unexplained(*given)[0], psnr(*given)[0]
        posed = self.cameras.world_from_camera[0], self.cameras.intrinsics[0]
        scene = self.gaussians().detach(), 1 + gains, biases, self.step, float(fitted.nanmean()), unlike
        return FitResult(*scene, self.quality, *posed, self.options.dropout)

    @property
    def last_step(self) -> int:
        """The number of all steps."""
        return self.options.num_steps + (self.options.final_steps if self.heldout else 0)

    @torch.no_grad()
    def _include_heldout(self) -> None:
        """From now on steps see all views; those held out begin with the exposure of neighbouring views.

        Where they differ from the scene, their pixels are lifted to its depth, if it has one there, as many as other
        views have Gaussians.
        """
        number, added = max(1, len(self.splats) // len(self.training)), list[InitialGaussians]()
        for view in self.heldout:
            self.exposures.values[view] = self.exposures.of(view)
            renders = self.renderer(self.gaussians(), self.cameras.select([view]))
            depth = (renders.depth / renders.alpha.clamp_min(1e-6))[0].cpu()
            known = self._measured([view]) & (renders.alpha[0] > SHOWN)
            error = ((self.render(view) - self.images[view, None]).abs().mean(1) * known).cpu()
            # As many, drawn in proportion to the error (Efraimidis and Spirakis 2006).
            drawn = error / torch.empty_like(error).exponential_(generator=self.generator)
            chosen = drawn.flatten().topk(min(number, int(error.count_nonzero()))).indices
            pixels = torch.stack(torch.unravel_index(chosen, error.shape), dim=1)
            given = self.images[view, None].cpu(), self.cameras.select([view]).to("cpu")
            added += [lift(*given, depth[pixels.unbind(1)], pixels)] if len(pixels) else []
        for new in (part.to(self.images.device) for part in added):
            together = Gaussians.cat([self.gaussians().detach(), new.gaussians(self.options.degree)], dim=1)
            self.splats = self._parameters(together, torch.cat([self.splats.units, new.footprints]))
        self._clear()
        self.training = self.useful
        self._carve()
        self.exposures.train(self.training)
        self.order = []

    def heldout_quality(self) -> Quality | None:
        """How well the views held out are rendered, if there are any."""
        return self._quality(self.heldout) if self.heldout else None

    def _quality(self, views: list[int]) -> Quality:
        renders = torch.cat([self.render(view) for view in views])
        return quality_of(renders, self.images[views], self._measured(views))

    def dissimilarity(self, views: Sequence[int]) -> float:
        """The mean of 1 - SSIM of grey values over views at half the resolution, where they are measured."""
        total, cameras = 0.0, self.cameras.resized(self.half_size)
        for view in views:
            shown, photograph = self.render(view, cameras.select([view])), self.half_images[view, None]
            if self.half_masks is not None:
                shown = torch.where(self.half_masks.measured[view], shown, photograph)
            total += float(photometric_loss(shown, photograph, dssim=1.0))
        return total / len(views)

    def _measured(self, views: list[int]) -> Bool[Tensor, "M H W"]:
        everywhere = torch.ones_like(self.images[views, 0], dtype=torch.bool)
        return everywhere if self.masks is None else self.masks.select(views).measured

    @torch.no_grad()
    def render(self, view: int, camera: Cameras | None = None) -> Float[Tensor, "1 3 H W"]:
        """One view with the exposure of its photograph, clamped to [0, 1]; over white where there are masks."""
        renders = self.renderer(self.gaussians(), camera or self.cameras.select([view]))
        if self.masks is None:
            return self.exposures.apply(renders.color[0], view).clamp(0, 1)
        alpha = renders.alpha[0, :, None]
        color = self.exposures.apply(renders.color[0] - (1 - alpha) * self.background, view, alpha)
        return (color + 1 - alpha).clamp(0, 1)

    def state_dict(self) -> dict[str, Any]:
        return {
            "generator": self.generator.get_state(),
            "step": self.step,
            "training": self.training,
            "dropout": self.options.dropout,
            "order": self.order,
            "sums": self.sums,
            "splats": self.splats.state_dict(),
            "exposures": self.exposures.adam.state_dict(),
            "quality": self.quality and tuple(self.quality),
            "given": {name: getattr(self.cameras, name) for name in ("world_from_camera", "intrinsics")},
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.generator.set_state(state["generator"])
        self.options = replace(self.options, dropout=state["dropout"])
        self.training = list(state["training"])
        self.step, self.order = state["step"], list(state["order"])
        self.sums = dict(state["sums"])
        self.splats.load_state_dict(state["splats"])
        self.exposures.adam.load_state_dict(state["exposures"])
        self.exposures.train(self.training)
        self.quality = state["quality"] and Quality(*state["quality"])


@torch.no_grad()
def background(renderer: Renderer, gaussians: Gaussians, cameras: Cameras) -> Float[Tensor, "3 1 1"]:
    """The colour that a renderer shows where there is nothing."""
    nothing = replace(gaussians, opacities=torch.zeros_like(gaussians.opacities)).map(lambda tensor: tensor[:, :1])
    return renderer(nothing, cameras.select([0])).color[0, 0].mean((1, 2))[:, None, None]
