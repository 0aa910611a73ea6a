"""What a training minimises."""

from abc import ABC, abstractmethod

from jaxtyping import Float
from torch import Tensor, nn

from anystyle.registry.pluggable import Pluggable
from anystyle.types import Stylization


class Loss(Pluggable, nn.Module, ABC):
    """One unweighted term of the objective. The framework may pass ``style_encoder`` to the constructor."""

    many = True
    runtime = ("style_encoder",)

    weight: float
    needs_unstyled: bool = False
    """Set by an instance that compares with renders of the unstyled scene, which the training then makes as well."""

    @abstractmethod
    def forward(self, result: Stylization) -> Float[Tensor, ""]:
        """The term's value for a batch; the framework multiplies by ``weight``."""
