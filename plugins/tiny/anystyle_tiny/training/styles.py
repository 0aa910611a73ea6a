"""Batches of procedural styles with their traits, some photographs among them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn

from anystyle.contracts import SceneSource, StyleSource
from anystyle.contracts.training import Training, required
from anystyle.errors import UserError
from anystyle.io.cache import LRUCache
from anystyle.training.sampling import generator
from anystyle.types import Value
from anystyle_tiny.procedural.captions import SCALES
from anystyle_tiny.procedural.patterns import BRUSHWORK, PATTERNS
from anystyle_tiny.procedural.scenes import ProceduralScenes
from anystyle_tiny.procedural.styles import ProceduralStyles

TRAITS = {"pattern": len(PATTERNS), "scale": len(SCALES), "brushwork": len(BRUSHWORK)}
"""The traits that are predicted of a style, and their numbers of classes."""

UNKNOWN = -100
"""The label that cross-entropy ignores."""

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
"""Captions of pictures of scenes: the neutral end of the style space."""


PHOTO_POOL = 512
"""Photographs that are drawn from: views of scenes."""


@dataclass(frozen=True)
class StyleBatch(Value):
    """What one step of a style training sees."""

    images: Float[Tensor, "M 3 H W"]
    texts: tuple[str, ...]
    traits: Int[Tensor, "M T"]
    photos: Float[Tensor, "P 3 H W"]
    photo_texts: tuple[str, ...]
    keys: tuple[int, ...] = ()

    @property
    def num_images(self) -> int:
        """Styles and photographs."""
        return self.images.shape[0] + self.photos.shape[0]


class StyleBatches:
    """Batches of styles with their traits, and of photographs of scenes.

    Styles are kept in memory as bytes once they are painted.
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
    ) -> None:
        source = required(styles, "styles")
        if not isinstance(source, ProceduralStyles):
            raise UserError(f"the traits of {type(source).__name__} are not known; use styles=procedural")
        self.styles, self.scenes = source, required(scenes, "scenes")
        self.seed, self.batch_size, self.photos = seed, batch_size, photos
        self.pool = len(source) if pool is None else min(pool, len(source))
        if self.pool < batch_size:
            raise UserError(f"a batch of {batch_size} needs as many styles, and there are {self.pool}")
        self._styles: LRUCache[int, tuple[Tensor, str, Tensor]] = LRUCache(self.pool)
        self._photos: LRUCache[int, Tensor] = LRUCache(PHOTO_POOL)

    def batch(self, step: int, rank: int = 0, world: int = 1) -> StyleBatch:
        """The rows of ``step`` that process ``rank`` of ``world`` works on."""
        rng = generator(self.seed, 7, step)
        styles = rng.choice(self.pool, self.batch_size, replace=False)[rank::world].tolist()
        scenes = rng.integers(0, PHOTO_POOL, self.photos)[rank::world].tolist()
        texts = rng.integers(0, len(PHOTO_TEXTS), self.photos)[rank::world].tolist()
        batch = self._styles_only(styles)
        photos = [self._photos.get(photo, partial(self._photo, photo)) for photo in scenes]
        if photos and photos[0].shape != batch.images.shape[1:]:
            (height, width), (h, w) = batch.images.shape[-2:], photos[0].shape[-2:]
            raise UserError(
                f"styles are {height}x{width} and scenes {h}x{w} pixels; set styles.size and scenes.size to the same"
            )
        return replace(
            batch,
            photos=torch.stack(photos).float() / 255 if photos else batch.photos,
            photo_texts=tuple(PHOTO_TEXTS[text] for text in texts),
            # Styles count up from 0, photographs down from -1.
            keys=(*styles, *(-1 - photo for photo in scenes)),
        )

    def examples(self, count: int) -> StyleBatch:
        """The first styles of the pool, up to ``count``, without photographs."""
        return self._styles_only(range(min(count, self.pool)))

    def _styles_only(self, styles: Sequence[int]) -> StyleBatch:
        rows = (self._styles.get(style, partial(self._style, style)) for style in styles)
        images, texts, traits = zip(*rows, strict=True)
        pictures = torch.stack(images).float() / 255
        return StyleBatch(pictures, texts, torch.stack(traits), photos=pictures[:0], photo_texts=())

    def _style(self, style: int) -> tuple[Tensor, str, Tensor]:
        source, traits = self.styles.read(style), self.styles.traits(style)
        assert source.image is not None and source.text is not None
        answers = torch.tensor([getattr(traits, name) for name in TRAITS])
        return (source.image[0] * 255).round().byte(), source.text[0], answers

    def _photo(self, photo: int) -> Tensor:
        scene = photo % len(self.scenes)
        view = photo // len(self.scenes) % self.scenes.num_views(scene)
        return (self.scenes.read(scene, [view]).images[0, 0] * 255).round().byte()


class StyleTraining(Training):
    """Base of trainings on procedural styles: their batches, and sources for checks.

    The constructor sets ``batch_size``, ``photos`` and ``pool``; see :class:`StyleBatches`.
    """

    needs = ("scenes", "styles")
    batch_size: int
    photos: int
    pool: int | None
    source: StyleBatches | None = None

    @classmethod
    def example_sources(cls) -> tuple[SceneSource, StyleSource]:
        """Procedural ones, of one size."""
        return ProceduralScenes(size=32, num_scenes=4, views=3), ProceduralStyles(size=32, num_styles=8)

    def batches(self, scenes: SceneSource | None, styles: StyleSource | None, *, seed: int) -> StyleBatches:
        """Styles with captions, and photographs of scenes."""
        self.source = StyleBatches(
            styles, scenes, seed=seed, batch_size=self.batch_size, photos=self.photos, pool=self.pool
        )
        return self.source


def retrieval(images: Float[Tensor, "M D"], texts: Float[Tensor, "M D"]) -> dict[str, Float[Tensor, ""]]:
    """How often the nearest text of an image is its own, and the nearest image of a text; rows belong together."""
    similarity = F.normalize(images, dim=-1) @ F.normalize(texts, dim=-1).T
    index = torch.arange(len(texts), device=similarity.device)
    names = ("retrieval_text_to_image", "retrieval_image_to_text")
    return {name: (similarity.argmax(axis) == index).float().mean() for axis, name in enumerate(names)}


class TraitHeads(nn.ModuleDict):
    """A linear classifier for each of :data:`TRAITS`."""

    def __init__(self, channels: int) -> None:
        super().__init__({name: nn.Linear(channels, answers) for name, answers in TRAITS.items()})

    def losses(
        self, features: Float[Tensor, "M C"], traits: Int[Tensor, "M T"], *, smoothing: float = 0.0
    ) -> dict[str, Float[Tensor, ""]]:
        """Cross-entropy of each trait, over the rows where it is not :data:`UNKNOWN`; 0 where it is in none."""
        losses = {}
        for (name, head), target in zip(self.items(), traits.unbind(1), strict=True):
            total = F.cross_entropy(head(features), target, label_smoothing=smoothing, reduction="sum")
            losses[name] = total / (target != UNKNOWN).sum().clamp_min(1)
        return losses

    def accuracies(self, features: Float[Tensor, "M C"], traits: Int[Tensor, "M T"]) -> dict[str, Float[Tensor, ""]]:
        """The accuracy for each trait."""
        return {
            name: (head(features).argmax(-1) == target).float().mean()
            for (name, head), target in zip(self.items(), traits.unbind(1), strict=True)
        }
