"""CLIP with a vision transformer, in the original layout of keys; Long-CLIP is the same with more positions."""

from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from anystyle.io.checkpoint import load_strictly
from anystyle.vision.preprocess import normalised

MEAN = (0.48145466, 0.4578275, 0.40821073)
STD = (0.26862954, 0.26130258, 0.27577711)
HEAD = 64  # channels of an attention head
NUM_KEPT = 20  # positions before Long-CLIP's stretched ones: most texts of its training are short
STRETCHED = "positional_embedding_res"
"""Long-CLIP's second table of positions, in use after the first :data:`NUM_KEPT`."""
UNUSED = ("logit_scale", "input_resolution", "context_length", "vocab_size")
"""Tensors of published files that no embedding needs."""

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


class Clip(nn.Module):
    """Both towers."""

    def __init__(
        self,
        *,
        context: int,
        vocabulary: int = 49408,
        text_width: int = 512,
        text_layers: int = 12,
        image_width: int = 768,
        image_layers: int = 12,
        patch_size: int = 32,
        resolution: int = 224,
        dim: int = 512,
        activation: Literal["quick_gelu", "gelu"] = "quick_gelu",
    ) -> None:
        super().__init__()
        function = F.gelu if activation == "gelu" else quick_gelu
        self.context, self.resolution = context, resolution
        self.visual = Vision(image_width, image_layers, patch_size, resolution, dim, function)
        self.token_embedding = nn.Embedding(vocabulary, text_width)
        self.positional_embedding = nn.Parameter(0.01 * torch.randn(context, text_width))
        self.transformer = Transformer(text_width, text_layers, function)
        self.ln_final = nn.LayerNorm(text_width)
        self.text_projection = nn.Parameter(text_width**-0.5 * torch.randn(text_width, dim))
        nn.init.normal_(self.token_embedding.weight, std=0.02)

    def embed_tokens(self, tokens: Int[Tensor, "M L"]) -> Float[Tensor, "M D"]:
        """Embed the ids of tokens, padded with 0 behind the last one, without normalisation."""
        x = self.token_embedding(tokens) + self.positional_embedding[: tokens.shape[1]]
        x = self.ln_final(self.transformer(x, causal=True))
        ends = tokens.argmax(dim=-1)
        return x[torch.arange(len(x), device=x.device), ends] @ self.text_projection

    def embed_pixels(self, images: Float[Tensor, "M 3 S S"]) -> Float[Tensor, "M D"]:
        """Embed sRGB images in [0, 1] of the right size, not normalised."""
        return self.visual(normalised(images, MEAN, STD))


def quick_gelu(x: Float[Tensor, "*batch C"]) -> Float[Tensor, "*batch C"]:
    """A sigmoid's approximation of GELU, which OpenAI trained with."""
    return x * torch.sigmoid(1.702 * x)


def load_clip(network: Clip, state: Mapping[str, Tensor]) -> None:
    """Load CLIP's, OpenCLIP's or Long-CLIP's weights, strictly."""
    given = {key.removeprefix("module."): tensor for key, tensor in state.items()}
    second = given.pop(STRETCHED, None)
    positions = given.get("positional_embedding")
    if second is not None and positions is not None and second.shape == positions.shape:
        given["positional_embedding"] = torch.cat([positions[:NUM_KEPT], second[NUM_KEPT:]])
    given = {key: tensor for key, tensor in given.items() if key not in UNUSED}
    load_strictly(network, given, source="the checkpoint of CLIP or Long-CLIP")
