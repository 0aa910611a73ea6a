"""The style branch: trainable copies of a backbone's parts, with an injector at each chosen site."""

import copy
from collections.abc import Callable, Sequence
from dataclasses import replace

from torch import nn

from anystyle.contracts import Backbone, Injector
from anystyle.types import Attributes, Scene, Site, StyleEmbedding, Tokens

ATTRIBUTES = ("opacity", "scale", "rotation", "color")


class StyleBranch(nn.Module):
    """Predicts styled attributes for an encoded scene (paper section 3.2).

    The Gaussian head is always copied; the aggregator only if one of its sites is chosen, for otherwise its features
    are those of the scene. At initialisation every injector is the identity and the copies compute what the originals
    do, so a stylized scene equals the unstyled one bit for bit.

    Args:
        backbone: The network to copy from; left as it is.
        sites: Where style enters.
        make_injector: Builds the injector of a site.
        styled: The attributes taken from this branch, of ``opacity, scale, rotation, color``; the paper styles
            rotation and colour, its ablation "all geometry" all four.
        sh_degree: Degree of the styled colours; the published weights use the constant coefficient alone.

    Raises:
        ValueError: An attribute is unknown, or named twice.
    """

    def __init__(
        self,
        backbone: Backbone,
        *,
        sites: Sequence[Site],
        make_injector: Callable[[Site], Injector],
        styled: Sequence[str] = ("rotation", "color"),
        sh_degree: int = 0,
    ) -> None:
        super().__init__()
        unknown = [name for name in styled if name not in ATTRIBUTES]
        if unknown or len(set(styled)) != len(styled):
            raise ValueError(f"styled attributes are {list(styled)}; choose each once from {', '.join(ATTRIBUTES)}")
        chosen = {site.name for site in sites}
        copies_aggregator = any(site.name in chosen for site in backbone.aggregator.sites)
        self.styled = tuple(styled)
        self.sh_degree = sh_degree
        self.aggregator = copy.deepcopy(backbone.aggregator).requires_grad_() if copies_aggregator else None
        self.gaussian_head = copy.deepcopy(backbone.gaussian_head).requires_grad_()
        self.injectors = nn.ModuleDict({site.name: make_injector(site) for site in sites})

    def forward(self, scene: Scene, embedding: StyleEmbedding) -> Attributes:
        """The attributes of ``scene`` in each style; scenes and styles are paired row by row."""

        def inject(site: str, tokens: Tokens) -> Tokens:
            if site not in self.injectors:
                return tokens
            injector = self.injectors[site]
            return injector(placed(tokens, scene) if injector.reads_places else tokens, embedding.vector)

        features = scene.features if self.aggregator is None else self.aggregator(scene.stem, inject)
        return self.gaussian_head(features, scene.views.images, inject).with_degree(self.sh_degree)


def placed(tokens: Tokens, scene: Scene) -> Tokens:
    """Tokens that know where the first camera sees what they show."""
    places = scene.geometry.places(tokens.grid)
    if tokens.order is not None:
        places = places.gather(1, tokens.order[..., None, None].expand_as(places))
    return replace(tokens, places=places)
