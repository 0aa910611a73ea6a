"""What is read off the tokens: cameras by VGGT's camera head, depth, and one raw Gaussian a pixel."""

from collections.abc import Iterable

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle import contracts
from anystyle.nn.attention import Block, Mlp
from anystyle.types import Attributes, Cameras
from anystyle_backbones.heads import CameraRegressor, DptGaussians, centred_cameras, rotation_of


class CameraHead(CameraRegressor):
    """Predicts each view's pose encoding from its camera token, in ``iterations`` passes through ``trunk``."""

    def __init__(self, dim: int, trunk: Iterable[Block], *, iterations: int, focal_epsilon: float) -> None:
        super().__init__()
        self.iterations, self.focal_epsilon = iterations, focal_epsilon
        self.token_norm = nn.LayerNorm(dim)
        self.trunk = nn.ModuleList(trunk)
        self.trunk_norm = nn.LayerNorm(dim)
        self.empty_pose_tokens = nn.Parameter(torch.zeros(1, 1, 9))
        self.embed_pose = nn.Linear(9, dim)
        self.modulation = nn.Linear(dim, 3 * dim)
        self.pose_branch = Mlp(dim, dim // 2, 9)

    def forward(self, camera_tokens: Float[Tensor, "B V C"]) -> Float[Tensor, "I B V 9"]:
        """Encodings after each pass, the last being the result (:func:`anystyle_backbones.heads.rotation_of`)."""
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

    def cameras(self, tokens: Float[Tensor, "B V C"], size: tuple[int, int]) -> Cameras:
        encoding = self(tokens)[-1].float()
        camera_from_world = rotation_of(encoding)
        origin = (-camera_from_world.mT @ encoding[..., :3, None])[..., 0]
        tangent = (encoding[..., 7:] / 2).tan() + self.focal_epsilon
        return centred_cameras(camera_from_world.mT, origin, tangent, size)


class GaussianHead(DptGaussians, contracts.GaussianHead):
    """A DPT whose decoded map is joined by features of the image itself, which a convolution computes.

    The channels of the result: opacity (1), scale (3), quaternion xyzw (4), harmonics (3 K, colour-major), and the
    confidence (1) that weighs pixels where they are fused.
    """

    def image_features(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M p C"]:
        # Channels lie side by side, so that pixels as tokens are a view: nothing is copied, with or without style.
        features = self.direct(images.contiguous(memory_format=torch.channels_last))
        return F.relu_(features).movedim(1, -1).flatten(1, 2)

    def attributes(self, raw: Float[Tensor, "B V H W F"]) -> Attributes:
        return Attributes(
            opacity=raw[..., 0],
            scale=raw[..., 1:4],
            rotation=raw[..., 4:8],
            color=raw[..., 8:-1].unflatten(-1, (3, self.coefficients)),
            confidence=raw[..., -1],
        )
