"""Cameras from matches: an alternative to regressing them that a small network can learn."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.geometry.alignment import MatchedPoints, align
from anystyle.types import Cameras, Tokens

PIXELS = 1.5
"""Error of a match, in pixels of a 112-pixel image, from which on it counts as doubtful."""


class Aligner(nn.Module):
    """Move every camera to where its patches agree with those of the first view.

    Not in the published network, which regresses poses from camera tokens; a network of a few million parameters does
    not learn that in hours. Patches are compared by descriptors, matches are the expected places under a softmax, and
    the rigid motion that explains them is computed in closed form. It is one pass: nothing is optimised at test time.

    Args:
        dim: Channels of the tokens.
        descriptor: Channels in which patches are compared.
        temperature: Of the comparison.
    """

    def __init__(self, *, dim: int, descriptor: int = 64, temperature: float = 0.07) -> None:
        super().__init__()
        self.temperature = temperature
        self.normal = nn.LayerNorm(dim)
        self.compare = nn.Linear(dim, descriptor)

    def correlation(self, tokens: Tokens) -> Float[Tensor, "B v P P"]:
        """How alike the patches of each view after the first are to those of the first, as logits."""
        patches = tokens.patches.to(self.compare.weight.dtype)
        unit = F.normalize(self.compare(self.normal(patches)), dim=-1)
        return torch.einsum("bipd,bqd->bipq", unit[:, 1:], unit[:, 0]) / self.temperature

    @torch.no_grad()
    def forward(
        self, correlation: Float[Tensor, "B v P P"], grid: tuple[int, int], cameras: Cameras, depth: Tensor
    ) -> Float[Tensor, "B V 4 4"]:
        """Poses, the first view's at the origin and the others where they fit.

        They carry no gradient: what they are computed from, matches and depth, is taught directly, and a pose from bad
        matches would teach nothing but noise.

        Args:
            correlation: See :meth:`correlation`.
            grid: Rows and columns of patches.
            cameras: Whose intrinsics count.
            depth: Along z, of shape B V H W.
        """
        batch, views = depth.shape[:2]
        logits = correlation.float()
        likely = logits.softmax(-1)
        # A match counts if each of the two patches prefers the other.
        weight = (likely * logits.softmax(-2)).sum(-1).flatten(0, 1)
        height, width = cameras.size
        rows, columns = grid
        v = (torch.arange(rows, device=depth.device, dtype=depth.dtype) + 0.5) * height / rows
        u = (torch.arange(columns, device=depth.device, dtype=depth.dtype) + 0.5) * width / columns
        own = torch.stack(torch.meshgrid(u, v, indexing="xy"), dim=-1).flatten(0, 1)  # P 2, in pixels
        place = (likely @ own).flatten(0, 1)  # the expected place of the match in the first view
        first = slice(0, 1)
        source_ray, source = _unproject(own.expand(batch * (views - 1), -1, -1), cameras, depth, slice(1, None))
        target_ray, target = _unproject(place, cameras, depth, first)
        focal = cameras.intrinsics[:, :, 0, 0].mean()
        motion = align(
            MatchedPoints(source, target, source_ray, target_ray, weight),
            scale=float(PIXELS * width / 112 / focal),
        )
        pose = torch.eye(4, dtype=depth.dtype, device=depth.device).expand(batch, views, 4, 4).clone()
        pose[:, 1:, :3, :3] = motion.rotation.unflatten(0, (batch, views - 1))
        pose[:, 1:, :3, 3] = motion.translation.unflatten(0, (batch, views - 1))
        return pose


def _unproject(
    pixels: Float[Tensor, "M P 2"], cameras: Cameras, depth: Float[Tensor, "B V H W"], views: slice
) -> tuple[Float[Tensor, "M P 2"], Float[Tensor, "M P 3"]]:
    """Rays and points of pixels; a single view serves all rows of its scene."""
    height, width = cameras.size
    chosen, lenses = depth[:, views], cameras.intrinsics[:, views]
    count = pixels.shape[0] // depth.shape[0]
    chosen = chosen.expand(-1, count, -1, -1).flatten(0, 1)
    lenses = lenses.expand(-1, count, -1, -1).flatten(0, 1)
    grid = pixels * pixels.new_tensor([2 / width, 2 / height]) - 1
    sampled = F.grid_sample(chosen[:, None], grid[:, None], padding_mode="border", align_corners=False)[:, 0, 0]
    centre = lenses[:, None, :2, 2]
    focal = torch.stack([lenses[:, 0, 0], lenses[:, 1, 1]], dim=-1)[:, None]
    ray = (pixels - centre) / focal
    return ray, torch.cat([ray, torch.ones_like(ray[..., :1])], dim=-1) * sampled[..., None]
