"""All toys put together: the smallest stylizer."""

from anystyle.branch import StyleBranch, sites_of
from anystyle.stylizer import Stylizer
from anystyle.testing.toy.backbone import ToyBackbone
from anystyle.testing.toy.injector import ToyInjector
from anystyle.testing.toy.renderer import ToyRenderer
from anystyle.testing.toy.style_encoder import ToyStyleEncoder


class ToyStylizer(Stylizer):
    """The toy plugins, with an untrained branch at every site of the backbone, or ``only`` at one."""

    def __init__(self, only: str | None = None) -> None:
        backbone, encoder = ToyBackbone(dim=12, depth=2), ToyStyleEncoder()
        make = lambda site: ToyInjector(dim=site.dim, style_dim=encoder.dim)  # noqa: E731
        sites = backbone.sites if only is None else [site for site in sites_of(backbone) if site.name == only]
        branch = StyleBranch(backbone, sites=sites, make_injector=make)
        super().__init__(backbone=backbone, style_encoder=encoder, branch=branch, renderer=ToyRenderer())
