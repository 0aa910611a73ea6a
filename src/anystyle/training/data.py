"""Batches as functions of the step, and the Lightning data module that serves them."""

import logging
import signal
from collections.abc import Iterator, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any, Literal

import lightning.pytorch as pl
import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset

from anystyle.contracts import BatchSource, SceneSource, StyleSource
from anystyle.errors import UserError, one_line
from anystyle.training.callbacks import STOPS
from anystyle.training.collate import blurred_views, fit_views, mirror_views, stack_styles, stack_views
from anystyle.training.sampling import any_views, bounded_views, bounds, check_sides, generator
from anystyle.types import Style, Value, Views
from anystyle.types.seeds import seeded

logger = logging.getLogger(__name__)

ATTEMPTS = 16
"""Draws of one row that may fail in sequence before the batch is an error."""


@dataclass(frozen=True)
class Batch(Value):
    """The batch of one step of a scene training.

    Args:
        views: The context views, then the target views, which only losses use.
        context: Number of context views, the network's input.
        style: One style for each scene, where the training has styles.
        keys: Identifies the content of each row; equal keys mean equal context views.
    """

    views: Views
    context: int
    style: Style | None = None
    keys: tuple[int, ...] = ()

    @property
    def num_images(self) -> int:
        """Context images of all rows."""
        return self.views.images.shape[0] * self.context

    @property
    def inputs(self) -> Views:
        """The context views."""
        return self.views.select(list(range(self.context)))


@dataclass(eq=False)
class SceneBatches:
    """Batches of scenes, with styles or without; most options are described by ``training=stylization``.

    Args:
        scenes: Source of the views.
        styles: Source of the styles; ``None`` for batches without styles.
        seed: Seed of every draw.
        target_views: Number of additional views, for losses.
        multiple: Sides are multiples of it: the backbone's patch size.
        needs_style_image: Whether a style without an image is drawn again.
    """

    scenes: SceneSource
    styles: StyleSource | None = None
    _: KW_ONLY
    seed: int = 0
    batch_size: int | None = None
    images: int = 36
    context_views: Sequence[int] = (2, 18)
    view_power: float = 2.0
    target_views: int = 0
    spread: Literal["any", "bounded"] = "bounded"
    heights: Sequence[int] | None = None
    width: int | None = None
    multiple: int = 14
    flip: float = 0.0
    min_scale: float = 1.0
    needs_style_image: bool = False
    pool: int | None = None

    def __post_init__(self) -> None:
        low, high = bounds("context_views", self.context_views)
        if self.heights is not None:
            check_sides(*bounds("heights", self.heights), width=self.width, multiple=self.multiple)
        if len(self.scenes) == 0:
            raise UserError("the scene source holds no scene")
        self.counts = list(range(low, high + 1))
        powers = np.asarray(self.counts, dtype=np.float64) ** self.view_power
        self.probabilities = powers / powers.sum()
        self.choose = {"any": any_views, "bounded": bounded_views}[self.spread]

    def shape(self, step: int, world: int = 1) -> tuple[int, int]:
        """The number of scenes of ``step`` over all ``world`` processes, and of context views of each."""
        context = int(generator(self.seed, 1, step).choice(self.counts, p=self.probabilities))
        return self.batch_size or world * max(1, self.images // world // context), context

    def batch(self, step: int, rank: int = 0, world: int = 1) -> Batch:
        """The rows of ``step`` of process ``rank`` of ``world``.

        Scenes and styles that cannot be read, and scenes with too few views, are drawn again, with a warning.
        """
        count, context = self.shape(step, world)
        if count % world:
            raise UserError(
                f"{count} scenes a step cannot be shared by {world} processes; make training.batch_size a multiple of "
                f"them, or null and set training.images"
            )
        rows = [self._row(step, row, context) for row in range(rank, count, world)]
        views, keys = [row[0] for row in rows], [row[2] for row in rows]
        size = self._size(step, views[0].size)
        if any(side % self.multiple for side in size):
            raise UserError(
                f"images are {size[0]}x{size[1]} pixels, and the backbone's patches {self.multiple}; set "
                f"training.heights and training.width, or scenes that come in multiples of that "
                f"(scenes.multiple={self.multiple})"
            )
        if self.heights is not None:
            views = [fit_views(each, size) for each in views]
        if self.min_scale < 1:
            # Seeded by the key: equal keys must mean equal images.
            scales = [generator(self.seed, 10, key, key >> 32).uniform(self.min_scale, 1) for key in keys]
            views = [blurred_views(each, float(scale)) for each, scale in zip(views, scales, strict=True)]
        style = None if self.styles is None else stack_styles([row[1] for row in rows])
        return Batch(stack_views(views), context, style, tuple(keys))

    def _row(self, step: int, row: int, context: int) -> tuple[Views, Style, int]:
        last = "a style without an image"
        for attempt in range(ATTEMPTS):
            try:
                views, style, key = self._draw(step, row, context, attempt)
            except (ValueError, OSError) as error:
                last = one_line(error)
                logger.warning("skipped: %s", last)
                continue
            if not self.needs_style_image or style.image is not None:
                return views, style, key
        raise UserError(f"{ATTEMPTS} draws of scenes and styles could not be read; the last one: {last}")

    def _draw(self, step: int, row: int, context: int, attempt: int) -> tuple[Views, Style, int]:
        rng = generator(self.seed, 8, step, row, attempt) if attempt else generator(self.seed, 2, step, row)
        content = int(rng.integers(0, self.pool or 2**62))
        style = int(rng.integers(0, len(self.styles))) if self.styles is not None else 0
        inner = generator(self.seed, 3, content, content >> 32, context)
        scene = int(inner.integers(0, len(self.scenes)))
        is_mirrored = bool(inner.random() < self.flip)
        try:
            indices = self.choose(inner, self.scenes.num_views(scene), context, self.target_views)
        except ValueError as error:
            raise UserError(f"{self.scenes.name(scene)}: {error}") from None
        views = self.scenes.read(scene, indices)
        views = mirror_views(views) if is_mirrored else views
        key = content * (self.counts[-1] + 1) + context
        if self.styles is None:
            return views, Style(), key
        # A source that crops at random draws from the global generator.
        with seeded(int(generator(self.seed, 9, step, row, attempt).integers(2**62))):
            return views, self.styles.read(style), key

    def _size(self, step: int, size: tuple[int, int]) -> tuple[int, int]:
        if self.heights is None:
            return size
        low, high = self.heights
        steps = generator(self.seed, 4, step).integers(-(-low // self.multiple), high // self.multiple + 1)
        height = int(steps) * self.multiple
        if self.width is not None:
            return height, self.width
        return height, max(1, round(height * size[1] / size[0] / self.multiple)) * self.multiple


class _Steps(Dataset[Value]):
    """A batch source as a map from steps to batches, for one process."""

    def __init__(self, source: BatchSource, rank: int, world: int) -> None:
        self.source, self.rank, self.world = source, rank, world

    def __getitem__(self, step: int) -> Value:
        return self.source.batch(step, self.rank, self.world)


def _ignore_signals(worker: int) -> None:
    """Ignore the signals that end a training and reach the workers too: it finishes its step with their batches."""
    for name in STOPS:
        signal.signal(name, signal.SIG_IGN)


class StepLoader:
    """The batches of some steps, in order; resumable, for the trainer holds the step."""

    def __init__(
        self, source: BatchSource, steps: range, *, rank: int = 0, world: int = 1, workers: int = 0, pin: bool = False
    ) -> None:
        self.stop = steps.stop
        # DataLoader draws a base seed from the global generator; its own keeps the training's random numbers apart.
        self.loader = DataLoader(
            _Steps(source, rank, world),
            batch_size=None,
            sampler=steps,
            num_workers=workers,
            pin_memory=pin,  # from where a card copies faster
            worker_init_fn=_ignore_signals,
            generator=torch.Generator().manual_seed(0),
        )

    def __len__(self) -> int:
        return self.stop

    def __iter__(self) -> Iterator[Value]:
        return iter(self.loader)

    def state_dict(self) -> dict[str, Any]:
        return {}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        pass


class StepData(pl.LightningDataModule):
    """The data module of a batch source; training starts at the trainer's global step.

    Validation is the first ``validation_steps`` batches, the same each time and in each process.
    """

    def __init__(
        self, train: BatchSource, validation: BatchSource | None = None, *, validation_steps: int = 8, workers: int = 0
    ) -> None:
        super().__init__()
        self.train, self.validation = train, validation
        self.validation_steps, self.workers = validation_steps, workers

    def train_dataloader(self) -> StepLoader:
        trainer = self.trainer
        assert trainer is not None
        if len(trainer.optimizers) > 1:  # Lightning's step counts the calls of all
            raise UserError("a training has one optimizer; give it groups of parameters in place of several optimizers")
        steps = range(*(step * trainer.accumulate_grad_batches for step in (trainer.global_step, trainer.max_steps)))
        rank, world, pin = trainer.global_rank, trainer.world_size, trainer.strategy.root_device.type == "cuda"
        return StepLoader(self.train, steps, rank=rank, world=world, workers=self.workers, pin=pin)

    def val_dataloader(self) -> StepLoader | list[Value]:
        return [] if self.validation is None else StepLoader(self.validation, range(self.validation_steps))
