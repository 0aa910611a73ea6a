"""What is minimised and what is measured."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, ClassVar

import torchmetrics
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.registry.pluggable import Pluggable
from anystyle.types import Comparison, Flow, Frames, Source, Stylization


class Loss(Pluggable, nn.Module, ABC):
    """One unweighted term of the objective. The framework may pass ``style_encoder`` to the constructor."""

    many = True
    runtime = ("style_encoder",)

    weight: float
    needs_unstyled: bool = False
    """Set by an instance that compares with renders of the unstyled scene, which the training then makes as well."""
    needs_identity: bool = False
    """Set by an instance that reads renders in the style of the scene's first photograph, which are then made, too."""

    @abstractmethod
    def forward(self, result: Stylization) -> Float[Tensor, ""]:
        """The term's value for a batch; the framework multiplies by ``weight``."""


class Metric(Pluggable, torchmetrics.Metric, ABC):
    """A figure of merit. The framework may pass ``style_encoder`` and ``correspondence`` to the constructor."""

    many = True
    runtime = ("style_encoder", "correspondence")

    better: ClassVar[Mapping[str, str]]
    """For each name that :meth:`compute` returns, ``higher`` or ``lower``; an instance may have other names."""

    timed: ClassVar[bool] = False
    """Whether its figures are times, which vary between runs on the same images."""

    stand_ins: Mapping[str, str] = MappingProxyType({})
    """Set by an instance: for each figure that a stand-in network computes, the network's name."""

    weights: Mapping[str, str] = MappingProxyType({})
    """Set by an instance: the SHA-256 of every file of weights that figures rest on, by the file's name."""

    gallery: Sequence[Float[Tensor, "3 h w"]] = ()
    """Set by a protocol: further style images to retrieve from, beside those of the comparisons."""

    is_differentiable = False

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        cls.higher_is_better = "lower" not in getattr(cls, "better", {}).values()

    @abstractmethod
    def update(self, comparison: Comparison) -> None:
        """Take in stylized scenes."""

    @abstractmethod
    def compute(self) -> dict[str, Tensor]:
        """The figures over all that was taken in; ``nan`` with a warning where there was too little."""

    def of_each_row(self) -> dict[str, Float[Tensor, " N"]]:
        """Figures that each row taken in, in order, has only beside the others of its scene."""
        return {}

    def plot(self, val: Any = None, ax: Any = None) -> Any:
        """Draw figures as other metrics of torchmetrics do; needs matplotlib (``pip install "anystyle[report]"``).

        Args:
            val: What :meth:`compute` or a call returned, or a list of these, one per step; computed if not given.
            ax: Matplotlib's axes to draw on.

        Returns:
            Matplotlib's figure and axes.
        """
        return self._plot(val, ax)


class Correspondence(Pluggable, ABC):
    """Where the pixels of one frame are seen in another."""

    sources: tuple[Source, ...] = ()
    """The networks it rests on; set by the constructor of one that has any."""

    @abstractmethod
    def __call__(self, source: Frames, target: Frames) -> Flow:
        """Flow from ``source`` to ``target``, pair by pair.

        Raises:
            ValueError: The frames lack what this correspondence needs, or are too small for it.
        """

    def displacement(self, source: Frames, target: Frames) -> Float[Tensor, "M 2 H W"]:
        """The flow without visibility; override it where that is cheaper.

        Raises:
            ValueError: As :meth:`__call__`.
        """
        return self(source, target).displacement
