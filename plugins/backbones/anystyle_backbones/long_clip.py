"""The published style encoder: Long-CLIP, its prompts averaged over templates."""

import gzip
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.utils.rnn import pad_sequence

from anystyle.contracts import StyleEncoder
from anystyle.errors import UserError
from anystyle.vision import weights
from anystyle.vision.preprocess import resized
from anystyle_backbones import bpe
from anystyle_backbones.clip import Clip, load_clip

LOADED_SIDE = 256
"""Pixels of the square that style images are brought to first, as published."""


@cache
def small_templates() -> tuple[str, ...]:
    """The prompts of "imagenet_templates_small", which the published weights were trained with."""
    return tuple(Path(__file__).with_name("templates_small.txt").read_text(encoding="utf-8").splitlines())


class TextAdapter(nn.Module):
    """A residual MLP on the text tower's features, frozen as it was initialised; part of the published checkpoints."""

    def __init__(self, dim: int) -> None:
        super().__init__()
        self.mlp = nn.Sequential(nn.Linear(dim, dim), nn.GELU(), nn.Linear(dim, dim))

    def forward(self, features: Float[Tensor, "*batch D"]) -> Float[Tensor, "*batch D"]:
        """Unit vectors of features that are not normalised."""
        return F.normalize(features + self.mlp(features), dim=-1)


class LongClip(StyleEncoder):
    """Long-CLIP ViT-B/32: images and texts of up to 248 tokens in one space of 512 dimensions.

    A text is put into 27 templates, whose embeddings are averaged. With ``context=77`` it is CLIP itself.

    Args:
        context: Tokens of the longest text, template included.
        templates: ``small``, the published 27, or ``none``.
        neutral: The prompt that stands for no style.
        text_adapter: Whether texts pass a residual MLP, whose weights come with a style branch. Published branches need
            it; it is left as initialised where nothing is loaded into it.
        activation: ``quick_gelu``, as OpenAI's and Long-CLIP's weights need, or ``gelu``, as most of OpenCLIP's do.
        vocabulary: File of the tokeniser's merges; where it is not given, ``clip_vocabulary`` of ``anystyle weights``.
        vocabulary_size: Tokens there are.
        dim: Dimensions of the space.
        text_width: Channels of the text tower, a multiple of 64.
        text_layers: Its blocks.
        image_width: Channels of the image tower, a multiple of 64.
        image_layers: Its blocks.
        patch_size: Pixels per patch.
        resolution: Side of the images that the tower sees, in pixels.
        batch: Prompts embedded at a time; affects only memory.
    """

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        merges = gzip.compress(b"#version: 0.2\nr e\nre d</w>\no f</w>\n", mtime=0)
        (folder / "vocabulary.txt.gz").write_bytes(merges)
        towers = {"text_width": 64, "text_layers": 2, "image_width": 64, "image_layers": 2, "dim": 16}
        vocabulary = {"vocabulary": str(folder / "vocabulary.txt.gz"), "vocabulary_size": 512 + 3 + 2}
        return {**vocabulary, **towers, "patch_size": 16, "resolution": 32}

    def __init__(
        self,
        *,
        context: int = 248,
        templates: Literal["small", "none"] = "small",
        neutral: str = "a Photo",
        text_adapter: bool = False,
        activation: Literal["quick_gelu", "gelu"] = "quick_gelu",
        vocabulary: str | None = None,
        vocabulary_size: int = 49408,
        dim: int = 512,
        text_width: int = 512,
        text_layers: int = 12,
        image_width: int = 768,
        image_layers: int = 12,
        patch_size: int = 32,
        resolution: int = 224,
        batch: int = 108,
    ) -> None:
        super().__init__()
        self.dim, self.neutral = dim, neutral
        self.templates = small_templates() if templates == "small" else ("{}",)
        self.vocabulary, self.vocabulary_size = vocabulary, vocabulary_size
        self.batch = batch
        self.network = Clip(
            context=context,
            vocabulary=vocabulary_size,
            text_width=text_width,
            text_layers=text_layers,
            image_width=image_width,
            image_layers=image_layers,
            patch_size=patch_size,
            resolution=resolution,
            dim=dim,
            activation=activation,
        )
        self.adapter = TextAdapter(dim) if text_adapter else None

    def load_published(self, state: Mapping[str, Tensor]) -> None:
        load_clip(self.network, state)

    def embed_images(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M D"]:
        """Embeddings of sRGB images in [0, 1], through a centred square of 256 pixels unless of the tower's size."""
        side = self.network.resolution
        if images.shape[-2:] != (side, side):
            images = resized(images, LOADED_SIDE)
            top, left = (round((length - LOADED_SIDE) / 2) for length in images.shape[-2:])
            images = resized(images[..., top : top + LOADED_SIDE, left : left + LOADED_SIDE], side, mode="bicubic")
        return F.normalize(self.network.embed_pixels(images), dim=-1)

    def embed_texts(self, texts: Sequence[str]) -> Float[Tensor, "M D"]:
        """Embeddings of texts, each the mean over the templates."""
        if not texts or any(not text.strip() for text in texts):
            raise UserError("a text is empty; describe a style in words")
        prompts = [template.replace("{}", text) for text in texts for template in self.templates]
        features = self.features(prompts)
        features = features if self.adapter is None else self.adapter(features)
        return F.normalize(features.unflatten(0, (len(texts), -1)).mean(1), dim=-1)

    def features(self, prompts: Sequence[str]) -> Float[Tensor, "N D"]:
        """The text tower's features of prompts as they are: no template, no adapter, not normalised."""
        tokens = self.tokens(prompts).to(self.network.text_projection.device)
        return torch.cat([self.network.embed_tokens(batch) for batch in tokens.split(self.batch)])

    def tokens(self, prompts: Sequence[str]) -> Tensor:
        """Numbers of the tokens of prompts, N L, padded with 0 behind the last one."""
        file = weights.find("clip_vocabulary") if self.vocabulary is None else Path(self.vocabulary)
        tokenizer = bpe.load(file, self.vocabulary_size)
        rows = [tokenizer.encode(prompt) for prompt in prompts]
        for prompt, row in zip(prompts, rows, strict=True):
            if len(row) > (most := self.network.context):
                counted = f"the text {prompt[:40]!r}… has {len(row)} tokens, template included"
                raise UserError(f"{counted}, and at most {most} are read; shorten it")
        return pad_sequence([torch.tensor(row) for row in rows], batch_first=True)
