"""Short fits that tell whether cameras are better refined, and from where."""

import logging
from collections.abc import Callable
from dataclasses import replace

from anystyle.types import Cameras
from anystyle_captures.fit_loop import FitLoop, FitOptions, InitialScene
from anystyle_captures.poses import difference

logger = logging.getLogger(__name__)
TRIAL, MOST = 0.3, 2
"""The steps of a trial, relative to those of a fit, all at half the resolution; how many follow each other at most."""
MOVED, BETTER = 0.0017, 1.02
"""How far cameras must have moved in a trial, in radians and median depths, and in how many times as many pixels stereo
must agree by them, or else they are kept as they were. 0.0017 are 0.1 degrees."""


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
        logger.info("trial %d: cameras moved by %.2f° and %.1f%% of their radius", number + 1, found[0], 100 * found[1])
        then = "the refined cameras are taken" if better else "those from before this trial are kept"
        shares = 100 * again.confirmed, 100 * start.confirmed
        logger.info("stereo agrees in %.1f%% of the pixels, before in %.1f%%: %s", *shares, then)
        if not better:
            break
        cameras, start, refine = loop.cameras, again, options.refine
    return cameras, start, replace(options, refine=refine)
