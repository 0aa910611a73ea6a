"""How checkpoints that others published load: what backbones and style encoders say of theirs."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence

from torch import Tensor, nn

from anystyle.types import Site


class Published(ABC):
    """Checkpoints that others published for a backbone: how they are told apart, and how they load.

    A state dict has its publishers' names, with or without the prefixes of its file. Methods raise a ValueError of one
    line where it is of another network. The defaults are those of checkpoints without a style branch.
    """

    @abstractmethod
    def without_prefix(self, state: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The tensors under their publishers' names without prefixes, whichever of the files they come from."""

    @abstractmethod
    def options(self, state: Mapping[str, Tensor]) -> dict[str, object]:
        """Options of the backbone whose weights these are, as far as shapes tell."""

    @abstractmethod
    def load_backbone(self, backbone: nn.Module, state: Mapping[str, Tensor]) -> None:
        """Load the reconstruction network, strictly; a module on the meta device takes the tensors themselves."""

    def complete(self, state: Mapping[str, Tensor]) -> bool:
        """Whether the state dict holds all of the reconstruction network, or is an initialisation of parts of it."""
        return True

    def placement(self, state: Mapping[str, Tensor]) -> str | None:
        """The placement that the style branch in it was trained with; ``None`` if it holds none."""
        return None

    def injector_options(self, state: Mapping[str, Tensor], sites: Sequence[Site]) -> dict[str, dict[str, int]]:
        """For each site, options of the injector whose weights these are; empty without a style branch."""
        return {}

    def load_branch(self, branch: nn.Module, state: Mapping[str, Tensor]) -> None:
        """Load the style branch, strictly."""
        raise ValueError("the checkpoint holds no style branch; give one that anystyle trained, or null")

    def text_adapter(self, state: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """What a style encoder that the branch was trained with adds to its own weights; empty if nothing."""
        return {}


class PublishedEncoder(ABC):
    """How a style encoder's weights load that others published."""

    @abstractmethod
    def load(self, encoder: nn.Module, state: Mapping[str, Tensor]) -> None:
        """Load publishers' names, strictly; a module on the meta device takes the tensors themselves."""

    def load_text_adapter(self, encoder: nn.Module, state: Mapping[str, Tensor]) -> None:
        """Load what a style branch was trained with on top of them; see :meth:`Published.text_adapter`."""
        if state:
            raise ValueError(
                f"the style branch was trained with a text adapter, which a {type(encoder).__name__} has not; choose "
                "the style encoder it was trained with"
            )
