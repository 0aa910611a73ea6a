"""Palette ramp: the n-th darkest pixel of a scene takes the n-th colour of the style."""

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Loss
from anystyle.geometry.texture import sample_texture
from anystyle.perception.compare import mean_where, style_images
from anystyle.perception.ramps import luma, painted, ramp, shares
from anystyle.types import Stylization


class PaletteRamp(Loss):
    """Put the style's colours onto the photographs' light and dark, in equal shares: a gradient map as a target.

    The style's pixels, ordered along their first principal axis from dark to light, are averaged within ``knots``
    equal shares: its ramp. A pixel of a photograph whose luma is above that of a share r of the scene is to have the
    colour at r of the ramp, and the term is the mean squared distance to it, over views whose style has an image.
    Like colour transfer by luminance (Welsh et al. 2002, section 2) it keeps what is light light; by ranks, like the
    exact one-dimensional transport of Pitie et al. 2007 (section 2), it also gives every colour its share. A distance
    between distributions leaves open which pixel takes which colour and is learnt far more slowly; this one settles it.

    With ``pattern``, and where the style's pattern is known by itself (:attr:`anystyle.types.Style.pattern`), that
    pattern is laid over the scene from the first camera, and what is ranked is a mixture of luma and pattern: colours
    keep their shares, and change where the pattern does. ``shade`` gives back the light and dark that it covers.

    Args:
        knots: Of the ramp.
        pattern: Share of the pattern in what is ranked, in [0, 1].
        shade: How much lighter than its place on the ramp the lightest pixel is, and darker the darkest, as a share of
            its colour; in [0, 1].
        weight: In the objective.

    Raises:
        ValueError: ``knots`` is below 2, or a share is outside [0, 1].
    """

    def __init__(self, *, knots: int = 32, pattern: float = 0.0, shade: float = 0.0, weight: float = 10.0) -> None:
        super().__init__()
        if knots < 2:
            raise ValueError(f"loss.palette_ramp.knots is {knots}; give at least 2")
        for name, share in (("pattern", pattern), ("shade", shade)):
            if not 0 <= share <= 1:
                raise ValueError(f"loss.palette_ramp.{name} is {share}; give a share between 0 and 1")
        self.knots, self.pattern, self.shade = knots, pattern, shade
        self.weight = weight

    def forward(self, result: Stylization) -> Float[Tensor, ""]:
        """See :meth:`anystyle.contracts.Loss.forward`."""
        styles = style_images(result)
        if styles is None:
            return result.renders.color.new_zeros(())
        image, given = styles
        with torch.no_grad():
            target = self.target(result, ramp(image, self.knots))
        return mean_where((result.renders.color - target).square().mean((1, 2, 3, 4)), given)

    def target(self, result: Stylization, colors: Float[Tensor, "B knots 3"]) -> Float[Tensor, "B V 3 H W"]:
        """The photographs in the colours of a ramp."""
        light = shares(luma(result.views.images))
        place = light
        if self.pattern and result.style.pattern is not None:
            height, width = light.shape[-2:]
            drawn = sample_texture(result.style.pattern[:, None], result.scene.geometry.places((height, width)))
            place = shares(torch.lerp(light, drawn[..., 0].unflatten(-1, (height, width)), self.pattern))
        shaded = painted(place, colors) * (1 + self.shade * (2 * light - 1))[:, :, None]
        return shaded.clamp(0, 1)
