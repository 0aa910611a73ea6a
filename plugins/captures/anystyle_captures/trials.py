"""Trials before a fit: whether cameras are better refined, and whether a scene is overfitted."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace

import torch

from anystyle.errors import UserError
from anystyle.types import Cameras
from anystyle_captures.fit_loop import FitLoop, FitOptions, InitialScene
from anystyle_captures.initial import InitialGaussians
from anystyle_captures.poses import difference

logger = logging.getLogger(__name__)
STEPS = 60
"""Of the trial that tells whether a scene is overfitted. It sees half of the photographs."""
LEAST_GAP, LARGEST_GAP, MAX_DROPOUT = 0.11, 0.16, 0.3
"""By how much the SSIM of the other half is lower, at half the resolution, where it begins to be, and where it surely
is; the fraction of the Gaussians that steps leave out then."""


def try_cameras(
    cameras: Cameras, found: Cameras, initial: Callable[[Cameras], InitialScene]
) -> tuple[Cameras, InitialScene]:
    """Refined cameras and what a fit begins with by them, or exactly what was given.

    They are taken unless depths by stereo agree in fewer pixels, a measure that knows nothing of the features.
    """
    again = initial(found)
    try:
        start = initial(cameras)
    except UserError:  # no depth agrees by them
        start = again._replace(confirmed=0.0)
    better = again.confirmed >= start.confirmed
    turned, moved = difference(cameras, found)
    told = f"cameras refined by shared features differ by {turned:.2f}° and {moved:.1%} of their radius"
    shares = f"stereo agrees by them in {again.confirmed:.1%} of the pixels, by those given in {start.confirmed:.1%}"
    logger.warning("%s, %s: %s", told, shares, "they are taken" if better else "those given are kept")
    return (found, again) if better else (cameras, start)


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
