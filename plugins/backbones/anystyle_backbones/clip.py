"""CLIP with both towers, in the original layout of keys; Long-CLIP is the same with more positions."""

from collections.abc import Mapping
from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn

from anystyle.io.checkpoint import load_strictly
from anystyle.vision.clip import MEAN, STD, Transformer, Vision, quick_gelu
from anystyle.vision.preprocess import normalised

NUM_KEPT = 20  # positions before Long-CLIP's stretched ones: most texts of its training are short
STRETCHED = "positional_embedding_res"
"""Long-CLIP's second table of positions, in use after the first :data:`NUM_KEPT`."""
UNUSED = ("logit_scale", "input_resolution", "context_length", "vocab_size")
"""Tensors of published files that no embedding needs."""


class Clip(nn.Module):
    """Both towers, with the options of :class:`anystyle_backbones.long_clip.LongClip`."""

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


def load_clip(network: Clip, state: Mapping[str, Tensor]) -> None:
    """Load CLIP's, OpenCLIP's or Long-CLIP's weights, strictly."""
    given = {key.removeprefix("module."): tensor for key, tensor in state.items()}
    second = given.pop(STRETCHED, None)
    positions = given.get("positional_embedding")
    if second is not None and positions is not None and second.shape == positions.shape:
        given["positional_embedding"] = torch.cat([positions[:NUM_KEPT], second[NUM_KEPT:]])
    given = {key: tensor for key, tensor in given.items() if key not in UNUSED}
    load_strictly(network, given, source="the checkpoint of CLIP or Long-CLIP")
