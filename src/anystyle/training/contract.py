"""What a training promises: a Lightning module that says what it reads and what it leaves behind."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import TypeVar, final

import lightning.pytorch as pl
from torch import nn

from anystyle.contracts import SceneSource, StyleSource
from anystyle.registry.socket import Socket
from anystyle.training.data import BatchSource
from anystyle.training.sharding import shard


class Training(Socket, pl.LightningModule, ABC):
    """One of the trainings that ``anystyle train`` runs.

    The constructor names the parts it needs among ``backbone``, ``style_encoder``, ``renderer``, ``stylizer`` and
    ``losses``, which the framework passes, and further options. A step draws no random number but from the global
    generator, which the framework seeds anew before every step: so a continued run equals an uninterrupted one.
    """

    @abstractmethod
    def batches(self, scenes: SceneSource | None, styles: StyleSource | None, *, seed: int) -> BatchSource:
        """What each step reads.

        Raises:
            ValueError: A source that this training needs is not configured.
        """

    @classmethod
    def example_sources(cls) -> tuple[SceneSource, StyleSource] | None:
        """Small scenes and styles that a batch can be made of, for checks; ``None`` where any will do."""
        return None

    @abstractmethod
    def exports(self) -> Mapping[str, nn.Module]:
        """What the run is for: modules to be written as weights files, by the part they are."""

    def units(self) -> Sequence[nn.Module]:
        """Parts of what is exported that ``trainer=fsdp`` gathers one at a time; the rest is gathered as one."""
        return ()

    @final
    def configure_model(self) -> None:
        """Share out what learns among the processes, where ``trainer=fsdp`` asks for it."""
        if self.device_mesh is not None:
            shard(list(self.exports().values()), self.units(), self.device_mesh["data_parallel"])


Source = TypeVar("Source", SceneSource, StyleSource)


def required(source: Source | None, kind: str) -> Source:
    """A source that must be configured.

    Raises:
        ValueError: It is not.
    """
    if source is None:
        raise ValueError(f"this training needs {kind}; add {kind}=NAME (`anystyle plugins {kind}` lists them)")
    return source
