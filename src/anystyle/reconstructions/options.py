"""How Gaussians are fitted, where a fit is, and what comes of it."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from anystyle.types import Gaussians


@dataclass(frozen=True)
class FitOptions:
    """How Gaussians are fitted; learning rates are those at the start.

    Args:
        num_steps: Steps at most, of one view each.
        half_resolution: The share of the steps that is taken at half the resolution.
        degree: Of the spherical harmonics of colours.
        dssim: The weight of 1 - SSIM beside L1.
        opacity: Of every Gaussian at the start.
        means_lr: In footprints of a pixel; falls to a twentieth.
        scales_lr: Of log scales; falls to a fifth.
        opacities_lr: Of logits; falls to a fifth.
        colors_lr: Of the constant harmonics; the others learn at a twentieth of it.
        rotations_lr: Of quaternions.
        exposure_lr: Of gains and biases; falls to a tenth; 0 leaves exposure alone.
        opacity_weight: The weight of the mean opacity in the loss.
        scale_weight: The weight of the mean scale in footprints. Where photographs are plain, large Gaussians show them
            as well as small ones, and only small ones have room for a style's strokes.
        random_background: Whether photographs are laid over random colours, so that no Gaussian lets the
            background through where there is something.
        prune_every: Steps between removals of Gaussians that show nothing, or are too large; 0 removes none.
        patience: Stop once held-out (or training) PSNR has not risen for so many evaluations; 0 goes on to the end.
        evaluate_every: Steps between evaluations.
        final_steps: Steps on all views after these, where some are held out; what was measured of those stays.
        seed: Of the order of views and all else that is random.
    """

    num_steps: int = 1500
    half_resolution: float = 0.25
    degree: int = 0
    dssim: float = 0.2
    opacity: float = 0.4
    means_lr: float = 0.07
    scales_lr: float = 0.04
    opacities_lr: float = 0.05
    colors_lr: float = 0.02
    rotations_lr: float = 0.005
    exposure_lr: float = 0.002
    opacity_weight: float = 0.0
    scale_weight: float = 0.0
    random_background: bool = True
    prune_every: int = 200
    patience: int = 0
    evaluate_every: int = 200
    final_steps: int = 0
    seed: int = 0


@dataclass(frozen=True)
class Progress:
    """Where a fit is.

    Args:
        step: Steps taken.
        num_steps: Steps at most.
        train_psnr: In dB, of the views of the last steps as they were rendered.
        heldout_psnr: In dB, of the last evaluation; ``None`` where no view is held out.
        num_gaussians: So many there are.
        seconds_left: Estimate to the last step.
    """

    step: int
    num_steps: int
    train_psnr: float
    heldout_psnr: float | None
    num_gaussians: int
    seconds_left: float


class HeldoutQuality(NamedTuple):
    """How views that no step saw are rendered, with the exposure of the views beside them; means over the views.

    Args:
        psnr: In dB.
        ssim: In [-1, 1].
        matched_psnr: In dB, after an affine change of each view's colours: what is left when exposure is no matter.
    """

    psnr: float
    ssim: float
    matched_psnr: float


@dataclass(frozen=True)
class FitResult:
    """A fitted scene.

    Args:
        gaussians: A batch of one scene.
        pixels: View, row and column that each Gaussian began at.
        gains: Of each view's exposure, a channel; photographs are ``gain * render + bias``.
        biases: Of each view's exposure.
        steps: Steps taken.
        train_psnr: In dB, with each view's exposure.
        heldout: Of the views held out, before the final steps; ``None`` where there are none.
        unexplained: Share of the pixels of half of the photographs, at least, that the scene shows quite otherwise.
        kept: Whether an earlier run fitted it.
    """

    gaussians: Gaussians
    pixels: Int[Tensor, "N 3"]
    gains: Float[Tensor, "V 3"]
    biases: Float[Tensor, "V 3"]
    steps: int
    train_psnr: float
    heldout: HeldoutQuality | None
    unexplained: float = 0.0
    kept: bool = False

    def as_dict(self) -> dict[str, Any]:
        """Tensors and plain values that :meth:`from_dict` takes."""
        tensors = {name: getattr(self.gaussians, name) for name in Gaussians.__dataclass_fields__}
        return {**self.__dict__, "gaussians": tensors, "heldout": self.heldout and tuple(self.heldout)}

    @classmethod
    def from_dict(cls, values: dict[str, Any], device: torch.device) -> "FitResult":
        """What :meth:`as_dict` gave, on a device."""
        tensors = {name: value.to(device) for name, value in values.items() if isinstance(value, Tensor)}
        gaussians = Gaussians(**values["gaussians"]).to(device)
        heldout = values["heldout"] and HeldoutQuality(*values["heldout"])
        return cls(**{**values, **tensors, "gaussians": gaussians, "heldout": heldout})
