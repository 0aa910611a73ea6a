"""CLIP's transformer and its image tower, in the original layout of keys."""

from collections import OrderedDict
from collections.abc import Callable

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

MEAN = (0.48145466, 0.4578275, 0.40821073)
STD = (0.26862954, 0.26130258, 0.27577711)
HEAD = 64  # channels of an attention head

Activation = Callable[[Tensor], Tensor]


class ResidualAttentionBlock(nn.Module):
    """A pre-norm transformer block."""

    def __init__(self, width: int, activation: Activation) -> None:
        super().__init__()
        self.ln_1, self.ln_2 = nn.LayerNorm(width), nn.LayerNorm(width)
        self.attn = nn.MultiheadAttention(width, max(1, width // HEAD), batch_first=True)
        self.mlp = nn.Sequential(OrderedDict(c_fc=nn.Linear(width, 4 * width), c_proj=nn.Linear(4 * width, width)))
        self.activation = activation

    def forward(self, x: Float[Tensor, "M L C"], mask: Bool[Tensor, "L L"] | None) -> Float[Tensor, "M L C"]:
        y = self.ln_1(x)
        x = x + self.attn(y, y, y, attn_mask=mask, is_causal=mask is not None, need_weights=False)[0]
        return x + self.mlp[1](self.activation(self.mlp[0](self.ln_2(x))))


class Transformer(nn.Module):
    """Blocks in a row."""

    def __init__(self, width: int, layers: int, activation: Activation) -> None:
        super().__init__()
        self.resblocks = nn.ModuleList(ResidualAttentionBlock(width, activation) for _ in range(layers))

    def forward(self, x: Float[Tensor, "M L C"], *, causal: bool = False) -> Float[Tensor, "M L C"]:
        length = x.shape[1]
        mask = torch.ones(length, length, dtype=torch.bool, device=x.device).triu(1) if causal else None
        for block in self.resblocks:
            x = block(x, mask)
        return x


class Vision(nn.Module):
    """The image tower."""

    def __init__(
        self, width: int, layers: int, patch_size: int, resolution: int, dim: int, activation: Activation
    ) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, width, patch_size, stride=patch_size, bias=False)
        scale = width**-0.5
        self.class_embedding = nn.Parameter(scale * torch.randn(width))
        self.positional_embedding = nn.Parameter(scale * torch.randn((resolution // patch_size) ** 2 + 1, width))
        self.ln_pre, self.ln_post = nn.LayerNorm(width), nn.LayerNorm(width)
        self.transformer = Transformer(width, layers, activation)
        self.proj = nn.Parameter(scale * torch.randn(width, dim))

    def forward(self, images: Float[Tensor, "M 3 S S"]) -> Float[Tensor, "M D"]:
        patches = self.conv1(images.to(self.conv1.weight.dtype)).flatten(2).mT
        tokens = torch.cat([self.class_embedding.expand(len(images), 1, -1), patches], dim=1)
        tokens = self.transformer(self.ln_pre(tokens + self.positional_embedding))
        return self.ln_post(tokens[:, 0]) @ self.proj


def quick_gelu(x: Float[Tensor, "*batch C"]) -> Float[Tensor, "*batch C"]:
    """A sigmoid's approximation of GELU, which OpenAI trained with."""
    return x * torch.sigmoid(1.702 * x)
