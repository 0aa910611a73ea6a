"""Colours off a ramp, by light and by a texture laid over the scene."""

from typing import ClassVar

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.contracts import Injector
from anystyle.geometry.harmonics import constant_from_rgb
from anystyle.geometry.texture import sample_texture
from anystyle.perception.ramps import ramp, shares
from anystyle.types import Style, Tokens

REACH = 0.58
"""How much lighter the fitted texture makes a token where the pattern is light than where it is dark."""


class RampTexture(Injector):
    """Put tokens onto the style's ramp: ``x + gate * (dark + shade(x) * (ramp(z)[rank] - dark) - x)``.

    The style gives ``knots`` tokens, its ramp, and a texture; both are linear in the embedding, so that half of the
    way between two styles is half of each. The texture is laid over the scene from the first camera (projective
    texture mapping, Segal et al., "Fast shadows and lighting effects using texture mapping", 1992, section 2), so a
    point has the same place in it in every view. How light a token is, plus what the texture has there, ranks
    the tokens of a scene, and the n-th of them takes the n-th of the ramp's colours: each colour has its share.
    A small network, the same for all styles, reads how light a token is, and how far from ``dark`` it is to be with it,
    off the token itself and off ``(token - mean) / deviation`` over views and places.

    Meant for the colours of pixels: what they show is a gradient map with a pattern in it.

    Args:
        dim: Channels at the site.
        style_dim: Dimensions of the style embedding.
        knots: Of the ramp.
        size: Side of the texture, in samples.
        width: Of the small network's hidden layers.
        fitted: Whether ramp, texture, ``dark`` and gate stay as :meth:`fit` makes them and only the reading of light
            learns. Where a text leaves colours open, gradients draw ramps and gate to what lies between all of them.
            At sites of other than 3 channels, which are no colours, everything learns nevertheless.
        gain: Of the embedding and of the gate. A unit vector's entries shrink with its dimensions, and with them what
            a style changes at first; the root of ``style_dim`` makes up for it where training is short.

    Raises:
        ValueError: ``knots`` is below 2, or ``size`` or ``width`` below 1.
    """

    reads_places: ClassVar[bool] = True

    def __init__(
        self,
        *,
        dim: int,
        style_dim: int,
        knots: int = 8,
        size: int = 64,
        width: int = 32,
        fitted: bool = False,
        gain: float = 1.0,
    ) -> None:
        super().__init__()
        if knots < 2 or size < 1 or width < 1:
            raise ValueError(
                f"injector.knots={knots}, size={size} and width={width} are too few; give at least 2, 1 and 1"
            )
        self.channels, self.knots, self.size = dim, knots, size
        self.gain = gain
        self.ramp = nn.Linear(style_dim, knots * dim)
        self.texture = nn.Linear(style_dim, size * size)
        self.light = nn.Sequential(
            nn.Linear(2 * dim, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU(), nn.Linear(width, 2)
        )
        self.dark = nn.Parameter(torch.zeros(dim))
        self.gate = nn.Parameter(torch.zeros(dim))
        nn.init.zeros_(self.texture.weight)
        nn.init.zeros_(self.texture.bias)
        self.fitted = fitted and dim == 3
        for part in (self.ramp, self.texture, self.dark, self.gate):
            part.requires_grad_(not self.fitted)

    def forward(self, tokens: Tokens, style: Float[Tensor, "B D"]) -> Tokens:
        """Put the tokens onto the style's ramp; special ones stay, and without places there is no texture."""
        code = self.gain * style.to(self.gate.dtype)
        patches = tokens.patches
        rows = patches.flatten(1, 2)  # B (V p) C
        variance, mean = torch.var_mean(rows, dim=1, correction=0, keepdim=True)
        read = self.light(torch.cat([rows, (rows - mean) / (variance + 1e-3).sqrt()], dim=-1))
        place = read[..., 0]
        if tokens.places is not None:
            texture = self.texture(code).unflatten(-1, (1, self.size, self.size))
            place = place + sample_texture(texture, tokens.places.to(texture.dtype)).flatten(1)
        ramp = self.ramp(code).unflatten(-1, (self.knots, -1))
        # A rank is flat between its steps; what is ranked has the gradient (straight-through: Bengio et al. 2013).
        share = shares(place.detach())
        colors = torch.bmm(between_knots(share + place - place.detach(), self.knots), ramp)
        made = torch.lerp(self.dark, colors, 1 + read[..., 1:])
        return tokens.with_patches(torch.lerp(rows, made, self.gain * self.gate).view_as(patches))

    @torch.no_grad()
    def fit(self, embeddings: Float[Tensor, "N K D"], examples: Style) -> None:
        """Solve for the ramp and the texture, where tokens are colours, as harmonics of degree 0.

        Both are linear in the embedding, so that least squares give at once what steps of gradients are long in
        finding: the embedding's directions differ in length by orders of magnitude. The gate is opened if it is not
        to learn.
        """
        if self.channels != 3:
            return
        rows = torch.ones(len(embeddings), dtype=torch.bool) if examples.has_image is None else examples.has_image
        code = self.gain * embeddings
        if examples.image is not None:
            colors = constant_from_rgb(ramp(examples.image[rows], self.knots))
            solve(self.ramp, code[rows], colors.flatten(1))
            self.dark.copy_(constant_from_rgb(torch.zeros_like(self.dark)))
        if examples.pattern is not None:
            drawn = F.adaptive_avg_pool2d(examples.pattern, self.size)
            solve(self.texture, code, REACH * (drawn - 0.5).flatten(1))
        if self.fitted:
            self.gate.fill_(1 / self.gain)


def solve(layer: nn.Linear, inputs: Float[Tensor, "N K D"], outputs: Float[Tensor, "N F"]) -> None:
    """Set a layer to what maps each of ``K`` inputs to one output with the least squares (ridge regression)."""
    design = F.pad(inputs.flatten(0, 1), (0, 1), value=1.0).double()
    wanted = design.T @ outputs.repeat_interleave(inputs.shape[1], 0).double()
    penalty = 1e-6 * len(design) * torch.eye(design.shape[1], device=design.device)
    found = torch.linalg.solve(design.T @ design + penalty, wanted)
    layer.weight.copy_(found[:-1].T)
    layer.bias.copy_(found[-1])


def between_knots(place: Float[Tensor, "B N"], knots: int) -> Float[Tensor, "B N knots"]:
    """How much of each knot there is at each place of [0, 1]: of the two beside it, and 1 in all."""
    along = place[..., None] * (knots - 1)
    return F.relu(1 - (along - torch.arange(knots, device=place.device, dtype=place.dtype)).abs())
