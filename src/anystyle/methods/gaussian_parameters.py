"""Gaussians in the parametrisation that is optimised."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from anystyle.heap import keep_freed
from anystyle.methods.adam import Adam
from anystyle.types import Gaussians

NAMES = ("offsets", "scales", "rotations", "opacities", "colors", "harmonics")
"""Offsets of centres in ``units``, log scales, quaternions, opacity logits, and constant and higher harmonics."""

SMALLEST, MARGIN = 1e-12, 1e-6
"""Scales and opacities are clamped so that logarithms and logits are finite."""


class GaussianParameters:
    """Gaussians of one scene, some of whose attributes are optimised, and their optimiser.

    ``rates`` are learning rates by name of :data:`NAMES`; attributes without one are constant. ``units`` is the length
    in world space that each offset is measured in.
    """

    def __init__(self, gaussians: Gaussians, rates: Mapping[str, float], units: Float[Tensor, " N"]) -> None:
        self.fixed, self.units = gaussians.detach(), units
        g = self.fixed
        values = {
            "offsets": torch.zeros_like(g.means[0]),
            "scales": g.scales[0].clamp_min(SMALLEST).log(),
            "rotations": g.rotations[0],
            "opacities": g.opacities[0].clamp(MARGIN, 1 - MARGIN).logit(),
            "colors": g.harmonics[0, :, :1],
            "harmonics": g.harmonics[0, :, 1:],
        }
        self.parameters = {name: values[name].clone().requires_grad_() for name in NAMES if name in rates}
        self.adam = Adam(self.parameters, {**rates}, betas=(0.9, 0.99), eps=1e-15)
        keep_freed(31 << 20)  # steps on 30,000 Gaussians are a tenth faster

    def __len__(self) -> int:
        return len(self.units)

    def gaussians(self) -> Gaussians:
        """The current Gaussians, differentiable in the parameters."""
        p, g = self.parameters, self.fixed
        constant, higher = p.get("colors", g.harmonics[0, :, :1]), p.get("harmonics", g.harmonics[0, :, 1:])
        return replace(
            g,
            means=(g.means[0] + self.units[:, None] * p["offsets"])[None] if "offsets" in p else g.means,
            rotations=p["rotations"][None] if "rotations" in p else g.rotations,
            scales=p["scales"].exp()[None] if "scales" in p else g.scales,
            opacities=p["opacities"].sigmoid()[None] if "opacities" in p else g.opacities,
            harmonics=torch.cat([constant, higher], dim=1)[None],
        )

    @torch.no_grad()
    def select(self, index: Int[Tensor, " n"]) -> None:
        """Keep the Gaussians at these indices, which may repeat, with their part of the optimiser's state."""
        self.fixed, self.units = self.fixed.map(lambda tensor: tensor[:, index]), self.units[index]
        self.adam.select(index)

    def state_dict(self) -> dict[str, Any]:
        """All that is needed to resume; ``torch.save`` can write it."""
        return {"fixed": dict(vars(self.fixed)), "units": self.units, "adam": self.adam.state_dict()}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore the result of :meth:`state_dict`; the number of Gaussians may differ."""
        self.fixed, self.units = replace(self.fixed, **state["fixed"]), state["units"]
        self.adam.load_state_dict(state["adam"])
