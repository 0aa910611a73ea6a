"""Protocols and their results: figures of a model or of images, with all that they rest on."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

from anystyle.registry.socket import Socket

Progress = Callable[[str, int, int], None]
"""Called with the name of a stage, the number of its steps that are done, and that of all its steps."""


SCENE = "scene "
"""The names of groups that hold one scene's figures begin so."""


@dataclass(frozen=True)
class Row:
    """The figures of one scene in one style.

    Args:
        scene: Its name; empty where a row stands for a style over all scenes.
        style: Its name; empty where a row stands for a scene over all styles.
        figures: Value by name; ``nan`` where there was too little.
        pictures: Images to show, by kind (``photograph``, ``style``, ``result``), as far as there are any.
    """

    scene: str
    style: str
    figures: Mapping[str, float]
    pictures: Mapping[str, Path] = field(default_factory=dict)


@dataclass(frozen=True)
class Evaluation:
    """The result of a protocol.

    Args:
        figures: Value by name, over everything; ``nan`` where there was too little.
        n: Number of samples (images, unless ``provenance`` says otherwise) behind the figures.
        better: ``higher`` or ``lower`` for figures of which one is better.
        groups: More figures by name under a name, such as those of ``baseline`` or of one scene.
        rows: Those of each scene in each style.
        stand_ins: For each figure that a stand-in network computed, the network's name; not comparable with figures
            of the network it stands for.
        times: Seconds by name. They are measured, hence not the same twice; lower is better.
        provenance: What else the figures rest on, such as the variant, in plain values that JSON can hold.
    """

    figures: Mapping[str, float]
    n: int
    better: Mapping[str, str] = field(default_factory=dict)
    groups: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    rows: tuple[Row, ...] = ()
    stand_ins: Mapping[str, str] = field(default_factory=dict)
    times: Mapping[str, float] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def scenes(self) -> dict[str, Mapping[str, float]]:
        """The figures of each scene; those over all scenes where there is one."""
        scenes = {name.removeprefix(SCENE): group for name, group in self.groups.items() if name.startswith(SCENE)}
        names = self.provenance.get("scenes", [])
        return scenes or ({str(names[0]): self.figures} if len(names) == 1 and names[0] else {})

    def with_facts(self, **facts: Any) -> "Evaluation":
        """This evaluation with more in its provenance."""
        return replace(self, provenance={**self.provenance, **facts})


class Protocol(Socket, ABC):
    """How a model, or any method's images, are judged: ``anystyle evaluate protocol=NAME``.

    The constructor names the parts it needs among ``stylizer`` (in ``eval``, without gradients), ``method`` (how its
    scenes take styles), ``metrics`` (by name), ``scenes`` and ``styles``, which the framework passes, and further
    options. Where a source is not configured, ``None`` is passed.
    """

    @abstractmethod
    def run(self, out: Path, progress: Progress) -> Evaluation:
        """Compute the figures.

        Results that take long are written below ``out`` as they are finished, under their final name only when they
        are complete, and read the next time: an interrupted run goes on, and ends with the figures of an uninterrupted
        one. The names ``metrics.*``, ``table.*`` and ``*.png`` in ``out`` itself are the command's.

        Args:
            out: A folder that exists.
            progress: Called for every step that takes a second or more.

        Raises:
            ValueError: Something that the protocol needs is missing or does not fit.
        """


Part = TypeVar("Part")


def required(part: Part | None, kind: str) -> Part:
    """A part that must be configured.

    Raises:
        ValueError: It is not.
    """
    if part is None:
        raise ValueError(f"this protocol needs {kind}; add {kind}=NAME (`anystyle plugins {kind}` lists them)")
    return part
