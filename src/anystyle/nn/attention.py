"""The transformer block of ViT and DINOv2, with the two kinds of feed-forward layer that its sizes use."""

from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.nn.tokens import Rotary, rotate


def attended(
    q: Float[Tensor, "M heads L E"], k: Float[Tensor, "M heads S E"], v: Float[Tensor, "M heads S E"]
) -> Float[Tensor, "M L C"]:
    """Scaled dot-product attention, heads concatenated; queries and keys are cast to the dtype of the values."""
    return F.scaled_dot_product_attention(q.to(v.dtype), k.to(v.dtype), v).transpose(1, 2).flatten(2)


class Attention(nn.Module):
    """Multi-head self-attention; with ``qk_norm`` queries and keys are normalised per head, ahead of the rotation.

    Gain and bias of the norms may be in the angles, which takes fewer kernels; see :class:`~anystyle.nn.tokens.Rotary`.
    """

    def __init__(self, dim: int, heads: int, *, qk_norm: bool) -> None:
        super().__init__()
        self.heads = heads
        self.qkv = nn.Linear(dim, 3 * dim)
        self.q_norm, self.k_norm = (nn.LayerNorm(dim // heads) if qk_norm else nn.Identity() for _ in range(2))
        self.proj = nn.Linear(dim, dim)

    def forward(self, x: Float[Tensor, "M L C"], angles: Rotary | None = None) -> Float[Tensor, "M L C"]:
        qkv = self.qkv(x).unflatten(-1, (3, self.heads, -1))  # M L 3 heads E
        qk, v = qkv[:, :, :2], qkv[:, :, 2].transpose(1, 2)
        if angles is not None and angles.shift is not None:
            qk = F.layer_norm(qk, qk.shape[-1:])
        elif isinstance(self.q_norm, nn.LayerNorm):
            qk = torch.stack([self.q_norm(qk[:, :, 0]), self.k_norm(qk[:, :, 1])], dim=2)
        qk = qk.permute(0, 2, 3, 1, 4)  # M 2 heads L E
        q, k = (qk if angles is None else rotate(qk, angles)).unbind(1)
        return self.proj(attended(q, k, v))


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
