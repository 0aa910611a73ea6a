"""Short fits that tell whether cameras are better refined, and from where, and whether a scene is overfitted."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace

import torch

from anystyle.types import Cameras
from anystyle_captures.fit_loop import FitLoop, FitOptions, InitialScene
from anystyle_captures.initial import InitialGaussians
from anystyle_captures.poses import difference

logger = logging.getLogger(__name__)
TRIAL, MOST = 0.3, 2
"""The steps of a trial, relative to those of a fit, all at half the resolution; how many follow each other at most."""
MOVED, BETTER = 0.0017, 1.02
"""How far cameras must have moved in a trial, in radians and median depths, and in how many times as many pixels stereo
must agree by them, or else they are kept as they were. 0.0017 are 0.1 degrees."""
STEPS = 60
"""Of the trial that tells whether a scene is overfitted. It sees half of the photographs."""
LEAST_GAP, LARGEST_GAP, MAX_DROPOUT = 0.11, 0.16, 0.3
"""By how much the SSIM of the other half is lower, at half the resolution, where it begins to be, and where it surely
is; the fraction of the Gaussians that steps leave out then."""


def try_refinement(
    cameras: Cameras,
    start: InitialScene,
    options: FitOptions,
    begin: Callable[[Cameras, InitialScene, FitOptions], FitLoop],
    initial: Callable[[Cameras], InitialScene],
) -> tuple[Cameras, InitialScene, FitOptions]:
    """What a fit should begin with: refined cameras, or exactly what was given, and no refinement.

    Cameras are refined in one trial after another, each from where the last one left them and from depths found anew
    by them, as long as these agree in more and more pixels: a measure that knows nothing of the fit.
    """
    short = replace(options, num_steps=max(1, round(TRIAL * options.num_steps)), half_resolution=1.0, final_steps=0)
    refine = "none"
    for number in range(MOST):
        loop = begin(cameras, start, short)
        while loop.step < loop.last_step:
            loop.advance()
        if loop.moved < MOVED:
            break
        again, taught = initial(loop.cameras), loop.training
        found = difference(cameras.select(taught), loop.cameras.select(taught))
        better = again.confirmed > BETTER * start.confirmed
        told = f"trial {number + 1}: cameras moved by {found[0]:.2f}° and {100 * found[1]:.1f}% of their radius"
        shares = f"stereo agrees in {100 * again.confirmed:.1f}% of the pixels, before in {100 * start.confirmed:.1f}%"
        logger.info("%s, %s: they are %s", told, shares, "taken" if better else "kept as they were")
        if not better:
            break
        cameras, start, refine = loop.cameras, again, options.refine
    return cameras, start, replace(options, refine=refine)


def try_dropout(
    cameras: Cameras, start: InitialScene, options: FitOptions, begin: Callable[..., FitLoop], unseen: Sequence[int]
) -> tuple[Cameras, InitialScene, FitOptions]:
    """The same, with more Gaussians left out of each step, the more a short fit is overfitted.

    It sees neither the photographs ``unseen`` nor what was lifted from them, and shows these far worse than the others.
    """
    first = start.gaussians
    assert isinstance(first, InitialGaussians)
    seen = ~torch.isin(first.pixels[:, 0], torch.tensor(unseen).to(first.pixels))
    loop = begin(cameras, start._replace(gaussians=first.map(lambda values: values[seen])), options, *unseen)
    for _ in range(min(STEPS, options.num_steps)):
        loop.advance()
    gap = loop.dissimilarity(unseen) - loop.dissimilarity(loop.training)
    share = min(max((gap - LEAST_GAP) / (LARGEST_GAP - LEAST_GAP), 0.0), 1.0)
    options = replace(options, dropout=(1 - share) * options.dropout + share * MAX_DROPOUT)
    told = f"photographs that {loop.step} steps did not see have an SSIM lower by {gap:.2f}"
    logger.info("%s: steps leave out %.0f%% of the Gaussians", told, 100 * options.dropout)
    return cameras, start, options
