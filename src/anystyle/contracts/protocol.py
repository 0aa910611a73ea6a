"""Protocols and their results: scores of a model or of images, with everything that they rest on."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from anystyle.registry.catalog import Pluggable
from anystyle.types import OnProgress

SCENE = "scene "
"""The prefix of groups that hold the scores of one scene."""


@dataclass(frozen=True)
class Row:
    """The scores of one scene in one style.

    Args:
        scene: Its name; empty where a row stands for a style over all scenes.
        style: Its name; empty where a row stands for a scene over all styles.
        scores: Value by name; ``nan`` where there were too few images.
        pictures: Images to show, by kind (``photograph``, ``style``, ``result``).
        n: Number of images, where they were counted.
        missing: Number of images that there should be besides.
    """

    scene: str
    style: str
    scores: Mapping[str, float]
    pictures: Mapping[str, Path] = field(default_factory=dict)
    n: int | None = None
    missing: int = 0


@dataclass(frozen=True)
class Evaluation:
    """The result of a protocol.

    Args:
        scores: Value by name, over everything; ``nan`` where there were too few images.
        n: Number of samples (images, unless ``provenance`` says otherwise) behind the scores.
        better: ``higher`` or ``lower`` for scores that have a better direction.
        groups: Further scores by name of a group, such as ``baseline`` or one scene.
        rows: The scores of each scene in each style.
        stand_ins: The name of the stand-in network behind a score, which is not comparable with published ones.
        times: Measured seconds by name; lower is better, and they vary between runs.
        provenance: What else the scores rest on, such as the variant, as JSON values.
    """

    scores: Mapping[str, float]
    n: int
    better: Mapping[str, str] = field(default_factory=dict)
    groups: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    rows: tuple[Row, ...] = ()
    stand_ins: Mapping[str, str] = field(default_factory=dict)
    times: Mapping[str, float] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def scenes(self) -> dict[str, Mapping[str, float]]:
        """The scores of each scene; those over all scenes where there is only one."""
        scenes = {name.removeprefix(SCENE): group for name, group in self.groups.items() if name.startswith(SCENE)}
        names = self.provenance.get("scenes", [])
        return scenes or ({str(names[0]): self.scores} if len(names) == 1 and names[0] else {})

    @property
    def size(self) -> str:
        """How many samples, and of how many if some are missing."""
        return f"{self.n} of {self.n + missing}" if (missing := self.missing()) else str(self.n)

    def missing(self, group: str = "") -> int:
        """How many images are missing, of everything or of one group, such as a scene."""
        name = group.removeprefix(SCENE)
        gaps: list[dict[str, Any]] = self.provenance.get("missing", [])
        return sum(gap["missing"] for gap in gaps if name in ("", gap["scene"]) or gap["scene"].startswith(f"{name}/"))

    def with_facts(self, **facts: Any) -> "Evaluation":
        """This evaluation with more provenance."""
        return replace(self, provenance={**self.provenance, **facts})


class Protocol(Pluggable, ABC):
    """How a model, or any method's images, are judged: ``anystyle evaluate protocol=NAME``.

    The constructor names the parts it needs among ``stylizer`` (in ``eval``, without gradients), ``method`` (how its
    scenes take styles), ``metrics`` (by name), ``scenes`` and ``styles``, which the framework passes, and further
    options. A source that is not configured is ``None``. Where the constructor has ``inputs=None``, it is given what
    :meth:`check` returned.
    """

    runtime = ("stylizer", "method", "metrics", "scenes", "styles", "inputs")

    @classmethod
    def check(cls, **given: Any) -> Any:
        """Find the inputs, before any network is built.

        Args:
            given: The constructor's options, ``scenes`` and ``styles``.

        Raises:
            UserError: Inputs are missing.
        """

    @abstractmethod
    def run(self, out: Path, on_progress: OnProgress) -> Evaluation:
        """Compute the scores.

        Expensive results are written below ``out`` as they are finished, under their final name only when they are
        complete, and read the next time: an interrupted run resumes and ends with the scores of an uninterrupted one.
        The names ``metrics.*``, ``table.*`` and ``*.png`` in ``out`` itself are reserved for the command.

        Args:
            out: An existing folder.
            on_progress: Called for every step that takes a second or more.

        Raises:
            UserError: Something that the protocol needs is missing or does not fit.
        """
