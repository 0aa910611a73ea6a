"""Batches as functions of the step, and the Lightning data module that serves them."""

import logging
import signal
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol, runtime_checkable

import lightning.pytorch as pl
import torch
from torch.utils.data import DataLoader, Dataset

from anystyle.contracts import SceneSource, StyleSource
from anystyle.errors import one_line
from anystyle.training.collate import blurred_views, fit_views, mirror_views, stack_styles, stack_views
from anystyle.training.sampling import (
    Draw,
    any_views,
    batch_rows,
    bounded_views,
    bounds,
    check_counts,
    check_sides,
    generator,
    view_probabilities,
)
from anystyle.types import Style, Value, Views

logger = logging.getLogger(__name__)

ATTEMPTS = 16
"""Draws that may fail in a row before the batch is an error."""


@dataclass(frozen=True)
class Batch(Value):
    """The batch of one step of a scene training.

    Args:
        views: The context views, then the target views, which only losses use.
        context: Number of context views, the network's input.
        style: One style for each scene, where the training has styles.
        keys: Identifies the content of each row; equal keys mean equal context views.
        skipped: An error message for each scene or style that could not be read and was drawn again.
    """

    views: Views
    context: int
    style: Style | None = None
    keys: tuple[int, ...] = ()
    skipped: tuple[str, ...] = ()

    @property
    def num_images(self) -> int:
        """Context images of all rows."""
        return self.views.images.shape[0] * self.context

    @property
    def inputs(self) -> Views:
        """The context views."""
        return self.views.select(list(range(self.context)))


@runtime_checkable
class BatchSource(Protocol):
    """A source of batches by step."""

    def batch(self, step: int, rank: int, world: int) -> Value:
        """The rows of ``step`` of process ``rank`` of ``world``."""
        ...


class SceneBatches:
    """Batches of scenes, with styles or without; what is not told here is an option of ``training=stylization``.

    Args:
        scenes: Source of the views.
        styles: Source of the styles; ``None`` for batches without styles.
        seed: Of every draw.
        batch_size: Scenes a step over all processes; ``None`` derives it from ``images``.
        target_views: Number of further views, for losses.
        multiple: Sides are multiples of it: the backbone's patch size.
        style_images: Whether a style without an image is drawn again.
    """

    def __init__(
        self,
        scenes: SceneSource,
        styles: StyleSource | None = None,
        *,
        seed: int = 0,
        batch_size: int | None = None,
        images: int = 36,
        context_views: Sequence[int] = (2, 18),
        view_power: float = 2.0,
        target_views: int = 0,
        spread: Literal["any", "bounded"] = "bounded",
        heights: Sequence[int] | None = None,
        width: int | None = None,
        multiple: int = 14,
        flip: float = 0.0,
        min_scale: float = 1.0,
        style_images: bool = False,
        pool: int | None = None,
    ) -> None:
        low, high = bounds("context_views", context_views)
        check_counts(batch_size=batch_size, images=images, pool=pool, width=width)
        if heights is not None:
            check_sides(*bounds("heights", heights), width=width, multiple=multiple)
        if len(scenes) == 0:
            raise ValueError("the scene source holds no scene; `anystyle data check PATH` says why")
        self.scenes, self.styles, self.seed = scenes, styles, seed
        self.batch_size, self.images = batch_size, images
        self.counts = list(range(low, high + 1))
        self.probabilities = view_probabilities(self.counts, view_power)
        self.target_views = target_views
        self.choose = {"any": any_views, "bounded": bounded_views}[spread]
        self.heights, self.width, self.multiple = heights, width, multiple
        self.flip, self.pool = flip, pool
        self.min_scale, self.style_images = min_scale, style_images

    def shape(self, step: int, world: int = 1) -> tuple[int, int]:
        """The number of scenes of ``step`` over all ``world`` processes, and of context views of each."""
        rng = generator(self.seed, 1, step)
        context = int(rng.choice(self.counts, p=self.probabilities))
        return self.batch_size or world * batch_rows(context, self.images // world), context

    def _draw(self, step: int, row: int, context: int, attempt: int) -> Draw:
        rng = generator(self.seed, 8, step, row, attempt) if attempt else generator(self.seed, 2, step, row)
        content = int(rng.integers(0, self.pool or 2**62))
        style = int(rng.integers(0, len(self.styles))) if self.styles is not None else 0
        key = content * (self.counts[-1] + 1) + context
        inner = generator(self.seed, 3, content, content >> 32, context)
        scene = int(inner.integers(0, len(self.scenes)))
        flip = bool(inner.random() < self.flip)
        try:
            views = self.choose(inner, self.scenes.num_views(scene), context, self.target_views)
        except ValueError as error:
            raise ValueError(f"{self.scenes.name(scene)}: {error}") from None
        return Draw(key=key, scene=scene, views=views, style=style, flip=flip)

    def batch(self, step: int, rank: int = 0, world: int = 1) -> Batch:
        """The rows of ``step`` of process ``rank`` of ``world``.

        Scenes and styles that cannot be read, and scenes with too few views, are drawn again; the batch lists them.

        Raises:
            ValueError: The rows cannot be divided evenly, or nothing can be read.
        """
        count, context = self.shape(step, world)
        if count % world:
            raise ValueError(
                f"{count} scenes a step cannot be shared by {world} processes; make training.batch_size a multiple of "
                f"them, or null and set training.images"
            )
        rows, styles, keys, skipped = [], [], [], []
        for row in range(rank, count, world):
            key, views, style = self._row(step, row, context, skipped)
            rows.append(views)
            styles.append(style)
            keys.append(key)
        size = self._size(step, rows[0])
        if size is None and any(side % self.multiple for side in rows[0].size):
            height, width = rows[0].size
            raise ValueError(
                f"images are {height}x{width} pixels, and the backbone's patches {self.multiple}; set training.heights "
                f"and training.width, or scenes that come in multiples of that (scenes.multiple={self.multiple})"
            )
        fitted = [row if size is None else fit_views(row, size) for row in rows]
        if self.min_scale < 1:
            # Of the key, so that what is remembered of equal keys is of equal images.
            scales = [generator(self.seed, 10, key, key >> 32).uniform(self.min_scale, 1) for key in keys]
            fitted = [blurred_views(row, float(scale)) for row, scale in zip(fitted, scales, strict=True)]
        return Batch(
            views=stack_views(fitted),
            context=context,
            style=None if self.styles is None else stack_styles(styles),
            keys=tuple(keys),
            skipped=tuple(skipped),
        )

    def _row(self, step: int, row: int, context: int, skipped: list[str]) -> tuple[int, Views, Style]:
        for attempt in range(ATTEMPTS):
            try:
                draw = self._draw(step, row, context, attempt)
                views = self.scenes.read(draw.scene, list(draw.views))
                style = Style() if self.styles is None else self._style(step, row, attempt, draw.style)
            except (ValueError, OSError) as error:
                skipped.append(one_line(error))
                logger.warning("skipped: %s", skipped[-1])
                continue
            if self.style_images and style.image is None:
                continue
            return draw.key, mirror_views(views) if draw.flip else views, style
        last = skipped[-1] if skipped else "a style without an image"
        raise ValueError(f"{ATTEMPTS} draws of scenes and styles could not be read; the last one: {last}")

    def _style(self, step: int, row: int, attempt: int, style: int) -> Style:
        """A style; a source that cuts at random draws from the global generator, seeded by the row here."""
        assert self.styles is not None
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(int(generator(self.seed, 9, step, row, attempt).integers(2**62)))
            return self.styles.read(style)

    def _size(self, step: int, views: Views) -> tuple[int, int] | None:
        if self.heights is None:
            return None
        low, high = self.heights
        steps = generator(self.seed, 4, step).integers(-(-low // self.multiple), high // self.multiple + 1)
        height = int(steps) * self.multiple
        if self.width is not None:
            return height, self.width
        aspect = views.size[1] / views.size[0]
        return height, max(1, round(height * aspect / self.multiple)) * self.multiple


class _Steps(Dataset[Value]):
    """A batch source as a map from steps to batches, for one process."""

    def __init__(self, source: BatchSource, rank: int, world: int) -> None:
        self.source, self.rank, self.world = source, rank, world

    def __getitem__(self, step: int) -> Value:
        return self.source.batch(step, self.rank, self.world)


def _ignore_signals(worker: int) -> None:
    """Ignore SIGINT and SIGTERM in a worker: they reach all processes, and the training needs its batch to end well."""
    for name in (signal.SIGINT, signal.SIGTERM):
        signal.signal(name, signal.SIG_IGN)


class StepLoader:
    """The batches of the steps from ``start`` to ``stop``, in order.

    Its position is the global step, which the trainer's checkpoint holds; ``state_dict`` and ``load_state_dict`` tell
    Lightning that it is resumable.
    """

    def __init__(
        self, source: BatchSource, *, start: int, stop: int, rank: int = 0, world: int = 1, workers: int = 0
    ) -> None:
        self.start, self.stop = start, stop
        # DataLoader draws a base seed from the global generator; its own keeps the training's random numbers apart.
        self.loader = DataLoader(
            _Steps(source, rank, world),
            batch_size=None,
            sampler=range(start, stop),
            num_workers=workers,
            persistent_workers=False,
            worker_init_fn=_ignore_signals,
            generator=torch.Generator().manual_seed(0),
        )

    def __len__(self) -> int:
        return self.stop

    def __iter__(self) -> Iterator[Value]:
        return iter(self.loader)

    def state_dict(self) -> dict[str, Any]:
        """Empty: the trainer holds the step."""
        return {}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Nothing to restore."""


class StepData(pl.LightningDataModule):
    """The data module of a batch source; training starts at the trainer's global step.

    Args:
        train: Batches of training.
        validation: Batches of validation: the first ``validation_steps`` of them, the same each time.
        validation_steps: Number of validation batches.
        workers: Number of processes that prefetch batches; 0 reads in the training process.
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
        done, stop = trainer.global_step, trainer.max_steps
        accumulate = trainer.accumulate_grad_batches
        return StepLoader(
            self.train,
            start=done * accumulate,
            stop=stop * accumulate,
            rank=trainer.global_rank,
            world=trainer.world_size,
            workers=self.workers,
        )

    def val_dataloader(self) -> StepLoader | list[Value]:
        """The validation steps; each process sees all of them."""
        if self.validation is None:
            return []
        return StepLoader(self.validation, start=0, stop=self.validation_steps)
