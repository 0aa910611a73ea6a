"""From photographs to the tokens that enter the first alternating block."""

from dataclasses import replace
from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle import contracts
from anystyle.errors import UserError
from anystyle.nn.attention import Block, start_as_dino
from anystyle.nn.reference_view import Strategy, is_reference, reference_view
from anystyle.nn.tokens import grid_of, normalised
from anystyle.types import Cameras, Tokens
from anystyle_depth_anything.cameras import CameraEncoder

OFFSET = 0.1
"""Added to the sides of a grid of patches where position embeddings are resampled, as DINOv2 was trained."""


class Embedder(contracts.Embedder):
    """DINOv2's blocks up to the first alternating one, reference-view selection and camera tokens.

    Ahead of its last block the reference view is chosen. In the stem a camera token has taken the place of the class
    token: the reference has one of its own, all other views share theirs.

    Options are explained at :class:`~anystyle_depth_anything.DepthAnything`. ``grid`` is in patches.
    """

    def __init__(
        self,
        *,
        dim: int,
        depth: int,
        heads: int,
        ffn: Literal["mlp", "swiglu"],
        mlp_ratio: float,
        layer_scale: float,
        patch_size: int,
        grid: int,
        reference: Strategy,
        camera_encoder: CameraEncoder | None,
    ) -> None:
        super().__init__()
        self.patch_size, self.grid = patch_size, grid
        self.reference: Strategy = reference
        self.proj = nn.Conv2d(3, dim, patch_size, stride=patch_size)
        self.cls_token = nn.Parameter(torch.empty(1, 1, dim))
        self.camera_token = nn.Parameter(torch.empty(1, 2, dim))
        self.pos_embed = nn.Parameter(torch.empty(1, 1 + grid**2, dim))
        self.blocks = nn.ModuleList(
            Block(dim, heads, mlp_ratio=mlp_ratio, layer_scale=layer_scale, ffn=ffn, eps=1e-6) for _ in range(depth)
        )
        self.camera_encoder = camera_encoder
        nn.init.normal_(self.cls_token, std=1e-6)
        nn.init.normal_(self.camera_token, std=0.02)
        nn.init.trunc_normal_(self.pos_embed, std=0.02)
        start_as_dino(self.blocks)

    def forward(self, images: Float[Tensor, "B V 3 H W"], cameras: Cameras | None = None) -> Tokens:
        """Embed sRGB images in [0, 1]."""
        tokens = self.patches(images)
        for block in self.blocks[:-1]:
            tokens = self._local(block, tokens)
        if cameras is None:
            tokens = replace(tokens, reference=reference_view(images, tokens.data[:, :, 0], self.reference))
        tokens = self._local(self.blocks[-1], tokens)
        camera = self._camera_tokens(cameras, tokens).to(tokens.data.dtype)
        return tokens.with_data(torch.cat([camera[:, :, None], tokens.patches], dim=2))

    def patches(self, images: Float[Tensor, "B V 3 H W"]) -> Tokens:
        """Class token and patches, with positions added."""
        batch, views = images.shape[:2]
        grid = grid_of(images, self.patch_size)
        patches = self.proj(normalised(images.to(self.proj.weight.dtype)).flatten(0, 1)).flatten(2).mT
        cls = self.cls_token.to(patches.dtype).expand(batch * views, -1, -1)
        tokens = torch.cat([cls, patches], dim=1) + self.positions(grid).to(patches.dtype)
        return Tokens(tokens.unflatten(0, (batch, views)), grid=grid, special=1)

    def positions(self, grid: tuple[int, int]) -> Float[Tensor, "1 L C"]:
        """Position embeddings of the class token and of a grid, resampled from the stored one where it differs."""
        if grid == (self.grid, self.grid):
            return self.pos_embed
        stored = self.pos_embed[:, 1:].float().mT.unflatten(2, (self.grid, self.grid))
        rows, columns = ((side + OFFSET) / self.grid for side in grid)
        resampled = F.interpolate(stored, scale_factor=(rows, columns), mode="bicubic")
        return torch.cat([self.pos_embed[:, :1].float(), resampled.flatten(2).mT], dim=1)

    def _local(self, block: nn.Module, tokens: Tokens) -> Tokens:
        views = tokens.data.shape[1]
        return tokens.with_data(block(tokens.data.flatten(0, 1)).unflatten(0, (-1, views)))

    def _camera_tokens(self, cameras: Cameras | None, tokens: Tokens) -> Float[Tensor, "B V C"]:
        if cameras is None:
            return self.camera_token[0][1 - is_reference(tokens).long()]
        if self.camera_encoder is None:
            raise UserError("cameras are given, but this network has no encoder of them; set camera_encoder_depth")
        with torch.autocast(self.camera_token.device.type, enabled=False):
            return self.camera_encoder(cameras)
