"""What is minimised and what is measured."""

import functools
import inspect
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, ClassVar, final
from uuid import uuid4

import torch
import torchmetrics
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.errors import UserError, one_line
from anystyle.registry.catalog import Pluggable
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


def accepts_tensors(update: Callable[[Any, Comparison], None], takes: Sequence[str] = ()) -> Callable[..., None]:
    """An ``update`` that takes a comparison, or the arguments of :meth:`Comparison.from_images` that ``takes`` names.

    The framework makes one of every ``update``; written above it, type checkers know. Either is checked before. No
    gradient is recorded, and autocast, as in a validation step of ``bf16-mixed``, is off.
    """
    known = inspect.signature(Comparison.from_images).parameters
    shown = [inspect.Parameter("self", inspect.Parameter.POSITIONAL_OR_KEYWORD)]
    for each in (known[name] for name in takes or known):
        optional = each.kind is each.KEYWORD_ONLY or each.name not in (takes or ("preds", "target"))
        shown.append(each if optional else each.replace(default=each.empty))
    signature = inspect.Signature(shown)

    @functools.wraps(update)
    def from_tensors(self: Any, *args: Any, **kwargs: Any) -> None:
        if not (args and isinstance(args[0], Comparison)):
            try:
                given = signature.bind(self, *args, **kwargs).arguments
            except TypeError as error:
                raise TypeError(f"{type(self).__name__}.update({', '.join(signature.parameters)}): {error}") from None
            args, kwargs = (Comparison.from_images(**{name: given[name] for name in given if name != "self"}),), {}
        else:
            args[0].checked()
        with torch.no_grad(), torch.autocast(args[0].stylized.device.type, enabled=False):
            update(self, *args, **kwargs)

    vars(from_tensors)["__signature__"] = signature
    return from_tensors


def _gathered(tensor: Tensor, group: Any = None) -> list[Tensor]:
    """The state of every process that has one: torchmetrics' own gathering ends a process that has taken in nothing."""
    found: list[Any] = [None] * torch.distributed.get_world_size(group)
    torch.distributed.all_gather_object(found, tensor.cpu(), group=group)
    return [each.to(tensor.device) for each in found if each.numel()] or [tensor]


class Metric(Pluggable, torchmetrics.Metric, ABC):
    """A metric. The framework may pass ``style_encoder`` and ``correspondence`` to the constructor.

    An author writes ``update(self, comparison)``. It is called with a :class:`Comparison` or, as metrics of
    torchmetrics are, with tensors: ``metric.update(preds, target)``.
    """

    many = True
    runtime = ("style_encoder", "correspondence")

    better: ClassVar[Mapping[str, str]]
    """For each score that :meth:`compute` returns, ``higher`` or ``lower``; an instance may have other names."""

    stand_ins: Mapping[str, str] = MappingProxyType({})
    """Set by an instance: for each score that a stand-in network computes, the network's name."""

    weights: Mapping[str, str] = MappingProxyType({})
    """Set by an instance: the SHA-256 of every file of weights that scores rest on, by the file's name."""

    takes: ClassVar[Sequence[str]] = ()
    """The arguments of :meth:`Comparison.from_images` that ``update`` has in the place of a comparison, the positional
    ones required; if none is named, all, and ``preds`` and ``target`` required."""

    gallery: Sequence[Float[Tensor, "3 h w"]] = ()
    """Set by a protocol: further style images to retrieve from, beside those of the comparisons."""

    is_differentiable = False

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        cls.higher_is_better = "lower" not in getattr(cls, "better", {}).values()
        if not {"takes", "update"}.isdisjoint(vars(cls)):
            cls.update = accepts_tensors(inspect.unwrap(cls.update), cls.takes)

    def __init__(self) -> None:
        super().__init__()
        # A MetricCollection goes on updating only one of the metrics that have equal states after the first update, as
        # those of two networks have on equal images. This state is each metric's own.
        self.add_state("own", torch.tensor([*uuid4().bytes]), dist_reduce_fx="max")
        self.dist_sync_fn = _gathered

    @abstractmethod
    def update(self, *args: Any, **kwargs: Any) -> None:
        """Take in stylized scenes: ``update(self, comparison: Comparison)``."""

    @abstractmethod
    def compute(self) -> Tensor | dict[str, Tensor]:
        """The one score of ``better`` over all that was taken in, or a dict where it names several.

        A score is ``nan``, with a warning, where there was too little. Multiply matrices in double precision: autocast,
        which is off in :meth:`update`, rounds others here.
        """

    @final
    def scores(self) -> dict[str, Tensor]:
        """What :meth:`compute` returns, by name, for a metric with one score as well."""
        found = value if isinstance(value := self.compute(), dict) else dict.fromkeys(self.better, value)
        for name, score in found.items():
            if not isinstance(score, Tensor | float) or torch.as_tensor(score).numel() != 1:
                given = f"the metric {type(self).__qualname__} gives {one_line(repr(score))[:80]} as {name}"
                raise UserError(f"{given}; expected one number")
        return found

    def merge_state(self, incoming_state: dict[str, Any] | torchmetrics.Metric) -> None:
        """Take in what another metric of this class, or its ``metric_state``, has taken in."""
        super().merge_state(incoming_state)
        self._computed = None  # which torchmetrics 1.9 keeps, so that an earlier score would be returned again

    def of_each_row(self) -> dict[str, Float[Tensor, " N"]]:
        """Scores that each row taken in, in order, has only beside the others of its scene."""
        return {}

    def plot(self, val: Any = None, ax: Any = None) -> Any:
        """Draw scores as other metrics of torchmetrics do; needs matplotlib (``pip install "anystyle[report]"``).

        Args:
            val: What :meth:`compute` or a call returned, or a list of these, one per step; computed if not given.
            ax: Matplotlib's axes to draw on.

        Returns:
            Matplotlib's figure and axes.
        """
        return self._plot(self.scores() if val is None else val, ax)


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
