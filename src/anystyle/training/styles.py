"""Batches of made styles that know what they are made of, some photographs among them."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from anystyle.contracts import SceneSource, StyleSource
from anystyle.data.procedural.captions import SCALES
from anystyle.data.procedural.patterns import BRUSHWORK, PATTERNS
from anystyle.data.procedural.styles import StyleTraits
from anystyle.training.contract import required
from anystyle.training.sampling import generator
from anystyle.types import Style, Value

TRAITS = {"pattern": len(PATTERNS), "scale": len(SCALES), "brushwork": len(BRUSHWORK)}
"""What a style is asked for, and how many answers there are."""

UNKNOWN = -100
"""An answer that is not asked for; what cross-entropy ignores."""

PHOTO_TEXTS = (
    "a photo",
    "a photograph",
    "a plain photo",
    "a realistic photograph",
    "a photo of a room",
    "a photo of some objects",
    "an ordinary photo",
    "an unedited photograph",
)
"""What a picture of a scene is called: the neutral end of the style space."""


@dataclass(frozen=True)
class StyleBatch(Value):
    """What one step of a style training sees.

    Args:
        images: sRGB in [0, 1] of styles.
        texts: A caption of each.
        traits: The number of each style's answer to each of :data:`TRAITS`.
        photos: Pictures of scenes, as large as the styles.
        photo_texts: A caption of each.
        patterns: The patterns alone; see :attr:`anystyle.types.Style.pattern`.
        keys: One number a picture, styles first; equal numbers mean equal pictures.
    """

    images: Float[Tensor, "M 3 H W"]
    texts: tuple[str, ...]
    traits: Int[Tensor, "M T"]
    photos: Float[Tensor, "P 3 H W"]
    photo_texts: tuple[str, ...]
    patterns: Float[Tensor, "M r c"]
    keys: tuple[int, ...] = ()

    @property
    def num_images(self) -> int:
        """Styles and photographs."""
        return self.images.shape[0] + self.photos.shape[0]


@runtime_checkable
class MadeStyles(Protocol):
    """A style source that knows what its styles are made of."""

    def __len__(self) -> int:
        """How many styles there are."""
        ...

    def read(self, style: int) -> Style:
        """One style with an image, a text and its pattern alone."""
        ...

    def traits(self, style: int) -> StyleTraits:
        """What it is made of."""
        ...


class StyleBatches:
    """Batches of styles with their traits, and of photographs of scenes.

    What is made is kept in memory, 64 kB for each style at 96 pixels: pictures as bytes, patterns as floats.

    Args:
        styles: Styles with traits, all of one size.
        scenes: What the photographs are of; of the same size.
        seed: Of every choice.
        batch_size: Styles a step over all processes.
        photos: Photographs a step over all processes.
        pool: Draw from the first so many styles; ``None`` means all.
        photo_pool: Draw from so many photographs.

    Raises:
        ValueError: A source is missing, or does not know what its styles are made of.
    """

    def __init__(
        self,
        styles: StyleSource | None,
        scenes: SceneSource | None,
        *,
        seed: int = 0,
        batch_size: int = 64,
        photos: int = 8,
        pool: int | None = None,
        photo_pool: int = 512,
    ) -> None:
        self.styles = made(required(styles, "styles"))
        self.scenes = required(scenes, "scenes")
        self.seed = seed
        self.pool = len(self.styles) if pool is None else min(pool, len(self.styles))
        if self.pool < batch_size:
            raise ValueError(f"a batch of {batch_size} needs as many styles, and there are {self.pool}")
        self.batch_size, self.photos, self.photo_pool = batch_size, photos, photo_pool
        self._styles: dict[int, tuple[Tensor, str, Tensor, Tensor]] = {}
        self._photos: dict[int, Tensor] = {}

    def batch(self, step: int, rank: int = 0, world: int = 1) -> StyleBatch:
        """The rows of ``step`` that process ``rank`` of ``world`` works on.

        Raises:
            ValueError: Styles and scenes differ in size.
        """
        rng = generator(self.seed, 7, step)
        styles = rng.choice(self.pool, self.batch_size, replace=False)[rank::world].tolist()
        scenes = rng.integers(0, self.photo_pool, self.photos)[rank::world].tolist()
        rows, photos = [self._style(style) for style in styles], [self._photo(photo) for photo in scenes]
        texts = tuple(PHOTO_TEXTS[int(text)] for text in rng.integers(0, len(PHOTO_TEXTS), self.photos)[rank::world])
        if photos and photos[0].shape != rows[0][0].shape:
            raise ValueError(
                f"styles are {_size(rows[0][0])} and scenes {_size(photos[0])} pixels; "
                f"set styles.size and scenes.size to the same"
            )
        return StyleBatch(
            images=torch.stack([image for image, *_ in rows]).float() / 255,
            texts=tuple(text for _, text, *_ in rows),
            traits=torch.stack([traits for _, _, traits, _ in rows]),
            patterns=torch.stack([pattern for *_, pattern in rows]),
            photos=(torch.stack(photos) if photos else rows[0][0].new_empty(0, *rows[0][0].shape)).float() / 255,
            photo_texts=texts,
            # Styles count up from 0, photographs down from -1.
            keys=(*styles, *(-1 - photo for photo in scenes)),
        )

    def examples(self, count: int) -> StyleBatch:
        """The first styles of the pool, up to ``count``, without photographs."""
        rows = [self._style(style) for style in range(min(count, self.pool))]
        images = torch.stack([image for image, *_ in rows]).float() / 255
        return StyleBatch(
            images=images,
            texts=tuple(text for _, text, *_ in rows),
            traits=torch.stack([traits for _, _, traits, _ in rows]),
            patterns=torch.stack([pattern for *_, pattern in rows]),
            photos=images[:0],
            photo_texts=(),
        )

    def _style(self, style: int) -> tuple[Tensor, str, Tensor, Tensor]:
        if style not in self._styles:
            source, traits = self.styles.read(style), self.styles.traits(style)
            assert source.image is not None and source.text is not None and source.pattern is not None
            answers = torch.tensor([getattr(traits, name) for name in TRAITS])
            self._styles[style] = (source.image[0] * 255).round().byte(), source.text[0], answers, source.pattern[0]
        return self._styles[style]

    def _photo(self, photo: int) -> Tensor:
        if photo not in self._photos:
            scene = photo % len(self.scenes)
            view = photo // len(self.scenes) % self.scenes.num_views(scene)
            self._photos[photo] = (self.scenes.read(scene, [view]).images[0, 0] * 255).round().byte()
        return self._photos[photo]


def made(styles: StyleSource) -> MadeStyles:
    """The source as one that knows what its styles are made of.

    Raises:
        ValueError: It does not.
    """
    if not isinstance(styles, MadeStyles):
        raise ValueError(f"{type(styles).__name__} does not know what its styles are made of; use styles=procedural")
    return styles


class TraitHeads(nn.ModuleDict):
    """A linear answer to each of :data:`TRAITS`.

    Args:
        channels: Of what it reads.
    """

    def __init__(self, channels: int) -> None:
        super().__init__({name: nn.Linear(channels, answers) for name, answers in TRAITS.items()})

    def losses(
        self, features: Float[Tensor, "M C"], traits: Int[Tensor, "M T"], *, smoothing: float = 0.0
    ) -> dict[str, Float[Tensor, ""]]:
        """Cross-entropy of each trait, over the rows where it is not :data:`UNKNOWN`; 0 where it is in none."""
        found = {}
        for place, (name, head) in enumerate(self.items()):
            known = traits[:, place]
            total = nn.functional.cross_entropy(head(features), known, label_smoothing=smoothing, reduction="sum")
            found[name] = total / (known != UNKNOWN).sum().clamp_min(1)
        return found

    def accuracies(self, features: Float[Tensor, "M C"], traits: Int[Tensor, "M T"]) -> dict[str, Float[Tensor, ""]]:
        """The share of right answers for each trait."""
        return {
            name: (head(features).argmax(-1) == traits[:, place]).float().mean()
            for place, (name, head) in enumerate(self.items())
        }


def _size(image: Tensor) -> str:
    return f"{image.shape[-2]}x{image.shape[-1]}"
