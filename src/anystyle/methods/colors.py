"""Colours of given Gaussians for given pictures, by least squares: a render is linear in its colours."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree
from torch import Tensor

from anystyle.contracts import LinearView, Renderer
from anystyle.errors import UserError
from anystyle.geometry.harmonics import constant_from_rgb, rgb_from_constant
from anystyle.io.cache import LRUCache
from anystyle.types import Attributes, Cameras, Gaussians, Geometry, Renders, Scene, Tokens, Views

MIN_WEIGHT = 1e-3
"""A Gaussian that covers fewer pixels of all views together keeps its colour."""
EVIDENCE, NEIGHBORS = 1.0, 8
"""A Gaussian that covers fewer than ``EVIDENCE`` pixels of all views takes the rest of its colour from the nearest
``NEIGHBORS`` that cover more."""
COUNTED = 50_000
"""Gaussians that views are chosen by, evenly spaced; all pairs of them and views are held in memory."""
KEPT = 288 << 20
"""Bytes of linear views that are kept in memory; the others are made again each time."""
MIN_CONFIDENCE = 1e-3
"""Confidence of a pixel whose Gaussians all appear larger in another view."""


def fit_colors(
    gaussians: Gaussians,
    cameras: Cameras,
    targets: Float[Tensor, "V 3 H W"],
    renderer: Renderer,
    *,
    steps: int = 4,
    damping: float = 0.0,
    largest: bool = False,
    keep: bool = False,
    alpha: Float[Tensor, "V H W"] | None = None,
) -> Gaussians:
    """Colour Gaussians so that their renders are as near as can be to targets, in squared error.

    It begins with the mean of the pixels that each Gaussian is seen in, weighted by how much of them it covers, and
    goes on with steps of preconditioned conjugate gradients on the normal equations. Colours lie in [0, 1], and do
    not depend on the direction afterwards unless the harmonics that do are kept: what these show is then taken out
    of the targets.

    Pictures painted one by one disagree about strokes, and their mean has none. With ``largest`` a pixel counts
    by the square of the share that Gaussians have in it which no other view shows larger, so that each place is painted
    by one view, as surfaces are textured from photographs (Lempitsky and Ivanov 2007).

    Gaussians that views hardly show, which least squares would fit to residual errors, are pulled towards the
    colours of their neighbours.

    Args:
        gaussians: A batch of one scene; their colours are kept only where the views show none of them.
        cameras: A batch of one scene, for images of the targets' size.
        targets: sRGB in [0, 1].
        renderer: Differentiable in colours; what it has behind the scene is taken out of the targets.
        steps: Steps of conjugate gradients; 0 gives the weighted means. A step costs a render of every view and its
            backward pass.
        damping: Pulls each colour towards its weighted mean, with this share of its own weight.
        largest: Whether pixels count where their view shows a place largest; all count alike otherwise.
        keep: Whether harmonics above degree 0 stay as they are.
        alpha: Opacity of the targets; where it is 0 they show the renderer's background.
    """
    if gaussians.means.shape[0] != 1 or cameras.world_from_camera.shape[:2] != (1, len(targets)):
        raise UserError(
            f"fit_colors got Gaussians of {gaussians.means.shape[0]} scenes, cameras "
            f"{tuple(cameras.world_from_camera.shape[:2])} and {len(targets)} targets; "
            "give one scene and a camera a target"
        )
    if cameras.size != tuple(targets.shape[-2:]):
        raise UserError(f"targets of {tuple(targets.shape[-2:])} and cameras for {cameras.size}; resize one of the two")
    if alpha is not None:
        nothing = replace(gaussians, opacities=torch.zeros_like(gaussians.opacities))
        with torch.no_grad():
            targets = renderer(nothing, cameras.select([0])).color[0].lerp(targets, alpha[:, None].to(targets))
    system = _system(gaussians, cameras, renderer)
    higher = gaussians.harmonics[0, :, 1:] if keep else gaussians.harmonics[0, :, :0]
    if higher.shape[1]:
        targets = torch.stack([target - system.change_by(view, higher) for view, target in enumerate(targets)])
    if largest:
        system = system.confident
    weights = system.weights
    known, nearest = system.neighbors
    if not known.any():
        return replace(gaussians, harmonics=torch.cat([gaussians.harmonics[0, :, :1], higher], dim=1)[None])
    means = system.backproject(lambda _, view: targets[view]) / weights.clamp_min(MIN_WEIGHT)[:, None]  # N 3
    missing = (1 - weights / EVIDENCE).clamp_min(0)
    means[~known] = means[~known].lerp(means[known][nearest].mean(1), missing[~known, None])
    pull = damping * weights + EVIDENCE * missing
    colors = _conjugate_gradients(system, targets, means, pull, steps) if steps else means
    constant = constant_from_rgb(colors.clamp(0, 1))
    return replace(gaussians, harmonics=torch.cat([constant[:, None], higher], dim=1)[None])


def covering_views(gaussians: Gaussians, cameras: Cameras, renderer: Renderer, *, share: float, most: int) -> list[int]:
    """Few views that show what all show, chosen greedily.

    They are at least one, also where no view shows anything. A Gaussian is shown once it covers half as many pixels
    of a chosen view as of the view in which it is largest.

    Args:
        gaussians: A batch of one scene.
        cameras: A batch of one scene.
        renderer: Differentiable in colours.
        share: The fraction to be shown of the pixels that Gaussians cover where they are largest, in (0, 1].
        most: Views at most.
    """
    system = _System(_frozen(gaussians), cameras.detach(), renderer)

    def choose() -> tuple[_System, list[int]]:
        every = -(-gaussians.means.shape[1] // COUNTED)
        pixels = torch.stack([system.covered(view)[::every].clone() for view in system.views])  # V N
        largest = pixels.amax(0)
        shown, so_far, chosen = pixels.mul_(2).minimum(largest), torch.zeros_like(largest), list[int]()
        while not chosen or (len(chosen) < min(most, len(shown)) and so_far.sum() < share * largest.sum()):
            chosen.append(int(shown.maximum(so_far).sum(1).argmax()))
            so_far = so_far.maximum(shown[chosen[-1]])
        system.forget_others(chosen)
        return system, sorted(chosen)

    return _COVERS.get((*_identity(system), share, most), choose)[1]


def pixels_shown(gaussians: Gaussians, cameras: Cameras, renderer: Renderer) -> Float[Tensor, "V N"]:
    """How many pixels of each view each Gaussian covers, of a batch of one."""
    system = _system(gaussians, cameras, renderer)
    return torch.stack([system.covered(view) for view in system.views])


def largest_shown(gaussians: Gaussians, cameras: Cameras, renderer: Renderer) -> Float[Tensor, "V 1 H W"]:
    """How much each pixel of each view counts in :func:`fit_colors` with ``largest``."""
    confidence = _system(gaussians, cameras, renderer).confident.confidence
    assert confidence is not None
    return torch.stack(confidence)


def first_render(gaussians: Gaussians, camera: Cameras, renderer: Renderer) -> Renders:
    """The render of a view whose colours will be solved for: the linear view is made at once, and kept if it fits."""
    return _System(_frozen(gaussians), camera.detach(), renderer).linear(0).render


def kept_render(gaussians: Gaussians, camera: Cameras, renderer: Renderer) -> Float[Tensor, "3 H W"] | None:
    """The render of a view by its linear view, if that is kept, as those are that colours were solved for with.

    ``None`` where it is not, and where colours depend on the direction.
    """
    with suppress(KeyError):
        made = _VIEWS[_views_key(gaussians, camera, renderer)][2][_bytes(camera)[0]]
        if gaussians.harmonics.shape[2] == 1 and not isinstance(made, _Differentiated):
            return (made(rgb_from_constant(gaussians.harmonics[0, :, 0]).clamp_min(0)) + made.background).clamp(0, 1)
    return None


def _conjugate_gradients(
    system: "_System",
    targets: Float[Tensor, "V 3 H W"],
    means: Float[Tensor, "N 3"],
    pull: Float[Tensor, " N"],
    steps: int,
) -> Float[Tensor, "N 3"]:
    """Solve ``(AᵀA + P) c = Aᵀ targets + P means`` with ``P = diag(pull)``, for each channel, beginning at the means.

    The sums of rows of ``Aᵀ``, which where pixels are opaque are those of ``AᵀA`` too, and ``P`` precondition it.
    """
    inverse = 1 / (system.weights + pull)[:, None]
    colors = means
    residual = system.backproject(lambda linear, view: targets[view] - linear.background - linear(colors))
    direction = inverse * residual
    energy = (residual * direction).sum(0)  # 3
    for step in range(steps):
        curvature = system.backproject(lambda linear, _, change=direction: linear(change)) + pull[:, None] * direction
        length = energy / (direction * curvature).sum(0).clamp_min(1e-20)
        colors = colors + length * direction
        if step + 1 == steps:
            break
        residual = residual - length * curvature
        previous, energy = energy, (residual * inverse * residual).sum(0)
        direction = inverse * residual + energy / previous.clamp_min(1e-20) * direction
    return colors


class _Differentiated(LinearView):
    """The linear view of any renderer that is differentiable in colours: a backward pass is its transpose."""

    def __init__(self, gaussians: Gaussians, camera: Cameras, renderer: Renderer) -> None:
        def render(colors: Float[Tensor, "N 3"]) -> Float[Tensor, "3 H W"]:
            return renderer(replace(gaussians, harmonics=constant_from_rgb(colors)[None, :, None]), camera).color[0, 0]

        # Colours far from both cuts: of those below 0, and of renders above 1.
        self._render, self._gray = render, gaussians.means.new_full(gaussians.means.shape[1:], 0.5).requires_grad_()
        with torch.enable_grad():
            self._image = render(self._gray)
        self._given = gaussians, camera, renderer
        with torch.no_grad():
            self.background = render(torch.zeros_like(self._gray))
        self.nbytes = 100 * len(self._gray)  # measured

    def __call__(self, colors: Float[Tensor, "N 3"]) -> Float[Tensor, "3 H W"]:
        scale = colors.abs().amax(0).clamp_min(1e-20) / 0.45  # 3
        with torch.no_grad():
            return (self._render(0.5 + colors / scale) - self._image) * scale[:, None, None]

    @cached_property
    def render(self) -> Renders:  # pyright: ignore[reportIncompatibleVariableOverride]
        gaussians, camera, renderer = self._given
        with torch.no_grad():
            return renderer(gaussians, camera)

    def transposed(self, pixels: Float[Tensor, "3 H W"]) -> Float[Tensor, "N 3"]:
        return torch.autograd.grad(self._image, self._gray, pixels, retain_graph=True)[0]


@dataclass(frozen=True)
class _System:
    """The linear views ``A`` of some views.

    With ``confidence`` of the pixels of each view, ``Aᵀ`` is ``Aᵀ diag(confidence)`` everywhere: the weights of
    squared errors.
    """

    gaussians: Gaussians
    cameras: Cameras
    renderer: Renderer
    confidence: tuple[Float[Tensor, "1 H W"], ...] | None = None

    @property
    def views(self) -> range:
        return range(self.cameras.intrinsics.shape[1])

    @cached_property
    def confident(self) -> "_System":
        """The same with confidence in what a view shows larger than all others."""
        most = self.covered(0)
        largest = torch.zeros_like(most, dtype=torch.long)
        for view in self.views[1:]:
            covered = self.covered(view)
            largest.masked_fill_(covered > most, view)
            most = most.maximum(covered)

        def share(view: int) -> Float[Tensor, "1 H W"]:
            return self.linear(view)((largest == view).to(most)[:, None].expand(-1, 3))[:1].clamp(0, 1)

        return replace(self, confidence=tuple((share(view) + MIN_CONFIDENCE).square() for view in self.views))

    def linear(self, view: int) -> LinearView:
        """``A`` of one view."""
        kept, key = self._kept, self._keys[view]
        if key in kept:
            return kept[key]
        given = self.gaussians, self.cameras.select([view])
        made = self.renderer.linear_view(*given) or _Differentiated(*given, self.renderer)
        if sum(each.nbytes for each in kept.values()) + made.nbytes <= KEPT:
            kept[key] = made
        return made

    def forget_others(self, views: list[int]) -> None:
        """Make room in memory where linear views of some views, which will be needed, have none."""
        needed = {self._keys[view] for view in views}
        for key in self._kept.keys() - needed if not needed <= self._kept.keys() else ():
            del self._kept[key]

    @cached_property
    def _keys(self) -> list[bytes]:
        return _bytes(self.cameras)

    @property
    def _kept(self) -> dict[bytes, LinearView]:
        key = _views_key(self.gaussians, self.cameras, self.renderer)
        return _VIEWS.get(key, lambda: (self.gaussians, self.renderer, {}))[2]

    def covered(self, view: int) -> Float[Tensor, " N"]:
        """How many pixels of one view each Gaussian covers."""
        return self.linear(view).transposed(self.gaussians.means.new_ones(3, *self.cameras.size))[:, 0]

    def change_by(self, view: int, higher: Float[Tensor, "N K 3"]) -> Float[Tensor, "3 H W"]:
        """What harmonics above degree 0 add to a view of grey."""
        harmonics, linear = F.pad(higher, (0, 0, 1, 0))[None], self.linear(view)
        with torch.no_grad():
            render = self.renderer(replace(self.gaussians, harmonics=harmonics), self.cameras.select([view]))
        return render.color[0, 0] - linear.background - linear(torch.full_like(higher[:, 0], 0.5))

    def backproject(self, pixels: Callable[[LinearView, int], Float[Tensor, "3 H W"]]) -> Float[Tensor, "N 3"]:
        """``Aᵀ`` of what ``pixels`` gives for each view."""
        total = torch.zeros_like(self.gaussians.means[0])
        for view in self.views:
            linear = self.linear(view)
            seen = pixels(linear, view)
            total += linear.transposed(seen if self.confidence is None else seen * self.confidence[view])
        return total

    @cached_property
    def weights(self) -> Float[Tensor, " N"]:
        """How many pixels each Gaussian covers in all views together."""
        ones = self.gaussians.means.new_ones(3, *self.cameras.size)
        return self.backproject(lambda *_: ones)[:, 0]

    @cached_property
    def neighbors(self) -> tuple[Bool[Tensor, " N"], Int[Tensor, "M K"]]:
        """Which Gaussians the views show enough of, and the nearest of these to each of the others."""
        known, means = self.weights >= EVIDENCE, self.gaussians.means[0]
        count = min(NEIGHBORS, int(known.sum()))
        if not count or bool(known.all()):
            return known, torch.zeros(int((~known).sum()), 1, dtype=torch.long, device=known.device)
        _, nearest = KDTree(means[known].cpu().numpy()).query(means[~known].cpu().numpy(), k=count)
        return known, torch.from_numpy(nearest).view(-1, count).to(known.device)


_SYSTEMS: LRUCache[tuple[object, ...], _System] = LRUCache(1)
"""That of the last scene: its weights and neighbours serve every style."""
_COVERS: LRUCache[tuple[object, ...], tuple[_System, list[int]]] = LRUCache(1)
_VIEWS: LRUCache[tuple[object, ...], tuple[Gaussians, Renderer, dict[bytes, LinearView]]] = LRUCache(1)
"""Those of the last scene by their camera."""


def _frozen(gaussians: Gaussians) -> Gaussians:
    """The Gaussians without gradients. Tensors that learn are copied: not every step raises their version counter."""
    return gaussians.map(lambda tensor: tensor.detach().clone() if tensor.requires_grad else tensor.detach())


def _system(gaussians: Gaussians, cameras: Cameras, renderer: Renderer) -> _System:
    system = _System(_frozen(gaussians), cameras.detach(), renderer)
    return _SYSTEMS.get(_identity(system), lambda: system)


def _identity(system: _System) -> tuple[object, ...]:
    gaussians, cameras = system.gaussians, system.cameras
    return (type(gaussians), *_places(*vars(gaussians).values()), *system._keys, cameras.size, id(system.renderer))


def _views_key(gaussians: Gaussians, cameras: Cameras, renderer: Renderer) -> tuple[object, ...]:
    """What linear views depend on besides their cameras: colours are not of it."""
    shapes = gaussians.means, gaussians.rotations, gaussians.scales, gaussians.opacities
    return (type(gaussians), *_places(*shapes), cameras.size, id(renderer))


def _places(*tensors: Tensor) -> tuple[object, ...]:
    # What is cached holds its Gaussians, so that no others can lie where they do.
    return tuple((tensor.data_ptr(), tensor.shape, tensor._version) for tensor in tensors)


def _bytes(cameras: Cameras) -> list[bytes]:
    poses, lenses = (tensor[0].cpu().numpy() for tensor in (cameras.world_from_camera, cameras.intrinsics))
    return [pose.tobytes() + lens.tobytes() for pose, lens in zip(poses, lenses, strict=True)]


def colors_alone(views: Views, color: Float[Tensor, "B V H W 3 K"] | None = None) -> Scene:
    """Views with cameras as ``placement=color`` reads them: colours; no tokens, depth or Gaussians.

    ``color`` are harmonics of pixels to take in place of those of the images.
    """
    if views.cameras is None:
        raise UserError("placement=color encodes views with cameras, and these have none")
    pixels = torch.zeros_like(views.images[:, :, 0])
    return Scene(
        views=views,
        stem=Tokens(pixels.new_zeros(*pixels.shape[:2], 0, 0), grid=(0, 0)),
        features={},
        geometry=Geometry(views.cameras, pixels, pixels),
        attributes=Attributes(
            opacity=pixels,
            scale=pixels[..., None].expand(*pixels.shape, 3),
            rotation=torch.tensor([1.0, 0.0, 0.0, 0.0]).to(pixels).expand(*pixels.shape, 4),
            color=constant_from_rgb(views.images.movedim(2, -1))[..., None] if color is None else color,
        ),
        clusters=None,
    )


def with_gaussians(
    scene: Scene, gaussians: Gaussians, cameras: Cameras, renders: list[Renders], images: Float[Tensor, "1 V 3 H W"]
) -> Scene:
    """A scene with given Gaussians: their depth and opacity in its cameras, and the colours of images to be styled."""
    alpha = torch.cat([render.alpha for render in renders], dim=1)
    depth = torch.cat([render.depth for render in renders], dim=1) / alpha.clamp_min(1e-6)
    color = constant_from_rgb(images.movedim(2, -1))[..., None].to(scene.attributes.color.dtype)
    geometry, attributes = Geometry(cameras, depth, alpha), replace(scene.attributes, color=color)
    return replace(scene, geometry=geometry, attributes=attributes, clusters=None, gaussians=gaussians)
