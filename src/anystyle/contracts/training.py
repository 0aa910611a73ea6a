"""The contract of a training: a Lightning module that names its data and the weights that it exports."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import ClassVar, Literal, Protocol, runtime_checkable

import lightning.pytorch as pl
from torch import nn

from anystyle.contracts.scene import SceneSource, StyleSource
from anystyle.registry.catalog import Pluggable
from anystyle.types import Value


@runtime_checkable
class BatchSource(Protocol):
    """A source of batches by step; a batch may say its ``num_images``, for the throughput."""

    def batch(self, step: int, rank: int, world: int) -> Value:
        """The rows of ``step`` of process ``rank`` of ``world``."""
        ...


class Training(Pluggable, pl.LightningModule, ABC):
    """What ``anystyle train`` trains, by one optimizer: ``training_step`` and ``configure_optimizers`` are Lightning's.

    The constructor names the parts it needs among ``backbone``, ``style_encoder``, ``renderer``, ``stylizer`` and
    ``losses``, which the framework passes, and further options. A step takes its random numbers from the global
    generator alone, which the framework seeds before every step: so a resumed run equals an uninterrupted one.
    """

    runtime = ("backbone", "renderer", "style_encoder", "stylizer", "losses", "features")

    needs: ClassVar[tuple[Literal["scenes", "styles"], ...]] = ()
    """The sources without which there are no batches; a run is refused before networks are loaded."""

    @abstractmethod
    def batches(self, scenes: SceneSource | None, styles: StyleSource | None, *, seed: int) -> BatchSource:
        """The batch of every step."""

    @abstractmethod
    def exports(self) -> Mapping[str, nn.Module]:
        """The modules whose weights are written at the end, by the part that they are, such as ``branch``."""
