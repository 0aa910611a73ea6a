"""The bundled judge: who finds styles that it has not seen, on scenes too, and is another network than the encoder."""

import pytest
import torch

from anystyle.contracts import StyleEncoder
from anystyle.io.checkpoint import read_header
from anystyle.perception import weights
from anystyle_tiny.evaluation.styles import load_judge
from anystyle_tiny.procedural.scenes import ProceduralScenes
from anystyle_tiny.procedural.styles import ProceduralStyles
from anystyle_tiny.training.contrast import lit_by


@pytest.fixture(scope="module")
def judge() -> StyleEncoder:
    return load_judge("tiny_judge")


def test_it_is_small_and_says_how_it_was_made(judge: StyleEncoder) -> None:
    assert sum(parameter.numel() for parameter in judge.parameters()) <= 350_000
    assert weights.find("tiny_judge").stat().st_size <= 700_000
    provenance = read_header(weights.find("tiny_judge")).provenance
    assert provenance["command"].startswith("anystyle train experiment=tiny_judge")
    assert provenance["seed"] != read_header(weights.find("tiny_style_encoder")).provenance["seed"]


@torch.no_grad()
def test_it_finds_held_out_styles_on_paper_and_on_scenes(judge: StyleEncoder) -> None:
    source = ProceduralStyles(size=64, split="heldout")
    styles = [source.read(style) for style in range(60)]
    images = torch.cat([style.image for style in styles if style.image is not None])
    captions = judge.embed_texts([style.text[0] for style in styles if style.text is not None])
    photos = ProceduralScenes(size=64, num_scenes=4, split="heldout")
    light = torch.cat([photos.read(scene, [0]).images[0] for scene in range(4)])
    torch.manual_seed(0)
    own = torch.arange(60)
    for pictures in (images, lit_by(images, light, 1.0)):
        alike = judge.embed_images(pictures) @ captions.T
        assert float((alike.argmax(1) == own).float().mean()) > 0.8
        assert float((alike.argmax(0) == own).float().mean()) > 0.8


def test_light_falls_on_the_share_that_was_asked_for() -> None:
    images = torch.full((64, 3, 8, 8), 0.5)
    photo = torch.linspace(0.1, 0.9, 64).reshape(1, 1, 8, 8).expand(1, 3, 8, 8)
    assert torch.equal(lit_by(images, photo[:0], 1.0), images)
    torch.manual_seed(0)
    assert torch.equal(lit_by(images, photo, 0.0), images)
    changed = (lit_by(images, photo, 0.5) != images).flatten(1).any(1).float().mean()
    assert 0.25 < float(changed) < 0.75
