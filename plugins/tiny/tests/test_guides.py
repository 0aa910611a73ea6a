"""``protocol=guides`` on a stylizer that paints known pictures at known depths: every figure in closed form."""

from dataclasses import replace

import pytest
import torch
import torch.nn.functional as F

from anystyle.branch import StyleBranch
from anystyle.stylizer import Stylizer
from anystyle.testing.toy.backbone import ToyBackbone
from anystyle.testing.toy.injector import ToyInjector
from anystyle.testing.toy.metric import ToyMetric
from anystyle.testing.toy.renderer import ToyRenderer
from anystyle.testing.toy.scenes import ToyScenes
from anystyle.testing.toy.style_encoder import ToyStyleEncoder
from anystyle.testing.toy.styles import ToyStyles
from anystyle.types import Renders, StyleEmbedding, no_progress
from anystyle_tiny.guides import TextAndImage

STYLES, SHARE, FARTHER = 3, 0.8, {"text": 0.1, "image": -0.3}


class Painter(Stylizer):
    """Paints the image of a style that it is given as a text, and that of the next one for a style given as an image.

    Its renders are farther off than the unstyled ones by a factor that the guide decides, and nowhere quite solid.
    """

    def __init__(self, styles):
        backbone, encoder = ToyBackbone(dim=12, depth=2), ToyStyleEncoder()
        branch = StyleBranch(
            backbone, sites=backbone.sites, make_injector=lambda site: ToyInjector(dim=site.dim, style_dim=4)
        )
        super().__init__(backbone=backbone, style_encoder=encoder, branch=branch, renderer=ToyRenderer())
        self.known = [styles.read(place) for place in range(STYLES)]
        self.wanted = None

    def embed(self, *, text=None, image=None):
        same = [style.text == text if image is None else style.image.equal(image) for style in self.known]
        vector = torch.tensor([[float(same.index(True)), float(text is None), 0.0, 0.0]])
        return StyleEmbedding(vector, vector)

    def restyle(self, scene, embedding):
        place, by_image = (int(value) for value in embedding.vector[0, :2])
        self.wanted = ((place + by_image) % STYLES, FARTHER["image" if by_image else "text"])
        return super().unstyled(scene)

    def unstyled(self, scene):
        self.wanted = None
        return super().unstyled(scene)

    def render(self, gaussians, cameras):
        views, size = cameras.intrinsics.shape[1], cameras.size
        place, farther = self.wanted or (0, 0.0)
        picture = F.interpolate(self.known[place].image, size)[:, None].expand(1, views, 3, *size)
        depth = torch.linspace(1, 3, size[0] * size[1]).reshape(1, 1, *size).expand(1, views, *size)
        return Renders(
            color=picture, depth=SHARE * depth * torch.tensor(farther).exp(), alpha=torch.full_like(depth, SHARE)
        )


@pytest.fixture
def protocol():
    styles = ToyStyles(size=16, period=8)
    counts = {"num_scenes": 2, "num_styles": STYLES, "num_views": 2}
    return TextAndImage(
        stylizer=Painter(styles), metrics={"toy": ToyMetric()}, scenes=ToyScenes(), styles=styles, **counts
    )


def test_figures_are_those_of_what_was_painted(protocol, tmp_path):
    found = protocol.run(tmp_path, no_progress)
    painter, scenes = protocol.stylizer, protocol.scenes
    for guide, farther in FARTHER.items():
        assert found.figures[f"depth_change_{guide}"] == pytest.approx(abs(farther), rel=1e-5)
        changes = []
        for scene in range(2):
            views = scenes.read(scene, [0, 1]).images
            for place in range(STYLES):
                image = painter.known[(place + (guide == "image")) % STYLES].image
                changes.append((F.interpolate(image, views.shape[-2:]) - views[0]).abs().mean())
        assert found.figures[f"change_{guide}"] == pytest.approx(float(torch.stack(changes).mean()), rel=1e-5)
    assert found.better["depth_change_text"] == "lower"
    # Each guide has six rows of two views; a row of the table holds both guides' figures.
    assert (found.n, len(found.rows)) == (2 * 2 * STYLES * 2, 2 * STYLES)
    assert {f"{name}_{guide}" for name in ("change", "depth_change") for guide in FARTHER} == set(found.rows[0].figures)
    # The sheet of a report is made of what texts led to.
    assert len(list((tmp_path / "images" / "stylized").rglob("*.png"))) == 2 * STYLES * 2


def test_a_style_without_a_text_is_refused(protocol, tmp_path, monkeypatch):
    read = protocol.styles.read
    monkeypatch.setattr(protocol.styles, "read", lambda place: replace(read(place), text=None))
    with pytest.raises(ValueError, match="style 0 lacks its image or its text"):
        protocol.run(tmp_path, no_progress)
