"""How checkpoints that others published for a backbone load."""

from abc import ABC, abstractmethod
from collections.abc import Mapping

from torch import Tensor, nn


class Published(ABC):
    """Recognises a backbone's published checkpoints, says what they need, and loads them.

    State dicts have their publishers' names, with or without the prefixes of their file. Every method raises a
    :class:`~anystyle.errors.UserError` where the checkpoint is of another network.
    """

    @abstractmethod
    def config(self, state: Mapping[str, Tensor]) -> dict[str, object]:
        """What the checkpoint fixes of a configuration, as far as its shapes show it.

        Keys are those of overrides: ``backbone.dim``, and for a checkpoint with a style branch ``placement`` and
        all other options that the branch was trained with.
        """

    @abstractmethod
    def parts(self, state: Mapping[str, Tensor]) -> dict[str, bool]:
        """The parts it has weights of (``backbone``, ``style_encoder``, ``branch``), and whether it has all of them.

        A checkpoint that initialises part of a backbone, or adds to the weights of a style encoder, has not all.
        """

    @abstractmethod
    def load(self, part: str, module: nn.Module, state: Mapping[str, Tensor]) -> None:
        """Load one part, strictly; a module on the meta device takes the tensors themselves.

        A file that is named as ``weights.branch`` is loaded into the branch and, for what the branch was trained with,
        into the style encoder.
        """
