"""The transformer block of ViT and DINOv2, with the two kinds of feed-forward layer that its sizes use."""

from collections.abc import Iterable
from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn
from torch.utils.checkpoint import checkpoint

from anystyle.nn.tokens import Rotary, rotate, swapped


class Attention(nn.Module):
    """Multi-head self-attention; with ``qk_norm`` queries and keys are normalised per head, ahead of the rotation.

    The gain and bias of the norms are one with the rotation; :func:`with_norms` computes that for many blocks at once.
    """

    def __init__(self, dim: int, heads: int, *, qk_norm: bool) -> None:
        super().__init__()
        self.heads = heads
        self.qkv = nn.Linear(dim, 3 * dim)
        self.q_norm = nn.LayerNorm(dim // heads) if qk_norm else nn.Identity()
        self.k_norm = nn.LayerNorm(dim // heads) if qk_norm else nn.Identity()
        self.proj = nn.Linear(dim, dim)

    def forward(self, x: Float[Tensor, "M L C"], angles: Rotary | None = None) -> Float[Tensor, "M L C"]:
        qkv = self.qkv(x).unflatten(-1, (3, self.heads, -1))  # M L 3 heads E
        qk, v = qkv[:, :, :2], qkv[:, :, 2].transpose(1, 2)
        if isinstance(self.q_norm, nn.LayerNorm):
            assert angles is not None
            qk = F.layer_norm(qk, qk.shape[-1:], eps=self.q_norm.eps)
            angles = with_norms([self], angles)[0] if angles.shift is None else angles
        qk = qk.permute(0, 2, 3, 1, 4)  # M 2 heads L E
        q, k = (qk if angles is None else rotate(qk, angles)).unbind(1)
        # Under autocast the norms leave queries and keys in another precision than values.
        mixed = F.scaled_dot_product_attention(q.to(v.dtype), k.to(v.dtype), v)
        return self.proj(mixed.transpose(1, 2).flatten(2))


def with_norms(blocks: Iterable[nn.Module], angles: Rotary) -> list[Rotary]:
    """For each :class:`Attention` in blocks the angles, with the gain and bias of its norms of queries and keys."""
    layers = [layer for block in blocks for layer in block.modules() if isinstance(layer, Attention)]
    norms = [norm for layer in layers for norm in (layer.q_norm, layer.k_norm)]
    gain, bias = (
        torch.stack([getattr(norm, name) for norm in norms]).unflatten(0, (-1, 1, 2)) for name in ("weight", "bias")
    )  # each N 1 2 E
    cos, sin = angles.cos[:, None], angles.sin[:, None]
    tables = gain * cos, swapped(gain) * sin, torch.addcmul(bias * cos, swapped(bias), sin)  # N L 2 E
    # The memory's order is that of queries and keys, which else would be copied.
    return list(map(Rotary, *(table.transpose(1, 2)[:, :, None, None] for table in tables)))


class Mlp(nn.Module):
    """Two linear layers with a GELU between."""

    def __init__(self, dim: int, hidden: int, out_dim: int) -> None:
        super().__init__()
        self.fc1 = nn.Linear(dim, hidden)
        self.fc2 = nn.Linear(hidden, out_dim)

    def forward(self, x: Float[Tensor, "*batch C"]) -> Float[Tensor, "*batch D"]:
        return self.fc2(F.gelu(self.fc1(x)))


class SwiGlu(nn.Module):
    """A gated feed-forward layer with the parameters of an MLP of ``hidden`` channels (Shazeer, arXiv 2002.05202)."""

    def __init__(self, dim: int, hidden: int) -> None:
        super().__init__()
        width = (int(hidden * 2 / 3) + 7) // 8 * 8
        self.w12 = nn.Linear(dim, 2 * width)
        self.w3 = nn.Linear(width, dim)

    def forward(self, x: Float[Tensor, "*batch C"]) -> Float[Tensor, "*batch C"]:
        gate, value = self.w12(x).chunk(2, dim=-1)
        return self.w3(F.silu(gate) * value)


class LayerScale(nn.Module):
    """A residual with a learnt gain a channel."""

    def __init__(self, dim: int, initial: float) -> None:
        super().__init__()
        self.gamma = nn.Parameter(torch.full((dim,), initial))

    def forward(self, x: Float[Tensor, "*batch C"], change: Float[Tensor, "*batch C"]) -> Float[Tensor, "*batch C"]:
        return torch.addcmul(x, change, self.gamma)


class Block(nn.Module):
    """A pre-norm transformer block, with LayerScale unless it is a plain ViT's.

    Args:
        dim: Channels.
        heads: Attention heads.
        mlp_ratio: Width of the feed-forward layer, in ``dim``.
        layer_scale: Initial LayerScale; ``None`` has none.
        ffn: Kind of the feed-forward layer.
        qk_norm: Whether queries and keys are normalised.
        eps: Epsilon of the layer norms.
    """

    def __init__(
        self,
        dim: int,
        heads: int,
        *,
        mlp_ratio: float,
        layer_scale: float | None,
        ffn: Literal["mlp", "swiglu"] = "mlp",
        qk_norm: bool = False,
        eps: float = 1e-5,
    ) -> None:
        super().__init__()
        hidden = int(dim * mlp_ratio)
        self.norm1 = nn.LayerNorm(dim, eps=eps)
        self.attn = Attention(dim, heads, qk_norm=qk_norm)
        self.ls1 = torch.add if layer_scale is None else LayerScale(dim, layer_scale)
        self.norm2 = nn.LayerNorm(dim, eps=eps)
        self.mlp = SwiGlu(dim, hidden) if ffn == "swiglu" else Mlp(dim, hidden, dim)
        self.ls2 = torch.add if layer_scale is None else LayerScale(dim, layer_scale)

    def forward(self, x: Float[Tensor, "M L C"], angles: Rotary | None = None) -> Float[Tensor, "M L C"]:
        x = self.ls1(x, self.attn(self.norm1(x), angles))
        return self.ls2(x, self.mlp(self.norm2(x)))


class MemoryAttention(nn.Module):
    """Multi-head attention of queries to a memory, both turned by their positions."""

    def __init__(self, dim: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.projq, self.projk, self.projv, self.proj = (nn.Linear(dim, dim) for _ in range(4))

    def forward(
        self, x: Float[Tensor, "M L C"], memory: Float[Tensor, "M S C"], angles: Rotary, memory_angles: Rotary
    ) -> Float[Tensor, "M L C"]:
        pairs = ((self.projq, x), (self.projk, memory), (self.projv, memory))
        q, k, v = (project(y).unflatten(-1, (self.heads, -1)).transpose(1, 2) for project, y in pairs)
        q, k = rotate(q, angles), rotate(k, memory_angles)
        mixed = F.scaled_dot_product_attention(q.to(v.dtype), k.to(v.dtype), v)
        return self.proj(mixed.transpose(1, 2).flatten(2))


class DecoderBlock(nn.Module):
    """A pre-norm block with cross-attention to a memory after its self-attention.

    Args:
        dim: Channels.
        heads: Attention heads.
        mlp_ratio: Width of the feed-forward layer, in ``dim``.
        eps: Epsilon of the layer norms.
    """

    def __init__(self, dim: int, heads: int, *, mlp_ratio: float, eps: float = 1e-5) -> None:
        super().__init__()
        self.norm1, self.norm2, self.norm3, self.norm_y = (nn.LayerNorm(dim, eps=eps) for _ in range(4))
        self.attn = Attention(dim, heads, qk_norm=False)
        self.cross_attn = MemoryAttention(dim, heads)
        self.mlp = Mlp(dim, int(dim * mlp_ratio), dim)

    def forward(
        self, x: Float[Tensor, "M L C"], memory: Float[Tensor, "M S C"], angles: Rotary, memory_angles: Rotary
    ) -> Float[Tensor, "M L C"]:
        """Tokens after the block; a memory of no tokens adds nothing."""
        x = x + self.attn(self.norm1(x), angles)
        if memory.shape[1]:
            x = x + self.cross_attn(self.norm2(x), self.norm_y(memory), angles, memory_angles)
        return x + self.mlp(self.norm3(x))


def start_as_dino(module: nn.Module) -> None:
    """Initialise the linear layers of blocks as DINOv2 does."""
    for layer in module.modules():
        if isinstance(layer, nn.Linear):
            nn.init.trunc_normal_(layer.weight, std=0.02)
            nn.init.zeros_(layer.bias)


def run(
    block: nn.Module, x: Float[Tensor, "M L C"], angles: Rotary | None = None, *, recompute: bool
) -> Float[Tensor, "M L C"]:
    """A block's tokens; with ``recompute`` activations are recomputed in the backward pass (gradient checkpointing)."""
    if recompute and torch.is_grad_enabled():
        return checkpoint(block, x, angles, use_reentrant=False)
    return block(x, angles)
