"""A scene fitted to posed photographs: depth by stereo, initial Gaussians, their optimisation."""

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any, Literal, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import interpolate

from anystyle.contracts import Reconstruction, Renderer
from anystyle.errors import UserError
from anystyle.io.arrays import read_tensors
from anystyle.io.atomic import atomic_path
from anystyle.io.limits import require
from anystyle.methods.colors import with_gaussians
from anystyle.paths import expanded
from anystyle.ranges import AtLeastOne, Count
from anystyle.types import Cameras, OnProgress, Reconstructed, Scene, Views, no_progress
from anystyle_captures.cache import cached, key_of
from anystyle_captures.fit_loop import FitLoop, FitOptions, FitResult, InitialScene
from anystyle_captures.free_space import FreeSpace
from anystyle_captures.initial import InitialGaussians, backdrop, from_stereo
from anystyle_captures.masks import Masks
from anystyle_captures.photometric import unlike as differ
from anystyle_captures.poses import adjusted, difference
from anystyle_captures.sky import without_sky
from anystyle_captures.start import GivenGaussians, read_start
from anystyle_captures.stereo import plane_sweep
from anystyle_captures.trials import try_cameras, try_dropout
from anystyle_captures.twins import groups, held_out, to_try
from anystyle_methods.order import canonical_order

logger = logging.getLogger(__name__)


class Preset(NamedTuple):
    """What a fit costs."""

    short_side: int  # of the photographs, in pixels
    num_gaussians: int  # at the start, about
    options: FitOptions


PRESETS = {
    "draft": Preset(256, 20_000, FitOptions(num_steps=300, final_steps=50, scale_weight=0.001)),
    "good": Preset(384, 40_000, FitOptions(num_steps=600, final_steps=100, scale_weight=0.001)),
    "best": Preset(768, 120_000, FitOptions(num_steps=1350, final_steps=200, scale_weight=0.001)),
    "full": Preset(1 << 16, 200_000, FitOptions(num_steps=2700, final_steps=400, scale_weight=0.001)),
}
"""Photographs are not enlarged, so that ``full`` is their own size."""
STEREO_SIDE = 256
"""Short side in pixels of the images that stereo reads: Gaussians move to where larger ones have them."""
UNSUPPORTED, BEHIND, IN_SKY = 0.1, 0.05, 0.5
"""Fraction of pixels without a supported depth that are lifted; Gaussians of the backdrop, relative to all others; how
many more there are if all is sky."""
MAX_VIEWS, MANY = 320, 48
"""Photographs that are read by default, and from which on Gaussians and steps grow in proportion to them."""
MAX_UNEXPLAINED = 0.01
"""Median fraction of unexplained pixels: static captures have at most 0.0001, one of which 4 % move 0.02."""
MAX_UNEXPLAINED_OF_ONE, FAR_MORE = 0.05, 5
"""The same fraction of single photographs, and its ratio to the median: a photograph of an object that had been turned
over has 0.07, one of nothing but leaves 0.09, and others have at most 0.035."""
WARM = {"half_resolution": 0.0, "averaged": 0.8, "rate": 0.5}
"""Options of a fit that begins with a given scene, near which it stays."""

QualityLevel = Literal["draft", "good", "best", "full"]


class Fit(Reconstruction):
    """Gaussians fitted to the photographs through the renderer, beginning with depths by stereo.

    Args:
        quality: The size of the photographs, and the number of Gaussians and steps: ``draft`` has a shorter side of 256
            pixels, ``good`` 384, ``best`` 768, and ``full`` that of the photographs.
        num_gaussians: At the start, about, instead of the quality's, which is for up to 48 views, and grows with more.
        num_steps: Likewise.
        degree: The degree of the spherical harmonics of colours.
        holdout: Every ``holdout``-th view, in the natural order of their names, is held out of the fit to measure it,
            together with those that show the same; the final steps see all views. Fewer views are not held out; 0 holds
            out none.
        refine: Whether cameras of a network or of another program are refined first, where they disagree with features
            that the photographs share.
        start: A folder of results or a file of Gaussians to begin with, in place of depths by stereo, in half of the
            quality's steps.
        state: A file to write the fit to as it goes, and to resume it from.
        keep: Whether the fitted scene is cached, and read from the cache when the same photographs are fitted again
            with the same options.
        seed: The seed of all randomness.
    """

    needs_cameras = True

    def __init__(
        self,
        *,
        quality: QualityLevel = "good",
        num_gaussians: AtLeastOne | None = None,
        num_steps: AtLeastOne | None = None,
        degree: Count = 0,
        holdout: Count = 8,
        refine: bool = True,
        start: str | None = None,
        state: str | None = None,
        keep: bool = True,
        seed: int = 0,
    ) -> None:
        self.preset = PRESETS[quality]
        self.short_side, self.max_views = self.preset.short_side, MAX_VIEWS
        self.num_gaussians, self.num_steps = num_gaussians, num_steps
        self.degree, self.seed = degree, seed
        self.holdout, self.refine, self.keep = holdout, refine, keep
        self.start = None if start is None else expanded(start)
        self.state = None if state is None else expanded(state)

    def amounts(self, num_views: int) -> tuple[int, FitOptions]:
        """The number of Gaussians at the start, and the options, for so many views."""
        preset, growth = self.preset.options, max(1.0, num_views / MANY)
        options = replace(
            preset,
            num_steps=self.num_steps or round(preset.num_steps * growth),
            final_steps=preset.final_steps if self.num_steps else round(preset.final_steps * growth),
            degree=self.degree,
            seed=self.seed,
        )
        return self.num_gaussians or round(self.preset.num_gaussians * growth), options

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        return {"quality": "draft", "num_gaussians": 150, "num_steps": 5, "holdout": 0, "keep": False}

    def __call__(
        self,
        views: Views,
        encode: Callable[[Views], Scene],
        renderer: Renderer,
        *,
        points: Sequence[Float[Tensor, "_ 3"]] | None = None,
        on_progress: OnProgress = no_progress,
    ) -> Reconstructed:
        """Fit Gaussians to the views; the backbone's features of them are kept for a style branch that reads them."""
        if views.cameras is None or views.images.shape[0] != 1:
            raise UserError(
                f"a fit takes one scene with known cameras, and there are {views.images.shape[0]} scenes "
                f"{'with' if views.cameras else 'without'} them; poses=sfm finds cameras"
            )
        num_gaussians, options = self.amounts(views.images.shape[1])
        start = None if self.start is None else read_start(self.start, views)
        if start is not None:
            num_gaussians, options = len(start.footprints), warm(options, half=self.num_steps is None)
        parameters = num_gaussians * (11 + 3 * (self.degree + 1) ** 2)
        # Each with its gradient and the optimiser's two moments.
        require(4 * 4 * parameters, f"{num_gaussians:,} Gaussians", "set fewer with reconstruction.num_gaussians")
        photographs = groups(views.images[0], views.cameras, views.names)
        heldout, masks = held_out(photographs, self.holdout, views.cameras), Masks.of(views)
        with torch.enable_grad():
            result = fit_photographs(
                views.images[0],
                views.cameras,
                renderer,
                num_gaussians=num_gaussians,
                options=options,
                points=points,
                start=start,
                heldout=heldout,
                unseen=to_try(photographs, heldout, views.cameras),
                masks=masks,
                refine=self.refine and points is None,
                state=self.state,
                keep=self.keep,
                on_progress=on_progress,
            )
        usual, unlike = float(result.unexplained.nanmedian()), list[int]()
        if usual > MAX_UNEXPLAINED:
            logger.warning(
                "the scene shows %.0f%% of the pixels of most photographs quite otherwise: something moved while they "
                "were taken, or the light changed, and what moved is smeared",
                100 * usual,
            )
        elif unlike := unlike_most(result.unexplained, usual):
            names = (views.names[view] if views.names else f"number {view + 1}" for view in unlike)
            shares = (
                f"{name} ({100 * result.unexplained[view]:.0f}%)" for name, view in zip(names, unlike, strict=True)
            )
            logger.warning(
                "the scene differs in a large part of these photographs: %s. Styles are painted on the scene there; if "
                "something was moved before they were taken, leave them out or mask it",
                ", ".join(shares),
            )
        measures = {"num_gaussians": float(result.gaussians.means.shape[1]), "steps": float(result.steps)}
        measures |= {"train_psnr": result.train_psnr, "unexplained": usual, "dropout": result.dropout}
        found = {"kept": float(result.cached), "twins": float(views.images.shape[1] - len(photographs))}
        measures |= {name: value for name, value in found.items() if value}
        refined = result.cameras(views.size)
        if any(by := difference(views.cameras, refined)):
            measures |= dict(zip(("cameras_turned_degrees", "cameras_moved"), by, strict=True))
            views = replace(views, cameras=refined)
        quality = {} if result.heldout is None else result.heldout._asdict()
        measures |= {f"heldout_{name}": value for name, value in quality.items()}
        views = to_paint(views, result, renderer, unlike)
        return Reconstructed(scene_of_fit(views, encode(views), result, renderer), measures)


def warm(options: FitOptions, *, half: bool) -> FitOptions:
    """Options of a fit that begins with a given scene; ``half``: in half of the steps."""
    steps, final = (math.ceil(number / (2 if half else 1)) for number in (options.num_steps, options.final_steps))
    return replace(options, num_steps=steps, final_steps=final, **WARM)


def unlike_most(unexplained: Float[Tensor, " V"], usual: float) -> list[int]:
    """Photographs of which the scene shows much otherwise, and far more than the usual share, the worst first."""
    least = max(MAX_UNEXPLAINED_OF_ONE, FAR_MORE * usual)
    return [int(view) for view in unexplained.argsort(descending=True) if unexplained[view] > least]


@torch.no_grad()
def to_paint(views: Views, result: FitResult, renderer: Renderer, unlike: Sequence[int] = ()) -> Views:
    """Photographs to paint styles over: no white that shines through, and the fitted scene where they were ignored.

    So it is where those named as ``unlike`` show something else than the scene, such as what was moved.
    """
    masks = Masks.of(views)
    if views.cameras is None or (masks is None and not unlike):
        return views
    images = views.images[0].clone()
    for view in range(len(images)) if masks is not None else unlike:
        given = images[view]
        shown = result.photographed(renderer, views.cameras, [view], masked=masks is not None)[0]
        ignored = differ(shown[None], given[None])[0] if view in unlike else torch.zeros_like(given[0]).bool()
        if masks is not None:
            mine = masks.select([view])
            given, ignored = mine.straight(given[None])[0], ignored | ~mine.valid[0]
        images[view] = torch.where(ignored, shown, given)
    return replace(views, images=images[None])


def fit_photographs(
    images: Float[Tensor, "V 3 H W"],
    cameras: Cameras,
    renderer: Renderer,
    *,
    num_gaussians: int,
    options: FitOptions,
    points: Sequence[Float[Tensor, "_ 3"]] | None = None,
    start: GivenGaussians | None = None,
    heldout: Sequence[int] = (),
    unseen: Sequence[int] = (),
    masks: Masks | None = None,
    refine: bool = False,
    state: Path | None = None,
    keep: bool = False,
    on_progress: OnProgress = no_progress,
) -> FitResult:
    """Fit Gaussians to photographs: initial ones by stereo, or those given, then all their attributes by renders.

    The same photographs give the same Gaussians, bit for bit, in whatever order they are given.

    ``heldout`` views are for the final steps alone; ``unseen`` ones, if any, are left out of a trial beforehand.
    """
    order = canonical_order(images)
    images, cameras = images[order], cameras.select(order)
    points = None if points is None else [points[view] for view in order]
    masks = None if masks is None else masks.select(order)
    hidden, tried = (tuple(sorted(order.index(view) for view in views)) for views in (heldout, unseen))
    settings = {name: value for name, value in vars(renderer).items() if isinstance(value, (int, float, tuple))}
    masked = () if masks is None else (masks.alpha, masks.valid)
    begun = () if start is None else vars(start.given).values()
    given = images, cameras.world_from_camera, cameras.intrinsics, *(points or ()), *masked, *begun
    key = key_of(*given, num_gaussians, options, refine, hidden, tried, type(renderer).__name__, settings)

    def compute() -> dict[str, Any]:
        training = [view for view in range(len(images)) if view not in hidden]
        initial = partial(_initial, images, points, masks, num_gaussians, options.seed)

        def begin(cameras: Cameras, first: InitialScene, options: FitOptions, *unseen: int) -> FitLoop:
            return FitLoop(images, cameras, first, renderer, options, heldout=hidden + unseen, masks=masks)

        written = None if state is None else _written(state, key, images.device)
        posed = cameras if written is None else replace(cameras, **written["given"])
        found = None
        if refine and written is None:
            found = adjusted(images, posed, masks, seed=options.seed, on_progress=on_progress)
        if found is not None:
            posed, first = try_cameras(posed, found, lambda cameras: initial(cameras, training))
        else:
            first = initial(posed, training) if start is None else InitialScene(start)
        given = posed, first if start is None else first._replace(gaussians=start), options
        taught = [view for view in training if view not in tried and (masks is None or masks.measured[view].any())]
        if written is None and start is None and tried and taught:
            given = try_dropout(*given, begin, tried)
        loop = begin(*given)
        if state is None:
            return loop.run(on_progress).as_dict()
        if written is not None:
            loop.load_state_dict(written)
            logger.info("the fit goes on at step %d of %d", loop.step, loop.last_step)
        result = loop.run(on_progress, partial(_write_state, loop, state, key))
        state.unlink(missing_ok=True)
        return result.as_dict()

    values, from_cache = cached("fit", key if keep else None, compute)
    result = FitResult.from_dict(values, images.device)
    # Back to the order given.
    back = torch.tensor(order, device=images.device).argsort()
    of_views = ("gains", "biases", "unexplained", "world_from_camera", "intrinsics")
    return replace(result, **{name: getattr(result, name)[back] for name in of_views}, cached=from_cache)


def _write_state(loop: FitLoop, path: Path, key: str) -> None:
    # A file, for PyTorch takes no path whose name begins with a point and has no suffix.
    with atomic_path(path, sync=True) as temporary, temporary.open("wb") as file:
        torch.save({"key": key, "fit": loop.state_dict()}, file)


def _written(path: Path, key: str, device: torch.device) -> dict[str, Any] | None:
    """The state of an interrupted fit, if there is one. That of other photographs or options is renamed."""
    if not path.is_file():
        return None
    written = read_tensors(path, what="state of a fit; name another file as state, or delete it", device=device)
    if not isinstance(written, dict) or set(written) != {"key", "fit"}:
        raise UserError(f"{path} is not a state of a fit; name another file as state")
    if written["key"] != key:
        aside = next(name for number in count(1) if not (name := path.with_name(f"{path.name}.{number}")).exists())
        path.rename(aside)
        logger.warning(
            "%s was written for other photographs or options: it is %s now, and the fit begins anew", path, aside.name
        )
        return None
    return written["fit"]


def _initial(
    images: Float[Tensor, "V 3 H W"],
    points: Sequence[Float[Tensor, "_ 3"]] | None,
    masks: Masks | None,
    num_gaussians: int,
    seed: int,
    cameras: Cameras,
    seen: Sequence[int],
) -> InitialScene:
    """Gaussians at pixels of the views ``seen``, by their stereo, on the device of the images."""
    chosen, posed = for_stereo(images[list(seen)], cameras.select(list(seen)))
    shown, valid = None if points is None else [points[view].cpu() for view in seen], None
    if masks is not None:
        smaller = masks.select(seen).resized(posed.size)
        chosen, valid = smaller.straight(chosen.to(images)).cpu(), smaller.measured.cpu()
    stereo = without_sky(chosen, posed, plane_sweep(chosen, posed, points=shown, valid=valid))
    generator = torch.Generator().manual_seed(seed)
    surfaces = from_stereo(
        chosen, posed, stereo, num_gaussians=num_gaussians, unsupported=UNSUPPORTED, generator=generator
    )
    share = BEHIND + IN_SKY * float(stereo.depth.isposinf().double().mean())
    behind = backdrop(chosen, posed, stereo, num_gaussians=math.ceil(share * num_gaussians), generator=generator)
    initial = InitialGaussians.cat([surfaces, behind])
    view, y, x = initial.pixels.unbind(1)
    pixels = torch.stack([torch.tensor(seen)[view], y, x], dim=1)
    initial = replace(initial, footprints=initial.footprints * posed.size[1] / cameras.size[1], pixels=pixels)
    confirmed = float((stereo.support > 0).double().mean())
    return InitialScene(initial.to(images.device), FreeSpace.of(stereo, posed).to(images.device), confirmed)


def for_stereo(images: Float[Tensor, "V 3 H W"], cameras: Cameras) -> tuple[Float[Tensor, "V 3 h w"], Cameras]:
    """Photographs as large as stereo reads them, and their cameras, on the processor."""
    ratio = max(1.0, min(cameras.size) / STEREO_SIDE)
    size = (round(cameras.size[0] / ratio), round(cameras.size[1] / ratio))
    return interpolate(images.cpu(), size=size, mode="area"), cameras.to("cpu").resized(size)


@torch.no_grad()
def scene_of_fit(views: Views, encoded: Scene, result: FitResult, renderer: Renderer) -> Scene:
    """The fitted Gaussians with what styling needs: their cameras and depths, and photographs of one exposure."""
    assert views.cameras is not None
    renders = [renderer(result.gaussians, views.cameras.select([view])) for view in range(views.images.shape[1])]
    exposed = (views.images - result.biases[:, :, None, None]) / result.gains[:, :, None, None]
    return with_gaussians(encoded, result.gaussians, views.cameras, renders, exposed.clamp(0, 1))
