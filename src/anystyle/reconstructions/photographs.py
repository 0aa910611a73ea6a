"""Posed photographs in, fitted Gaussians out."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from anystyle.contracts import Renderer
from anystyle.geometry.stereo import plane_sweep
from anystyle.reconstructions.fitting import Fit
from anystyle.reconstructions.initial import InitialGaussians, backdrop, from_stereo
from anystyle.reconstructions.kept import kept, key_of
from anystyle.reconstructions.loop import resume, write_state
from anystyle.reconstructions.options import FitOptions, FitResult, Progress
from anystyle.reconstructions.order import canonical_order
from anystyle.types import Cameras

UNSUPPORTED, BEHIND = 0.1, 0.05
"""Of the pixels without a supported depth, the share that is lifted all the same; Gaussians of the backdrop, as a share
of all others."""


@dataclass(frozen=True)
class Quality:
    """What a fit costs.

    Args:
        short_side: Of the photographs, in pixels.
        num_gaussians: At the start, about; fewer where there are not enough pixels.
        options: How they are fitted.
    """

    short_side: int
    num_gaussians: int
    options: FitOptions


QUALITIES: Mapping[str, Quality] = MappingProxyType(
    {
        "draft": Quality(192, 15_000, FitOptions(num_steps=400, final_steps=60, evaluate_every=100)),
        "good": Quality(
            256,
            30_000,
            FitOptions(
                num_steps=600,
                half_resolution=0.35,
                scale_weight=0.001,
                final_steps=80,
                evaluate_every=100,
                patience=3,
            ),
        ),
        "best": Quality(384, 80_000, FitOptions(num_steps=5000, final_steps=500, evaluate_every=250, patience=4)),
    }
)


def quality_named(name: str) -> Quality:
    """One of :data:`QUALITIES`.

    Raises:
        ValueError: There is none of that name.
    """
    if name not in QUALITIES:
        raise ValueError(f"reconstruction.quality={name}; choose one of {', '.join(QUALITIES)}")
    return QUALITIES[name]


def fit_photographs(
    images: Float[Tensor, "V 3 H W"],
    cameras: Cameras,
    renderer: Renderer,
    *,
    num_gaussians: int,
    options: FitOptions,
    points: Sequence[Float[Tensor, "_ 3"]] | None = None,
    heldout: Sequence[int] = (),
    state: Path | None = None,
    keep: bool = False,
    on_progress: Callable[[Progress], None] | None = None,
) -> FitResult:
    """Fit Gaussians to photographs: initial ones by stereo, then all their attributes through the renderer.

    The same photographs come to the same Gaussians, bit for bit, in whatever order they are given.

    Args:
        images: sRGB in [0, 1].
        cameras: Of one scene, for images of this size.
        renderer: Differentiable, on the device of the images.
        num_gaussians: At the start, about.
        options: How they are fitted.
        points: For each view, points in world space that it shows, where some are known; see
            :func:`~anystyle.geometry.stereo.plane_sweep`.
        heldout: Views that no step sees before the final ones.
        state: A file to write the fit to as it goes, and to resume it from where one of the same photographs and
            options is there; removed at the end. The result is the same with and without a break.
        keep: Whether the fit is kept in the user's cache folder, and taken from there if it is known.
        on_progress: Called after every evaluation.

    Raises:
        ValueError: No depth agrees between the photographs.
    """
    order = canonical_order(images)
    images, cameras = images[order], cameras.select(order)
    points = None if points is None else [points[view] for view in order]
    heldout = sorted(order.index(view) for view in heldout)
    drawn = images, cameras.world_from_camera, cameras.intrinsics, *(points or ())
    shown = {name: value for name, value in vars(renderer).items() if isinstance(value, (int, float, tuple, dict))}
    key = key_of(*drawn, num_gaussians, options, heldout, type(renderer).__name__, shown)

    def compute() -> dict[str, Any]:
        training = [view for view in range(len(images)) if view not in heldout]
        begin = _initial(images, cameras, training, points, num_gaussians, options.seed)
        fit = Fit(images, cameras, begin, renderer, options, heldout=tuple(heldout))
        if state is not None:
            resume(fit, state, key, images.device)
        result = fit.run(on_progress, None if state is None else partial(write_state, fit, state, key))
        if state is not None:
            state.unlink(missing_ok=True)
        return result.as_dict()

    values, before = kept("fit", key, compute) if keep else (compute(), False)
    result = replace(FitResult.from_dict(values, images.device), kept=before)
    return _in_given_order(result, torch.tensor(order, device=images.device))


def _in_given_order(result: FitResult, order: Int[Tensor, " V"]) -> FitResult:
    pixels, back = result.pixels.clone(), order.argsort()
    pixels[:, 0] = order[pixels[:, 0]]
    return replace(result, pixels=pixels, gains=result.gains[back], biases=result.biases[back])


def _initial(
    images: Float[Tensor, "V 3 H W"],
    cameras: Cameras,
    training: list[int],
    points: Sequence[Float[Tensor, "_ 3"]] | None,
    num_gaussians: int,
    seed: int,
) -> InitialGaussians:
    """Gaussians at pixels of the views that are fitted to, on the device of the images."""
    device = images.device
    chosen, posed = images[training].cpu(), cameras.select(training).to("cpu")
    stereo = plane_sweep(chosen, posed, points=None if points is None else [points[view].cpu() for view in training])
    generator = torch.Generator().manual_seed(seed)
    lifted = from_stereo(
        chosen, posed, stereo, num_gaussians=num_gaussians, unsupported=UNSUPPORTED, generator=generator
    )
    behind = backdrop(chosen, posed, stereo, num_gaussians=round(BEHIND * num_gaussians), generator=generator)
    begin = lifted if behind is None else InitialGaussians.cat([lifted, behind])
    view, row, column = begin.pixels.unbind(1)
    return replace(begin, pixels=torch.stack([torch.tensor(training)[view], row, column], dim=1)).to(device)
