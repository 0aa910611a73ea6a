"""VGGT's camera head: a pose encoding refined over a few passes of one small transformer."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.nn.attention import Block, Mlp
from anystyle.nn.pose import centred_cameras, rotation_of
from anystyle.types import Cameras


class CameraHead(nn.Module):
    """Predicts each view's pose encoding from its camera token.

    Options are explained at :class:`~anystyle_anysplat.AnySplat`.
    """

    def __init__(
        self, *, dim: int, depth: int, heads: int, mlp_ratio: float, layer_scale: float, iterations: int
    ) -> None:
        super().__init__()
        self.iterations = iterations
        self.token_norm = nn.LayerNorm(dim)
        self.trunk = nn.ModuleList(
            Block(dim, heads, mlp_ratio=mlp_ratio, layer_scale=layer_scale) for _ in range(depth)
        )
        self.trunk_norm = nn.LayerNorm(dim)
        self.empty_pose_tokens = nn.Parameter(torch.zeros(1, 1, 9))
        self.embed_pose = nn.Linear(9, dim)
        self.modulation = nn.Linear(dim, 3 * dim)
        self.pose_branch = Mlp(dim, dim // 2, 9)

    def forward(self, camera_tokens: Float[Tensor, "B V C"]) -> Float[Tensor, "I B V 9"]:
        """The encodings after each pass; the last is the result (layout: :mod:`anystyle.nn.pose`)."""
        tokens = self.token_norm(camera_tokens)
        plain = F.layer_norm(tokens, tokens.shape[-1:], eps=1e-6)
        encoding = torch.zeros_like(tokens[..., :9])
        condition = self.empty_pose_tokens.expand_as(encoding)
        passes: list[Tensor] = []
        for _ in range(self.iterations):
            shift, scale, gate = self.modulation(F.silu(self.embed_pose(condition))).chunk(3, dim=-1)
            x = gate * (plain * (1 + scale) + shift) + tokens
            for block in self.trunk:
                x = block(x)
            encoding = encoding + self.pose_branch(self.trunk_norm(x))
            condition = encoding.detach()
            passes.append(torch.cat([encoding[..., :7], encoding[..., 7:].relu()], dim=-1))
        return torch.stack(passes)


def decode_pose(encoding: Float[Tensor, "B V 9"], size: tuple[int, int], *, focal_epsilon: float) -> Cameras:
    """Cameras of images of ``size`` with the principal point in the middle."""
    rotation = rotation_of(encoding)
    origin = (-rotation.mT @ encoding[..., :3, None])[..., 0]
    return centred_cameras(rotation.mT, origin, (encoding[..., 7:] / 2).tan() + focal_epsilon, size)
