"""CLIP with a vision transformer, in the original layout of keys; Long-CLIP is the same with more positions."""

from collections.abc import Callable, Mapping
from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn

from anystyle.paging import fill

MEAN = (0.48145466, 0.4578275, 0.40821073)
STD = (0.26862954, 0.26130258, 0.27577711)
HEAD = 64
"""Channels of an attention head."""
STRETCHED = "positional_embedding_res"
"""Long-CLIP's second table of positions, in use from the position on up to which the first is kept."""
UNUSED = ("logit_scale", "input_resolution", "context_length", "vocab_size")
"""What files hold and no embedding needs."""


class Attention(nn.Module):
    """Multi-head self-attention under the names of PyTorch's own.

    Args:
        width: Channels, a multiple of 64.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.heads = max(1, width // HEAD)
        self.in_proj_weight = nn.Parameter(torch.empty(3 * width, width))
        self.in_proj_bias = nn.Parameter(torch.zeros(3 * width))
        self.out_proj = nn.Linear(width, width)
        nn.init.normal_(self.in_proj_weight, std=width**-0.5)

    def forward(self, x: Float[Tensor, "M L C"], *, causal: bool) -> Float[Tensor, "M L C"]:
        """Attend over L."""
        parts = F.linear(x, self.in_proj_weight, self.in_proj_bias).chunk(3, dim=-1)
        q, k, v = (part.unflatten(-1, (self.heads, -1)).transpose(1, 2) for part in parts)
        return self.out_proj(F.scaled_dot_product_attention(q, k, v, is_causal=causal).transpose(1, 2).flatten(2))


class Mlp(nn.Module):
    """Two linear layers four times as wide between."""

    def __init__(self, width: int, activation: Callable[[Tensor], Tensor]) -> None:
        super().__init__()
        self.activation = activation
        self.c_fc, self.c_proj = nn.Linear(width, 4 * width), nn.Linear(4 * width, width)

    def forward(self, x: Float[Tensor, "M L C"]) -> Float[Tensor, "M L C"]:
        """Map each token."""
        return self.c_proj(self.activation(self.c_fc(x)))


class Block(nn.Module):
    """A pre-norm transformer block."""

    def __init__(self, width: int, activation: Callable[[Tensor], Tensor]) -> None:
        super().__init__()
        self.ln_1, self.ln_2 = nn.LayerNorm(width), nn.LayerNorm(width)
        self.attn, self.mlp = Attention(width), Mlp(width, activation)

    def forward(self, x: Float[Tensor, "M L C"], *, causal: bool) -> Float[Tensor, "M L C"]:
        """Attend, then map each token."""
        x = x + self.attn(self.ln_1(x), causal=causal)
        return x + self.mlp(self.ln_2(x))


class Transformer(nn.Module):
    """Blocks in a row."""

    def __init__(self, width: int, layers: int, activation: Callable[[Tensor], Tensor]) -> None:
        super().__init__()
        self.resblocks = nn.ModuleList(Block(width, activation) for _ in range(layers))

    def forward(self, x: Float[Tensor, "M L C"], *, causal: bool = False) -> Float[Tensor, "M L C"]:
        """Run all blocks."""
        for block in self.resblocks:
            x = block(x, causal=causal)
        return x


class Vision(nn.Module):
    """The tower of images.

    Args:
        width: Channels.
        layers: Blocks.
        patch_size: Pixels a patch.
        resolution: Side of the images, in pixels.
        dim: Of the embedding.
        activation: Of the MLPs.
    """

    def __init__(
        self,
        *,
        width: int,
        layers: int,
        patch_size: int,
        resolution: int,
        dim: int,
        activation: Callable[[Tensor], Tensor],
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
        """Embed normalised images of the right size."""
        patches = self.conv1(images.to(self.conv1.weight.dtype)).flatten(2).mT
        tokens = torch.cat([self.class_embedding.expand(len(images), 1, -1), patches], dim=1)
        tokens = self.transformer(self.ln_pre(tokens + self.positional_embedding))
        return self.ln_post(tokens[:, 0]) @ self.proj


class Clip(nn.Module):
    """Both towers; the defaults are ViT-B/32's.

    Args:
        context: Tokens of the longest text.
        vocabulary: Tokens there are; the last one ends a text.
        text_width: Channels of the text tower, a multiple of 64.
        text_layers: Its blocks.
        image_width: Channels of the image tower, a multiple of 64.
        image_layers: Its blocks.
        patch_size: Pixels a patch.
        resolution: Side of the images, in pixels.
        dim: Of the embedding.
        activation: ``quick_gelu``, as OpenAI's and Long-CLIP's weights need, or ``gelu``, as most of OpenCLIP's do.
    """

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
        self.visual = Vision(
            width=image_width,
            layers=image_layers,
            patch_size=patch_size,
            resolution=resolution,
            dim=dim,
            activation=function,
        )
        self.token_embedding = nn.Embedding(vocabulary, text_width)
        self.positional_embedding = nn.Parameter(0.01 * torch.randn(context, text_width))
        self.transformer = Transformer(text_width, text_layers, function)
        self.ln_final = nn.LayerNorm(text_width)
        self.text_projection = nn.Parameter(text_width**-0.5 * torch.randn(text_width, dim))
        nn.init.normal_(self.token_embedding.weight, std=0.02)

    def embed_tokens(self, tokens: Int[Tensor, "M L"]) -> Float[Tensor, "M D"]:
        """Embed texts, neither normalised nor averaged.

        Args:
            tokens: Numbers of tokens, padded behind the last one with 0; texts attend backwards only, so as many as
                the longest has are enough.
        """
        x = self.token_embedding(tokens) + self.positional_embedding[: tokens.shape[1]]
        x = self.ln_final(self.transformer(x, causal=True))
        ends = tokens.argmax(dim=-1)
        return x[torch.arange(len(x), device=x.device), ends] @ self.text_projection

    def embed_pixels(self, images: Float[Tensor, "M 3 S S"]) -> Float[Tensor, "M D"]:
        """Embed sRGB images in [0, 1] of the right size, not normalised."""
        mean, std = images.new_tensor(MEAN), images.new_tensor(STD)
        return self.visual((images - mean[:, None, None]) / std[:, None, None])


def quick_gelu(x: Float[Tensor, "*batch C"]) -> Float[Tensor, "*batch C"]:
    """A sigmoid's approximation of GELU, which OpenAI trained with."""
    return x * torch.sigmoid(1.702 * x)


def stretch(positions: Float[Tensor, "L C"], context: int, *, kept: int = 20) -> Float[Tensor, "K C"]:
    """Position embeddings for longer texts, as Long-CLIP makes them: some are kept, the others spread by four.

    Args:
        positions: Of the short context.
        context: The long one: ``kept + 4 * (L - kept)``.
        kept: How many stay as they are, for most training texts are short.

    Raises:
        ValueError: The lengths do not fit.
    """
    length = len(positions)
    if context != kept + 4 * (length - kept):
        raise ValueError(
            f"{length} positions stretch to {kept + 4 * (length - kept)}, not to {context}; set context to one of these"
        )
    spread = positions[kept:]
    steps = torch.cat([spread[1:] - spread[:-1], spread[-1:] - spread[-2:-1]])
    quarters = torch.arange(4, device=positions.device, dtype=positions.dtype) / 4
    between = spread[:, None] + quarters[:, None] * steps[:, None]
    return torch.cat([positions[:kept], between.flatten(0, 1)])


@torch.no_grad()
def load_clip(network: Clip, state: Mapping[str, Tensor]) -> None:
    """Load CLIP's, OpenCLIP's or Long-CLIP's weights, strictly.

    Positions of a short context are stretched where the network's is longer (see :func:`stretch`).

    Raises:
        ValueError: Keys or shapes differ; up to five of each kind of difference are named.
    """
    given = {key.removeprefix("module."): tensor for key, tensor in state.items()}
    long = given.pop(STRETCHED, None)
    positions = given.get("positional_embedding")
    if long is not None and positions is not None and long.shape == positions.shape:
        given["positional_embedding"] = torch.cat([positions[:20], long[20:]])
    elif positions is not None and positions.dim() == 2 and len(positions) < network.context:
        given["positional_embedding"] = stretch(positions.float(), network.context)
    given = {key: tensor for key, tensor in given.items() if key not in UNUSED}
    own = network.state_dict()
    differences = [
        f"{len(found)} {kind} ({', '.join(found[:5])}{', …' if len(found) > 5 else ''})"
        for kind, found in (
            ("missing", [key for key in own if key not in given]),
            ("unexpected", [key for key in given if key not in own]),
            (
                "misshapen",
                [
                    f"{key} is {list(given[key].shape)}, not {list(own[key].shape)}"
                    for key in own
                    if key in given and given[key].shape != own[key].shape
                ],
            ),
        )
        if found
    ]
    if differences:
        raise ValueError(
            f"the checkpoint does not fit this CLIP: {'; '.join(differences)} "
            f"(expected: {len(own)} tensors in the layout of CLIP or Long-CLIP)"
        )
    fill(network, given)
