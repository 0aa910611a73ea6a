"""Colours of pixels through the style transfer network."""

from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.contracts import Injector
from anystyle.errors import UserError
from anystyle.geometry.harmonics import CONSTANT
from anystyle.types import Tokens
from anystyle_magenta.prediction import STYLE_DIM
from anystyle_magenta.pretrained import load_transfer
from anystyle_magenta.stylize import MIN_SIDE, stylize_images
from anystyle_magenta.transfer import StyleTransfer


class MagentaInjector(Injector):
    """Stylize the pictures that tokens are: ``x + gate * (stylized(x, z) - x)``.

    Tokens are the colours of the pixels of all views, as harmonics of degree 0. The views are stylized together: the
    normalisations of the network take their statistics over all of them, so that the order of views does not matter
    and a colour does not change with the view it is seen in.

    Args:
        dim: Channels at the site; 3 with published weights.
        style_dim: Dimensions of the style embedding; 100 with published weights.
        working_size: The shorter side in pixels that the network sees the views at; strokes are broader at smaller
            sizes.
        gate: What ``gate`` starts as: 0 is the identity, from which a branch learns; 1 stylizes without any learning.
        pretrained: Whether the network starts from Magenta's weights (``anystyle weights list magenta_transform``).
            One that starts from scratch takes any sites and any embedding.
        chunk: Views convolved at a time, which changes memory alone.

    Raises:
        UserError: The site or the embedding is not what the published weights are for, or a size is too small.
        FileNotFoundError: The package with the weights is not installed.
    """

    def __init__(
        self,
        *,
        dim: int,
        style_dim: int,
        working_size: int = 224,
        gate: float = 0.0,
        pretrained: bool = True,
        chunk: int = 8,
    ) -> None:
        super().__init__()
        if working_size < MIN_SIDE or chunk < 1:
            raise UserError(
                f"injector.working_size={working_size} and chunk={chunk} leave nothing to stylize; give at least "
                f"{MIN_SIDE} and 1"
            )
        if pretrained and (dim, style_dim) != (3, STYLE_DIM):
            raise UserError(
                f"injector=magenta stylizes colours, 3 channels, by the {STYLE_DIM} numbers of style_encoder=magenta; "
                f"the site has {dim} channels and the style {style_dim} numbers; choose placement=color, or "
                "injector.pretrained=false"
            )
        self.working_size, self.chunk = working_size, chunk
        self.network = StyleTransfer(channels=dim, style_dim=style_dim)
        self.gate = nn.Parameter(torch.tensor(float(gate)))
        if pretrained:
            self.sources = (load_transfer(self.network),)

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        return {"pretrained": False, "working_size": 16}

    def forward(self, tokens: Tokens, style: Float[Tensor, "B D"]) -> Tokens:
        """Stylize the patches; special tokens stay."""
        patches = tokens.patches  # B V (H W) C
        # As rgb_from_constant and constant_from_rgb, for any number of channels.
        images = (patches * CONSTANT + 0.5).clamp(0, 1).mT.unflatten(-1, tokens.grid)
        stylized = stylize_images(
            self.network,
            images.to(self.gate.dtype),
            style.to(self.gate.dtype),
            working_size=self.working_size,
            joint=True,
            chunk=self.chunk,
        )
        colors = ((stylized - 0.5) / CONSTANT).flatten(-2).mT.to(patches.dtype)
        return tokens.with_patches(torch.lerp(patches, colors, self.gate.to(patches.dtype)))
