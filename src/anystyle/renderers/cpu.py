"""The renderer for processors: compiled kernels, with gradients written by hand."""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from anystyle.contracts import Renderer
from anystyle.geometry.harmonics import degree_of, normalisation
from anystyle.geometry.projection import covariances
from anystyle.renderers import _raster, _splat
from anystyle.renderers._common import check, over
from anystyle.types import Cameras, Gaussians, Renders

CHUNK = 8192
"""Gaussians a job; fixed, so that no sum depends on the number of threads."""


class CpuRenderer(Renderer):
    """Tiles in compiled code, on as many threads as ``torch.get_num_threads()`` says; the same bits for any number.

    It computes in single precision and is differentiable once, in the Gaussians, the poses and the intrinsics.

    Args:
        background: Colour in [0, 1] behind the scene.
        near: Distance along z, above 0, under which centres are not seen; the published renderer's default.
        far: Distance along z over which centres are not seen.
        eps2d: Low-pass filter of a pixel: variance in pixels² added to every Gaussian in the image.
        alpha_cap: The most one Gaussian covers of a pixel: 0.999 in gsplat to 1.5.3, which the published models used,
            0.99 in gsplat 1.6.
    """

    def __init__(
        self,
        *,
        background: tuple[float, float, float] = (1.0, 1.0, 1.0),
        near: float = 1e-10,
        far: float = 1e10,
        eps2d: float = 0.3,
        alpha_cap: float = 0.999,
    ) -> None:
        self.background = background
        self.near = near
        self.far = far
        self.eps2d = eps2d
        self.alpha_cap = alpha_cap

    def __call__(self, gaussians: Gaussians, cameras: Cameras) -> Renders:
        """Render every camera of every scene.

        Raises:
            ValueError: The tensors are not on the CPU, or do not belong together.
        """
        check(gaussians, cameras, self.background, self.near)
        image = self.accumulate(gaussians, cameras).to(gaussians.means.dtype)
        return over(image, self.background)

    def accumulate(self, gaussians: Gaussians, cameras: Cameras) -> Float[Tensor, "B V 5 H W"]:
        """Red, green, blue and depth over black and before any cut, and the share of light that passes."""
        if gaussians.means.device.type != "cpu":
            raise ValueError(
                f"the renderer 'cpu' was given tensors on {gaussians.means.device}; "
                "use renderer=gsplat there, or move the Gaussians and cameras with .to('cpu')"
            )
        with torch.autocast("cpu", enabled=False):
            image = _Splatting.apply(
                gaussians.means.float(),
                covariances(gaussians.rotations.float(), gaussians.scales.float()),
                gaussians.opacities.float(),
                gaussians.harmonics.float(),
                cameras.camera_from_world.double(),
                cameras.world_from_camera[..., :3, 3].double(),
                cameras.intrinsics.double(),
                _Settings(*cameras.size, self.near, self.far, self.eps2d, self.alpha_cap),
            )
        assert isinstance(image, Tensor)
        return image


class _Settings(NamedTuple):
    height: int
    width: int
    near: float
    far: float
    eps2d: float
    alpha_cap: float


class _Scene(NamedTuple):
    """Gaussians of one scene, as the kernels read them."""

    means: np.ndarray
    covariances: np.ndarray
    opacities: np.ndarray
    harmonics: np.ndarray


class _Splats(NamedTuple):
    """The splats of one view, nearest first, and which rows of tiles they reach."""

    data: np.ndarray
    owner: np.ndarray
    lists: np.ndarray
    offsets: np.ndarray

    def members(self, row: int) -> np.ndarray:
        return self.lists[self.offsets[row] : self.offsets[row + 1]]


Run = Callable[[Callable[[int], Any], Iterable[int]], Iterator[Any]]
"""``map``, perhaps with threads; results come in order."""


@contextmanager
def _workers() -> Iterator[Run]:
    threads = torch.get_num_threads()
    if threads == 1:
        yield map
        return
    # Threads of a call end with it, so that a process can fork between calls.
    with ThreadPoolExecutor(threads) as pool:
        yield pool.map


class _Splatting(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> Tensor:
        *tensors, settings = inputs
        scenes, cameras, scale = _read(tensors)
        images = torch.empty(*cameras.shape[:2], 5, settings.height, settings.width)
        last = np.empty((*cameras.shape[:2], settings.height, settings.width), np.int32)
        with _workers() as run:
            for b, v in np.ndindex(cameras.shape[:2]):
                splats = _project(scenes[b], cameras[b, v], scale, settings, run)
                _blend(splats, settings, images[b, v].numpy(), last[b, v], run)
        ctx.save_for_backward(*tensors, images)
        ctx.last, ctx.settings = last, settings
        return images

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, d_images: Tensor) -> tuple[Tensor | None, ...]:
        *tensors, images = ctx.saved_tensors
        scenes, cameras, scale = _read(tensors)
        means, shapes, opacities, harmonics, poses, origins, intrinsics = grads = [
            torch.zeros(tensor.shape, dtype=tensor.dtype) for tensor in tensors
        ]
        with _workers() as run:
            for b, v in np.ndindex(cameras.shape[:2]):
                # Projected again, as the splats of many views would not fit; blending takes far longer.
                splats = _project(scenes[b], cameras[b, v], scale, ctx.settings, run)
                moments = _blend_backward(
                    splats, ctx.settings, images[b, v].numpy(), ctx.last[b, v], d_images[b, v].contiguous().numpy(), run
                )
                sums = (means[b].numpy(), shapes[b].numpy(), opacities[b].numpy(), harmonics[b].numpy())
                d_camera = _project_backward(scenes[b], cameras[b, v], scale, ctx.settings, splats, moments, sums, run)
                poses[b, v, :3, :3] = d_camera[:9].view(3, 3)
                poses[b, v, :3, 3] = d_camera[9:12]
                origins[b, v] = d_camera[12:15]
                intrinsics[b, v].diagonal()[:2] = d_camera[15:17]
                intrinsics[b, v, :2, 2] = d_camera[17:]
        return *grads, None


def _read(tensors: list[Tensor]) -> tuple[list[_Scene], np.ndarray, np.ndarray]:
    """The scenes, the cameras ``[B, V, 19]`` and the normalisations of the harmonics, as the kernels read them."""
    means, shapes, opacities, harmonics, poses, origins, intrinsics = (tensor.detach() for tensor in tensors)
    scenes = [
        _Scene(*(tensor[b].contiguous().numpy() for tensor in (means, shapes, opacities, harmonics)))
        for b in range(len(means))
    ]
    rotation, translation = poses[..., :3, :3].flatten(-2), poses[..., :3, 3]
    focal, center = intrinsics.diagonal(dim1=-2, dim2=-1)[..., :2], intrinsics[..., :2, 2]
    cameras = torch.cat([rotation, translation, origins, focal, center], dim=-1).contiguous().numpy()
    count = degree_of(harmonics.shape[2]) + 1
    scale = np.array([[normalisation(d, m) if m <= d else 0.0 for m in range(count)] for d in range(count)])
    return scenes, cameras, scale


def _project(scene: _Scene, camera: np.ndarray, scale: np.ndarray, settings: _Settings, run: Run) -> _Splats:
    number = len(scene.means)
    data, index = np.empty((number, _splat.SPLAT), np.float32), np.empty(number, np.int32)
    limits = np.array([settings.near, settings.far, settings.eps2d])

    def job(start: int) -> np.ndarray:
        stop = min(start + CHUNK, number)
        size = settings.width, settings.height
        count = _splat.project(*scene, camera, limits, scale, *size, start, stop, data, index)
        return np.arange(start, start + count)

    written = [*run(job, range(0, number, CHUNK))]
    rows = np.concatenate(written) if written else np.empty(0, np.int64)
    rows = rows[_splat.nearest_first(data[rows, _splat.DEPTH])]
    data, index = data[rows], index[rows]
    offsets = np.empty(-(-settings.height // _raster.TILE) + 1, np.int64)
    lists = _raster.rows_of(data, settings.height, offsets)
    return _Splats(data, index, lists, offsets)


def _blend(splats: _Splats, settings: _Settings, image: np.ndarray, last: np.ndarray, run: Run) -> None:
    def job(row: int) -> None:
        _raster.blend(splats.data, splats.members(row), row * _raster.TILE, settings.alpha_cap, image, last)

    for _ in run(job, range(len(splats.offsets) - 1)):
        pass


def _blend_backward(
    splats: _Splats, settings: _Settings, image: np.ndarray, last: np.ndarray, d_image: np.ndarray, run: Run
) -> np.ndarray:
    def job(row: int) -> np.ndarray:
        members = splats.members(row)
        moments = np.empty((len(members), _raster.MOMENTS), np.float32)
        top = row * _raster.TILE
        _raster.blend_backward(splats.data, members, top, settings.alpha_cap, image, last, d_image, moments)
        return moments

    moments = np.zeros((len(splats.data), _raster.MOMENTS), np.float32)
    for row, part in enumerate(run(job, range(len(splats.offsets) - 1))):
        moments[splats.members(row)] += part
    return moments


def _project_backward(
    scene: _Scene,
    camera: np.ndarray,
    scale: np.ndarray,
    settings: _Settings,
    splats: _Splats,
    moments: np.ndarray,
    sums: tuple[np.ndarray, ...],
    run: Run,
) -> Tensor:
    number = len(splats.data)
    d_means, d_covariances, d_opacities, d_harmonics = sums

    def job(start: int) -> np.ndarray:
        d_camera = np.zeros(19)
        stop = min(start + CHUNK, number)
        _splat.project_backward(
            scene.means, scene.covariances, scene.harmonics, camera, scale, settings.width, settings.height,
            start, stop, splats.data, splats.owner, moments,
            d_means, d_covariances, d_opacities, d_harmonics, d_camera,
        )  # fmt: skip
        return d_camera

    return torch.from_numpy(sum(run(job, range(0, number, CHUNK)), np.zeros(19)))
