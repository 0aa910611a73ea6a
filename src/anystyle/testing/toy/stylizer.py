"""All toys put together: the smallest stylizer, styled at every site."""

from anystyle.branch import StyleBranch
from anystyle.stylizer import Stylizer
from anystyle.testing.toy.backbone import ToyBackbone
from anystyle.testing.toy.injector import ToyInjector
from anystyle.testing.toy.renderer import ToyRenderer
from anystyle.testing.toy.style_encoder import ToyStyleEncoder


class ToyStylizer(Stylizer):
    """The toy plugins, with an untrained branch."""

    def __init__(self) -> None:
        backbone, encoder = ToyBackbone(dim=12, depth=2), ToyStyleEncoder()
        make = lambda site: ToyInjector(dim=site.dim, style_dim=encoder.dim)  # noqa: E731
        branch = StyleBranch(backbone, sites=backbone.sites, make_injector=make)
        super().__init__(backbone=backbone, style_encoder=encoder, branch=branch, renderer=ToyRenderer())
