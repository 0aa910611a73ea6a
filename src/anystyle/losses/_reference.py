"""What a stylized view is compared with: the photograph, or the render of the unstyled scene."""

from typing import Literal

from jaxtyping import Float
from torch import Tensor

from anystyle.types import Stylization

Reference = Literal["photograph", "render"]


def reference_images(result: Stylization, reference: Reference) -> Float[Tensor, "B V 3 H W"]:
    """The images before the change of style.

    Raises:
        ValueError: The unstyled render is asked for, and there is none.
    """
    if reference == "photograph":
        return result.views.images
    if result.unstyled is None:
        raise ValueError("reference=render compares with the unstyled scene, of which this training makes no render")
    return result.unstyled.color
