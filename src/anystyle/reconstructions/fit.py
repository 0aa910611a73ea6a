"""A scene fitted to posed photographs."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.capacity import require
from anystyle.contracts import Renderer
from anystyle.geometry.harmonics import constant_from_rgb
from anystyle.reconstructions.contract import Reconstruction, silent
from anystyle.reconstructions.options import FitResult, Progress
from anystyle.reconstructions.order import held_out
from anystyle.reconstructions.photographs import fit_photographs, quality_named
from anystyle.types import Attributes, Geometry, Reconstructed, Scene, Views

logger = logging.getLogger(__name__)

DOUBTFUL = 0.01
"""Of pixels unexplained in half of the photographs: static captures have at most 0.0001, one of which 4 % move 0.02."""


class Fit(Reconstruction):
    """Gaussians fitted to the photographs through the renderer, beginning with depths by stereo.

    Args:
        quality: ``draft``, ``good`` or ``best``: the size of the photographs, and how many Gaussians and steps.
        num_gaussians: At the start, about, instead of the quality's.
        num_steps: At most, instead of the quality's.
        degree: Of the spherical harmonics of colours.
        holdout: Every so many-th view, in the natural order of their names, is held out of the fit and says how good it
            is, where there are so many; the final steps see all views. 0 holds out none.
        state: A file to write the fit to as it goes, and to resume it from.
        keep: Whether the fitted scene is kept in the user's cache folder, and taken from there when the same
            photographs are fitted again with the same options.
        seed: Of all that is random.

    Raises:
        ValueError: The quality is unknown, or a number makes no sense.
    """

    needs_cameras = True

    def __init__(
        self,
        *,
        quality: str = "good",
        num_gaussians: int | None = None,
        num_steps: int | None = None,
        degree: int = 0,
        holdout: int = 8,
        state: str | None = None,
        keep: bool = True,
        seed: int = 0,
    ) -> None:
        chosen = quality_named(quality)
        if holdout < 0 or degree < 0 or min(num_gaussians or 1, num_steps or 1) < 1:
            raise ValueError(
                f"reconstruction: holdout={holdout}, degree={degree}, num_gaussians={num_gaussians} and "
                f"num_steps={num_steps}; give numbers above 0, or holdout=0 to hold out no view"
            )
        self.short_side = chosen.short_side
        self.num_gaussians = num_gaussians or chosen.num_gaussians
        self.options = replace(
            chosen.options, num_steps=num_steps or chosen.options.num_steps, degree=degree, seed=seed
        )
        self.holdout, self.state, self.keep = holdout, state, keep

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        """A short one."""
        return {"quality": "draft", "num_gaussians": 150, "num_steps": 5, "holdout": 0, "keep": False}

    def __call__(
        self,
        views: Views,
        encode: Callable[[Views], Scene],
        renderer: Renderer,
        *,
        points: Sequence[Float[Tensor, "_ 3"]] | None = None,
        progress: Callable[[str], None] = silent,
    ) -> Reconstructed:
        """Fit Gaussians to the views; what the backbone knows of them is kept for a style branch that reads it."""
        if views.cameras is None or views.images.shape[0] != 1:
            raise ValueError(
                f"a fit takes one scene with known cameras, and there are {views.images.shape[0]} scenes "
                f"{'with' if views.cameras else 'without'} them; poses=sfm finds cameras"
            )
        numbers = self.num_gaussians * (11 + 3 * (self.options.degree + 1) ** 2)
        # Each with its gradient and the optimiser's two moments.
        require(4 * 4 * numbers, f"{self.num_gaussians:,} Gaussians", "set fewer with reconstruction.num_gaussians")

        with torch.enable_grad():
            result = fit_photographs(
                views.images[0],
                views.cameras,
                renderer,
                num_gaussians=self.num_gaussians,
                options=self.options,
                points=points,
                heldout=held_out(views.images.shape[1], self.holdout, views.names),
                state=None if self.state is None else Path(self.state).expanduser(),
                keep=self.keep,
                on_progress=lambda now: progress(described(now)),
            )
        if result.unexplained > DOUBTFUL:
            logger.warning(
                "the scene shows %.0f%% of the pixels of most photographs quite otherwise: something moved while they "
                "were taken, or the light changed, and what moved is smeared",
                100 * result.unexplained,
            )
        return Reconstructed(scene_of_fit(views, encode(views), result, renderer), _measures(result))


def described(now: Progress) -> str:
    """A line on where a fit is."""
    measured, where = (now.train_psnr, "") if now.heldout_psnr is None else (now.heldout_psnr, " on views held out")
    return f"step {now.step} of {now.num_steps}: {measured:.1f} dB{where}, {now.seconds_left:.0f} s left"


def _measures(result: FitResult) -> dict[str, float]:
    measures = {"num_gaussians": float(result.gaussians.means.shape[1]), "steps": float(result.steps)}
    measures |= {"train_psnr": result.train_psnr, "unexplained": result.unexplained}
    measures |= {"kept": 1.0} if result.kept else {}
    if result.heldout is not None:
        measures |= {
            "heldout_psnr": result.heldout.psnr,
            "heldout_ssim": result.heldout.ssim,
            "heldout_matched_psnr": result.heldout.matched_psnr,
        }
    return measures


@torch.no_grad()
def scene_of_fit(views: Views, encoded: Scene, result: FitResult, renderer: Renderer) -> Scene:
    """The fitted Gaussians with what styling needs: their cameras and depths, and photographs of one exposure."""
    assert views.cameras is not None
    renders = [renderer(result.gaussians, views.cameras.select([view])) for view in range(views.images.shape[1])]
    alpha = torch.cat([render.alpha for render in renders], dim=1)
    depth = torch.cat([render.depth for render in renders], dim=1) / alpha.clamp_min(1e-6)
    exposed = (views.images[0] - result.biases[:, :, None, None]) / result.gains[:, :, None, None]
    color = constant_from_rgb(exposed.clamp(0, 1).movedim(1, -1))[None, ..., None]  # B V H W 3 1
    attributes: Attributes = replace(encoded.attributes, color=color.to(encoded.attributes.color.dtype))
    return replace(
        encoded,
        geometry=Geometry(views.cameras, depth, alpha),
        attributes=attributes,
        clusters=None,
        gaussians=result.gaussians,
        origins=result.pixels[None],
    )
