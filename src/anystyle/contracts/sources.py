"""What is learnt from and judged on."""

from abc import ABC, abstractmethod
from collections.abc import Sequence

from anystyle.registry.pluggable import Pluggable
from anystyle.types import Style, Views


class SceneSource(Pluggable, ABC):
    """Scenes to learn from or to be judged on, read at random; all views of one scene have one size."""

    runtime = ("resolution", "patch_size")

    @abstractmethod
    def __len__(self) -> int:
        """How many scenes there are."""

    @abstractmethod
    def name(self, scene: int) -> str:
        """A name for a scene, unique within the source."""

    @abstractmethod
    def num_views(self, scene: int) -> int:
        """How many views a scene has, in capture order."""

    @abstractmethod
    def read(self, scene: int, views: Sequence[int]) -> Views:
        """Some views of one scene as a batch of one, on the CPU; nothing else is decoded."""


class StyleSource(Pluggable, ABC):
    """Styles to learn from or to be judged on, read at random; all images have one size."""

    @abstractmethod
    def __len__(self) -> int:
        """How many styles there are."""

    @abstractmethod
    def read(self, style: int) -> Style:
        """One style as a batch of one, on the CPU."""
