"""Cameras refined while a scene is fitted through them: a small motion of each, and the focal length of each lens."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import avg_pool2d

from anystyle.errors import UserError
from anystyle.geometry.transforms import matrix_from_vector
from anystyle.types import Cameras

logger = logging.getLogger(__name__)
REACH, MAX_RATE, LEFT = 0.03, 2e-3, 0.1
"""How far a camera may go in a fit, about, in radians and median depths; the largest learning rate, and which fraction
of it is left at the end."""
BETAS = 0.9, 0.99
"""Of Adam, for each camera by itself: it takes a step only when the fit does at its photograph."""
PRIOR = 0.1
"""Weight of the squared motion, against the loss of one photograph: plain ones stay where they were found."""
PIXEL, ITERATIONS, ENOUGH = 0.5, 8, 1e-3
"""Of the alignment to a photograph: pixels that a step of finite differences moves it by, about; iterations at most;
the gain of one, relative to the squared error, below which no other follows."""


class RefinedCameras:
    """Given cameras, each turned and moved in its own axes, and lenses with a factor of their focal length.

    Args:
        given: What the motions begin at.
        unit: The length of a translation of 1: the median depth, so that it moves a picture as a rotation of 1 does.
        lenses: Whether focal lengths are refined; cameras of the same intrinsics have one lens.
    """

    def __init__(self, given: Cameras, unit: float, *, lenses: bool = False) -> None:
        self.given, self.unit = given, unit
        poses = given.world_from_camera
        sizes = {"poses": 6, "focal lengths": 1} if lenses else {"poses": 6}
        self.values = {name: poses.new_zeros(poses.shape[1], size).requires_grad_() for name, size in sizes.items()}
        self.moments = {name: poses.new_zeros(2, *value.shape) for name, value in self.values.items()}
        self.visits = [0] * poses.shape[1]
        _, lens = torch.unique(given.intrinsics[0].flatten(1), dim=0, return_inverse=True)
        same = (lens[:, None] == lens).to(poses)
        self.share = same / same.sum(1)

    def cameras(self, views: Sequence[int], values: dict[str, Tensor] | None = None) -> Cameras:
        """The cameras of some views, differentiable in the values."""
        values, index = values or self.values, list(views)
        given, motions = self.given.select(index), values["poses"][index]
        pose = given.world_from_camera[0]
        turned = pose[:, :3, :3] @ matrix_from_vector(motions[:, :3])
        center = pose[:, :3, 3] + self.unit * (pose[:, :3, :3] @ motions[:, 3:, None])[..., 0]
        moved = torch.cat([torch.cat([turned, center[..., None]], 2), pose[:, 3:]], 1)[None]
        if "focal lengths" not in values:
            return replace(given, world_from_camera=moved)
        factor = (self.share[index] @ values["focal lengths"]).exp()[..., None]
        focal = torch.diag(factor.new_tensor([1.0, 1.0, 0.0]))
        return Cameras(moved, given.intrinsics * (1 + focal * (factor - 1)), given.size)

    @torch.no_grad()
    def now(self) -> Cameras:
        """All cameras as they are."""
        return self.cameras(range(len(self.visits)))

    @torch.no_grad()
    def step(self, view: int, rate: float, training: list[int]) -> None:
        """Take a step of Adam with one camera; the frame and the unit of all that are trained stay."""
        self.visits[view] += 1
        for name, value in self.values.items():
            if value.grad is None:
                raise UserError(
                    f"the renderer gives no gradient of {name}; choose renderer=cpu or reconstruction.refine=none"
                )
            gradient = value.grad[view] + PRIOR * value[view]
            for moment, power, beta in zip(self.moments[name], (1, 2), BETAS, strict=True):
                moment[view].lerp_(gradient**power, 1 - beta)
            first, second = (
                moment[view] / (1 - beta ** self.visits[view])
                for moment, beta in zip(self.moments[name], BETAS, strict=True)
            )
            value[view] -= rate * first / (second.sqrt() + 1e-12)
            value.grad = None
        self._keep_frame(training)

    def _keep_frame(self, training: list[int]) -> None:
        """Take the mean rotation, translation and growth off, which the scene could follow: renders stay."""
        poses, motions = self.given.world_from_camera[0, training], self.values["poses"].detach()
        rotation, center = poses[:, :3, :3], poses[:, :3, 3] - poses[:, :3, 3].mean(0)
        turn, shift = (torch.einsum("vij,vj->vi", rotation, part) for part in motions[training].split(3, dim=1))
        mean = turn.mean(0)
        shift = self.unit * shift - torch.linalg.cross(mean.expand_as(center), center)
        shift = shift - shift.mean(0)
        shift = shift - center * (shift * center).sum() / center.square().sum().clamp_min(1e-12)
        back = [torch.einsum("vij,vi->vj", rotation, part) for part in (turn - mean, shift / self.unit)]
        motions[training] = torch.cat(back, dim=1)

    def moved(self, views: list[int]) -> float:
        """The root mean square of how far cameras were turned, moved and zoomed, in radians and units."""
        values = torch.cat([value.detach() for value in self.values.values()], dim=1)
        return float(values[views].square().sum(1).mean().sqrt())

    @torch.no_grad()
    def align(
        self,
        view: int,
        render: Callable[[Cameras], Float[Tensor, "1 3 H W"]],
        photograph: Float[Tensor, "1 3 H W"],
        measured: Bool[Tensor, "1 H W"] | None = None,
        window: int = 1,
    ) -> None:
        """Move one camera to where a scene that stays as it is looks most like its photograph (Levenberg-Marquardt).

        Differences are averaged over windows of so many pixels: wide ones find a photograph that is far off.
        """
        motions = self.values["poses"].detach()
        weight = 1.0 if measured is None else measured[:, None].to(photograph)
        size = (photograph.shape[-2], photograph.shape[-1])

        def residual(motion: Tensor) -> Tensor:
            values = {**self.values, "poses": motions.index_put((torch.tensor(view),), motion)}
            off = (render(self.cameras([view], values).resized(size)) - photograph) * weight
            return avg_pool2d(off, window).flatten()

        steps = PIXEL / float(self.given.resized(size).intrinsics[0, view, 0, 0]) * torch.eye(6).to(motions)
        now, damping = residual(motions[view]), 1e-3
        slopes: Tensor | None = None
        for _ in range(ITERATIONS):
            if slopes is None:
                columns = [(residual(motions[view] + step) - now) / step.sum() for step in steps]
                slopes = torch.stack(columns, dim=1).double()
            normal = slopes.T @ slopes
            normal += damping * normal.diagonal().diag()
            motion = motions[view] - torch.linalg.solve(normal, slopes.T @ now.double()).to(motions)
            after = residual(motion)
            gain = 1 - float(after.square().sum() / now.square().sum())
            if gain > 0:
                motions[view], now, slopes, damping = motion, after, None, damping / 10
            else:
                damping *= 10
            if 0 < gain < ENOUGH:
                break

    def state_dict(self) -> dict[str, Any]:
        values = {name: value.detach() for name, value in self.values.items()}
        return {"unit": self.unit, "values": values, "moments": self.moments, "visits": self.visits}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.unit = state["unit"]
        self.values = {name: value.requires_grad_() for name, value in state["values"].items()}
        self.moments, self.visits = state["moments"], list(state["visits"])


def report(given: Cameras, refined: Cameras, aligned_psnr: float | None) -> dict[str, float]:
    """Measures of how far cameras moved on average, which the log says, and the PSNR with those held out aligned."""
    turned, moved = difference(given, refined)
    logger.info("refined cameras moved by %.3f° and %.2f%% of their radius on average", turned, 100 * moved)
    measures = {"cameras_turned_degrees": turned, "cameras_moved": moved}
    return measures | ({} if aligned_psnr is None else {"heldout_aligned_psnr": aligned_psnr})


def difference(given: Cameras, refined: Cameras) -> tuple[float, float]:
    """How far cameras moved on average, in degrees and relative to their mean distance from their centre."""
    first, second = given.world_from_camera[0].double(), refined.world_from_camera[0].double()
    # Of the chord, which is exact for small angles.
    chord = (first[:, :3, :3] - second[:, :3, :3]).flatten(1).norm(dim=1) / 8**0.5
    centers = first[:, :3, 3]
    radius = (centers - centers.mean(0)).norm(dim=1).mean().clamp_min(1e-12)
    shift = (centers - second[:, :3, 3]).norm(dim=1)
    return float(torch.rad2deg(2 * chord.clamp_max(1).asin()).mean()), float(shift.mean() / radius)
