"""Colours off a ramp, by light and by a texture laid over the scene."""

from typing import ClassVar

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.contracts import Injector
from anystyle.geometry.texture import sample_texture
from anystyle.types import Tokens


class RampTexture(Injector):
    """Put tokens onto the style's ramp: ``x + gate * (ramp(z)[light(x) + texture(z)] + shade(x) - x)``.

    The style gives ``knots`` tokens, its ramp, and a texture; both are linear in the embedding, so that half of the
    way between two styles is half of each. The texture is laid over the scene from the first camera (projective
    texture mapping, Segal et al., "Fast shadows and lighting effects using texture mapping", 1992, section 2), so a
    point has the same place in it in every view. Where a token lies on the ramp is how light it is among the scene's
    tokens plus what the texture has there; a small network, the same for all styles, reads the former off the token
    itself and off ``(token - mean) / deviation`` over views and places.

    Meant for the colours of pixels: what they show is a gradient map with a pattern in it.

    Args:
        dim: Channels at the site.
        style_dim: Dimensions of the style embedding.
        knots: Of the ramp.
        size: Side of the texture, in samples.
        width: Of the small network's hidden layers.
        gain: Of the embedding and of the gate. A unit vector's entries shrink with its dimensions, and with them what
            a style changes at first; the root of ``style_dim`` makes up for it where training is short.

    Raises:
        ValueError: ``knots`` is below 2, or ``size`` or ``width`` below 1.
    """

    reads_places: ClassVar[bool] = True

    def __init__(
        self, *, dim: int, style_dim: int, knots: int = 8, size: int = 64, width: int = 32, gain: float = 1.0
    ) -> None:
        super().__init__()
        if knots < 2 or size < 1 or width < 1:
            raise ValueError(
                f"injector.knots={knots}, size={size} and width={width} are too few; give at least 2, 1 and 1"
            )
        self.knots, self.size = knots, size
        self.gain = gain
        self.ramp = nn.Linear(style_dim, knots * dim)
        self.texture = nn.Linear(style_dim, size * size)
        self.light = nn.Sequential(
            nn.Linear(2 * dim, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU(), nn.Linear(width, 1 + dim)
        )
        self.gate = nn.Parameter(torch.zeros(dim))
        nn.init.zeros_(self.texture.weight)
        nn.init.zeros_(self.texture.bias)

    def forward(self, tokens: Tokens, style: Float[Tensor, "B D"]) -> Tokens:
        """Put the tokens onto the style's ramp; special ones stay, and without places there is no texture."""
        code = self.gain * style.to(self.gate.dtype)
        patches = tokens.patches
        rows = patches.flatten(1, 2)  # B (V p) C
        variance, mean = torch.var_mean(rows, dim=1, correction=0, keepdim=True)
        read = self.light(torch.cat([rows, (rows - mean) / (variance + 1e-3).sqrt()], dim=-1))
        place = 0.5 + read[..., 0]
        if tokens.places is not None:
            texture = self.texture(code).unflatten(-1, (1, self.size, self.size))
            place = place + sample_texture(texture, tokens.places.to(texture.dtype)).flatten(1)
        ramp = self.ramp(code).unflatten(-1, (self.knots, -1))
        made = torch.bmm(between_knots(place, self.knots), ramp) + read[..., 1:]
        return tokens.with_patches(torch.lerp(rows, made, self.gain * self.gate).view_as(patches))


def between_knots(place: Float[Tensor, "B N"], knots: int) -> Float[Tensor, "B N knots"]:
    """How much of each knot there is at each place of [0, 1]: of the two beside it, and 1 in all.

    Beyond the ends the weight of the end falls and that of its neighbour stays 0, by a hundredth of the way: too
    little to be seen, but the gradient leads back.
    """
    inside = place.clamp(0, 1)
    along = (inside + 0.01 * (place - inside))[..., None] * (knots - 1)
    return F.relu(1 - (along - torch.arange(knots, device=place.device, dtype=place.dtype)).abs())
