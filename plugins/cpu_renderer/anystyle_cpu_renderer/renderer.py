"""The renderer for CPUs: compiled kernels with hand-written gradients."""

from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from anystyle.contracts import LinearView
from anystyle.geometry.harmonics import degree_of, normalisation
from anystyle.renderers.rasterizer import CappedRasterizer, at_least_single, composite
from anystyle.types import Cameras, Gaussians, Renders
from anystyle_cpu_renderer import raster, stages
from anystyle_cpu_renderer.projection import LIMITS, CameraArrays, SceneArrays
from anystyle_cpu_renderer.raster import BlendedView, Shares


class CpuRenderer(CappedRasterizer):
    """Compiled tiles on ``torch.get_num_threads()`` threads; results are bit-identical for any number of threads.

    Computes in single precision; once differentiable in the Gaussians, the poses and the intrinsics.
    """

    devices = ("cpu",)
    priority = 10

    def accumulate(self, gaussians: Gaussians, cameras: Cameras) -> Float[Tensor, "B V 5 H W"]:
        with torch.autocast("cpu", enabled=False):
            gaussians, cameras = at_least_single(gaussians, cameras)
            tensors, settings = self._inputs(gaussians, cameras)
            image = _Splatting.apply(*tensors, settings)
        assert isinstance(image, Tensor)
        return image.to(gaussians.means.dtype)

    def _inputs(self, gaussians: Gaussians, cameras: Cameras) -> "tuple[list[Tensor], _Settings]":
        tensors = [tensor.float() for tensor in vars(gaussians).values()]
        tensors += [cameras.camera_from_world.double(), cameras.world_from_camera[..., :3, 3].double()]
        settings = _Settings(
            *cameras.size, self.near, self.far, self.eps2d, self.alpha_cap, float(gaussians.antialiased)
        )
        return [*tensors, cameras.intrinsics.double()], settings

    @torch.no_grad()
    def linear_view(self, gaussians: Gaussians, camera: Cameras) -> LinearView:
        with torch.autocast("cpu", enabled=False):
            gaussians, camera = at_least_single(gaussians, camera)
            tensors, settings = self._inputs(gaussians, camera)
            (scene,), ((view,),) = _read(tensors, settings)
        image = torch.empty(5, *camera.size)
        with stages.workers() as run:
            (scene,) = _shaped([scene], tensors, run)
            splats = stages.project(scene, view, camera.size[0], run)
            shares = stages.shares(splats, np.float32(self.alpha_cap), image.numpy(), run)
        return _Shares(shares, len(scene.means), image, self.background)


class _Shares(LinearView):
    """A sparse matrix: the share of each Gaussian in each pixel. Composited when asked, for many are held at once."""

    def __init__(
        self, shares: list[Shares], number: int, image: Float[Tensor, "5 H W"], background: tuple[float, float, float]
    ) -> None:
        self._shares, self._number, self._image, self._behind = shares, number, image, background
        self.nbytes = image.nbytes + sum(array.nbytes for part in shares for array in part)

    @property
    def render(self) -> Renders:  # pyright: ignore[reportIncompatibleVariableOverride]
        return composite(self._image[None, None], self._behind)

    @property
    def background(self) -> Float[Tensor, "3 H W"]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self._image[4] * torch.tensor(self._behind)[:, None, None]

    def __call__(self, colors: Float[Tensor, "N 3"]) -> Float[Tensor, "3 H W"]:
        height, width = self._image.shape[-2:]
        given, image = colors.detach().float().contiguous().numpy(), torch.zeros(height, width, 3)
        for part, rows in zip(self._shares, image.split(raster.HEIGHT), strict=True):
            raster.mix(part, given, rows.numpy())
        return image.movedim(-1, 0)

    def transposed(self, pixels: Float[Tensor, "3 H W"]) -> Float[Tensor, "N 3"]:
        image, colors = pixels.detach().float().movedim(0, -1).contiguous(), torch.zeros(self._number, 3)
        for part, rows in zip(self._shares, image.split(raster.HEIGHT), strict=True):
            raster.mix_transposed(part, rows.numpy(), colors.numpy())
        return colors


class _Settings(NamedTuple):
    height: int
    width: int
    near: float
    far: float
    eps2d: float
    alpha_cap: float
    antialiased: float


class _Splatting(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> Tensor:
        *tensors, settings = inputs
        scenes, views = _read(tensors, settings)
        size = len(scenes), tensors[-1].shape[1], settings.height, settings.width
        images, last = torch.empty(*size[:2], 5, *size[2:]), np.empty(size, np.int32)
        # The splats of a single view are kept for the backward pass; those of many would take too much memory, and are
        # projected again.
        keep = size[0] * size[1] == 1 and any(ctx.needs_input_grad)
        ctx.kept = []
        with stages.workers() as run:
            scenes = _shaped(scenes, tensors, run)
            for b, scene in enumerate(scenes):
                for v, view in enumerate(views[b]):
                    splats = stages.project(scene, view, settings.height, run, keep=keep)
                    cap, image = np.float32(settings.alpha_cap), images[b, v].numpy()
                    tiles = stages.blend(splats, cap, image, last[b, v], run, keep=keep)
                    if keep:
                        ctx.kept.append((splats, tiles))
        ctx.save_for_backward(*tensors, images)
        ctx.last, ctx.settings, ctx.shapes = last, settings, [scene.shapes for scene in scenes]
        return images

    @staticmethod
    @once_differentiable
    def backward(  # pyright: ignore[reportIncompatibleMethodOverride]
        ctx: Any, *grad_outputs: Tensor
    ) -> tuple[Tensor | None, ...]:
        *tensors, images = ctx.saved_tensors
        scenes, views = _read(tensors, ctx.settings)
        cap = np.float32(ctx.settings.alpha_cap)
        posed = any(ctx.needs_input_grad[5:8])
        shaped = posed or any(ctx.needs_input_grad[:4])
        sums = [torch.zeros(tensor.shape, dtype=tensor.dtype) for tensor in tensors]
        with stages.workers() as run:
            for b, scene in enumerate(scenes):
                scene = scene._replace(shapes=ctx.shapes[b])
                into = SceneArrays._make([*(total[b].numpy() for total in sums[:5]), np.zeros_like(scene.shapes)])
                for v, view in enumerate(views[b]):
                    if ctx.kept:
                        splats, tiles = ctx.kept[0]
                    else:
                        splats, tiles = stages.project(scene, view, ctx.settings.height, run), []
                    d_image = grad_outputs[0][b, v].contiguous().numpy()
                    picture = BlendedView(images[b, v].numpy(), ctx.last[b, v], d_image)
                    moments = stages.blend_backward(splats, tiles, cap, picture, shaped, run)
                    d_camera = stages.project_backward(scene, view, splats, moments, into, shaped, posed, run)
                    _write(torch.from_numpy(d_camera), *(total[b, v] for total in sums[5:]))
                if shaped:
                    stages.shape_backward(scene, into, run)
        needed = ctx.needs_input_grad[: len(sums)]
        return *(total if wanted else None for total, wanted in zip(sums, needed, strict=True)), None


def _read(tensors: list[Tensor], settings: _Settings) -> tuple[list[SceneArrays], list[list[CameraArrays]]]:
    """The arguments of the kernels: the scenes, their covariances allocated but not computed, and the views of each."""
    *gaussians, poses, origins, intrinsics = (tensor.detach() for tensor in tensors)
    rows = [[tensor[b].contiguous().numpy() for tensor in gaussians] for b in range(len(poses))]
    scenes = [SceneArrays._make([*row, np.empty((len(row[0]), 6), np.float32)]) for row in rows]
    rotation, translation = poses[..., :3, :3].flatten(-2), poses[..., :3, 3]
    focal, center = intrinsics.diagonal(dim1=-2, dim2=-1)[..., :2], intrinsics[..., :2, 2]
    cameras = torch.cat([rotation, translation, origins, focal, center], dim=-1).contiguous().numpy()
    limits = np.array([getattr(settings, name) for name in LIMITS], np.float64)
    tables = _tables(degree_of(gaussians[-1].shape[2]))
    return scenes, [[CameraArrays(camera, limits, tables) for camera in row] for row in cameras]


_SHAPES: list[tuple[Tensor, Tensor, list[np.ndarray]]] = []
"""Copies of the last rotations and scales, with their covariances; not every write raises a version counter."""


def _shaped(scenes: list[SceneArrays], tensors: list[Tensor], run: stages.Mapper) -> list[SceneArrays]:
    """The scenes with their covariances, which all views of the same Gaussians share."""
    rotations, scales = (tensor.detach() for tensor in tensors[1:3])
    for *copies, shapes in _SHAPES:
        if torch.equal(copies[0], rotations) and torch.equal(copies[1], scales):
            return [scene._replace(shapes=kept) for scene, kept in zip(scenes, shapes, strict=True)]
    for scene in scenes:
        stages.shape(scene, run)
    _SHAPES[:] = [(rotations.clone(), scales.clone(), [scene.shapes for scene in scenes])]
    return scenes


def _tables(degree: int) -> np.ndarray:
    """The tables that :func:`anystyle_cpu_renderer.projection.harmonics_slopes` takes."""
    tables = np.zeros((3, degree + 1, degree + 1))
    for n in range(degree + 1):
        for m in range(n + 1):
            tables[0, n, m] = normalisation(n, m)
            if n > m:
                tables[1:, n, m] = (2 * n - 1) / (n - m), (n + m - 1) / (n - m)
    return tables


def _write(d_camera: Tensor, d_pose: Tensor, d_origin: Tensor, d_intrinsics: Tensor) -> None:
    d_pose[:3, :3] = d_camera[:9].view(3, 3)
    d_pose[:3, 3] = d_camera[9:12]
    d_origin[:] = d_camera[12:15]
    d_intrinsics.diagonal()[:2] = d_camera[15:17]
    d_intrinsics[:2, 2] = d_camera[17:]
