"""Metrics: each a ``torchmetrics.Metric`` that is usable on its own.

``from anystyle.metrics import LPIPS, ArtFID, CSD`` imports a metric when it is first asked for, a plugin's too.
``LPIPS().update(preds, target)`` takes in sRGB images in [0, 1], ``[N, 3, H, W]`` or in scenes ``[B, V, 3, H, W]``
(:meth:`Comparison.from_images <anystyle.types.Comparison.from_images>`), or a comparison; ``compute()`` gives the
scores over all, and a call takes in and gives the scores of what it took in alone. ``stand_ins`` names the scores
that rest on a stand-in.
"""

from typing import TYPE_CHECKING, Any

from anystyle.registry.catalog import catalog

if TYPE_CHECKING:
    from anystyle.metrics.art_fid import ArtFID as ArtFID
    from anystyle.metrics.art_score import ArtScore as ArtScore
    from anystyle.metrics.color_match import ColorMatch as ColorMatch
    from anystyle.metrics.kid import KID as KID
    from anystyle.metrics.lpips import LPIPS as LPIPS
    from anystyle.metrics.lpips import LPIPSGray as LPIPSGray
    from anystyle.metrics.psnr import PSNR as PSNR
    from anystyle.metrics.ssim import SSIM as SSIM
    from anystyle.metrics.timing import Timing as Timing
    from anystyle.metrics.warp_consistency import WarpConsistency as WarpConsistency


def __getattr__(name: str) -> Any:
    # Of two plugins whose classes have one name the first is meant.
    metrics = [plugin for plugin in reversed([*catalog()]) if plugin.kind == "metric"]
    named = {plugin.target.partition(":")[2]: plugin for plugin in metrics}
    if name == "__all__":
        return [*named]
    if name in named:
        return named[name].load()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*globals(), *__getattr__("__all__")]
