"""The networks: DINOv2 with registers, VGGT's attention within each view and across all, and the heads behind it.

The heads read cameras, by VGGT's camera head, depth, and one raw Gaussian a pixel off the tokens.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle import contracts
from anystyle.nn.attention import Block, Mlp
from anystyle.nn.tokens import grid_of, normalised
from anystyle.types import Attributes, Cameras, Features, Inject, Site, Tokens, untouched
from anystyle_backbones.blocks import grid_rotary, run, start_as_dino, with_norms
from anystyle_backbones.heads import CameraRegressor, DptGaussians, centred_cameras, positions, rotation_of
from anystyle_backbones.reference_view import Strategy, is_reference, reference_view


class DinoV2(nn.Module):
    """DINOv2's vision transformer with registers.

    ``grid`` is the side, in patches, that position embeddings are stored for; ``registers`` are dropped at the end.
    """

    def __init__(self, dim: int, blocks: Iterable[Block], *, patch_size: int, grid: int, registers: int = 4) -> None:
        super().__init__()
        self.proj = nn.Conv2d(3, dim, patch_size, stride=patch_size)
        self.cls_token = nn.Parameter(torch.empty(1, 1, dim))
        self.register_tokens = nn.Parameter(torch.empty(1, registers, dim))
        self.pos_embed = nn.Parameter(torch.empty(1, 1 + grid**2, dim))
        self.blocks = nn.ModuleList(blocks)
        self.norm = nn.LayerNorm(dim, eps=1e-6)
        nn.init.normal_(self.cls_token, std=1e-6)
        nn.init.normal_(self.register_tokens, std=1e-6)
        nn.init.trunc_normal_(self.pos_embed, std=0.02)
        start_as_dino(self)

    def forward(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M p C"]:
        """Embed normalised images; only the patches' tokens are returned, in row-major order."""
        patches = self.proj(images)
        grid = patches.shape[-2], patches.shape[-1]
        places = positions(self.pos_embed, grid, size=grid, antialias=True).to(patches.dtype)
        special = self.cls_token + places[:, :1], self.register_tokens
        leading = [each.expand(len(images), -1, -1) for each in special]
        tokens = torch.cat([*leading, places[:, 1:] + patches.flatten(2).mT], dim=1)
        for block in self.blocks:
            tokens = block(tokens)
        return self.norm(tokens)[:, -grid[0] * grid[1] :]


class Patches(nn.Module):
    """A linear embedding of patches, with no transformer behind it."""

    def __init__(self, dim: int, patch_size: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(3, dim, patch_size, stride=patch_size)

    def forward(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M p C"]:
        """Embed normalised images, patches in row-major order."""
        return self.conv(images).flatten(2).mT


class Embedder(contracts.Embedder):
    """Patch tokens of each view behind a camera token and register tokens.

    The reference view has camera and register tokens of its own; all others share theirs.

    Options are explained at :class:`~anystyle_backbones.anysplat.AnySplat`.
    """

    def __init__(
        self, dim: int, patches: DinoV2 | Patches, *, registers: int, patch_size: int, reference: Strategy
    ) -> None:
        super().__init__()
        self.patch_size, self.patches = patch_size, patches
        self.reference: Strategy = reference
        self.camera_token = nn.Parameter(torch.empty(1, 2, 1, dim))
        self.register_token = nn.Parameter(torch.empty(1, 2, registers, dim))
        nn.init.normal_(self.camera_token, std=1e-6)
        nn.init.normal_(self.register_token, std=1e-6)

    def forward(self, images: Float[Tensor, "B V 3 H W"]) -> Tokens:
        """Embed sRGB images in [0, 1]."""
        batch, views = images.shape[:2]
        grid = grid_of(images, self.patch_size)
        pixels = normalised(images.to(self.camera_token.dtype))
        patches = self.patches(pixels.flatten(0, 1)).unflatten(0, (batch, views))
        tokens = Tokens(patches, grid, reference=reference_view(images, patches.mean(2), self.reference))
        special = torch.cat([self.camera_token, self.register_token], dim=2)[0]  # 2 special C
        special = torch.where(is_reference(tokens)[..., None, None], *special).to(patches.dtype)  # B V special C
        return replace(tokens, data=torch.cat([special, patches], dim=2), special=special.shape[2])


class Aggregator(contracts.Aggregator):
    """Pairs of a frame block, which sees one view, and a global block, which sees all.

    Style may enter ahead of every pair, on the residual stream; the published method uses the first layer and those
    that heads read. A tapped feature is the outputs of both blocks of the layer, side by side in the channels.

    Options are explained at :class:`~anystyle_backbones.anysplat.AnySplat`; ``make_block`` makes one block.
    """

    def __init__(
        self,
        dim: int,
        make_block: Callable[[], Block],
        *,
        depth: int,
        rope_base: float,
        taps: Sequence[int],
        checkpointing: bool,
    ) -> None:
        super().__init__()
        self.dim, self.rope_base, self.checkpointing = dim, rope_base, checkpointing
        self.taps = tuple(taps)
        frame_blocks, global_blocks = ([make_block() for _ in range(depth)] for _ in range(2))
        self.head_dim = dim // frame_blocks[0].attn.heads
        self.frame_blocks, self.global_blocks = nn.ModuleList(frame_blocks), nn.ModuleList(global_blocks)

    @property
    def sites(self) -> tuple[Site, ...]:
        """``aggregator/<layer>`` for every layer."""
        return tuple(
            Site(f"aggregator/{layer}", self.dim, tapped=layer == 0 or layer in self.taps)
            for layer in range(len(self.frame_blocks))
        )

    def forward(self, stem: Tokens, inject: Inject = untouched) -> Features:
        """Turn the stem into tapped features; no other layer's output is kept."""
        batch, views = stem.data.shape[:2]
        angles = grid_rotary(stem.grid, stem.special, self.head_dim, self.rope_base, stem.data.device, stem.data.dtype)
        pairs = list(zip(self.frame_blocks, self.global_blocks, strict=True))
        turned = iter(with_norms(chain.from_iterable(pairs), angles))
        apply = partial(run, recompute=self.checkpointing and self.training)
        features: dict[int, Tokens] = {}
        tokens = stem
        for layer, (frame_block, global_block) in enumerate(pairs):
            tokens = inject(f"aggregator/{layer}", tokens)
            framed = apply(frame_block, tokens.data.flatten(0, 1), next(turned)).unflatten(0, (batch, views))
            joint = apply(global_block, framed.flatten(1, 2), next(turned))  # B VP C
            tokens = tokens.with_data(joint.unflatten(1, (views, -1)))
            if layer in self.taps:
                features[layer] = tokens.with_data(torch.cat([framed, tokens.data], dim=-1))
        return features


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
        condition, passes = self.empty_pose_tokens, list[Tensor]()
        for _ in range(self.iterations):
            shift, scale, gate = self.modulation(F.silu(self.embed_pose(condition))).chunk(3, dim=-1)
            x = torch.addcmul(tokens, gate, torch.addcmul(shift, plain, 1 + scale))
            for block in self.trunk:
                x = block(x)
            change = self.pose_branch(self.trunk_norm(x))
            passes.append(passes[-1] + change if passes else change)
            condition = passes[-1].detach()
        encodings = torch.stack(passes)
        encodings[..., 7:].relu_()
        return encodings

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
