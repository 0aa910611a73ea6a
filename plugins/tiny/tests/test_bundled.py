"""The bundled tiny encoder on styles held out from its training: the scores its model card states."""

import pytest
import torch

from anystyle.contracts import neutral_embedding
from anystyle.io.checkpoint import load_part
from anystyle.vision import weights
from anystyle_tiny.procedural.scenes import ProceduralScenes
from anystyle_tiny.procedural.styles import ProceduralStyles
from anystyle_tiny.style_encoder import KNOTS, Tiny, ramp

COUNT = 200


@pytest.fixture(scope="module")
def encoder() -> Tiny:
    encoder = Tiny().eval().requires_grad_(False)
    load_part(weights.find("tiny_style_encoder"), encoder, "style_encoder")
    return encoder


@pytest.fixture(scope="module")
def heldout(encoder: Tiny) -> dict[str, torch.Tensor]:
    styles = ProceduralStyles(size=96, split="heldout")
    read = [styles.read(style) for style in range(COUNT)]
    images = torch.cat([style.image for style in read])
    return {
        "images": images,
        "pictures": encoder.embed_images(images),
        "captions": encoder.embed_texts([style.text[0] for style in read]),
    }


def test_captions_and_pictures_of_unseen_combinations_find_each_other(heldout: dict[str, torch.Tensor]) -> None:
    """The right one of 100, both ways."""
    pictures, captions = (heldout[kind].unflatten(0, (2, 100)) for kind in ("pictures", "captions"))
    similarity = pictures @ captions.mT
    hits = torch.stack([(similarity.argmax(axis) == torch.arange(100)).float().mean(1) for axis in (1, 2)])
    assert hits.min() > 0.8 and hits.mean() > 0.85


def test_palettes_are_the_ramps_of_pictures_from_dark_to_light(encoder: Tiny, heldout: dict[str, torch.Tensor]) -> None:
    """To 1.5 % of what ramps vary for pictures; a caption leaves shades and shares open."""
    wanted = ramp(heldout["images"], KNOTS)
    varies = (wanted - wanted.mean(0)).square().mean()
    for kind, left in (("pictures", 0.015), ("captions", 0.3)):
        assert (encoder.palette(heldout[kind]) - wanted).square().mean() < left * varies


def test_photographs_lie_at_the_neutral_prompt(encoder: Tiny, heldout: dict[str, torch.Tensor]) -> None:
    scenes = ProceduralScenes(size=64, split="heldout", num_scenes=8, views=2)
    photos = torch.cat([scenes.read(scene, [0]).images[0] for scene in range(8)])
    neutral = neutral_embedding(encoder)[0]
    # The one that is farthest from it is still nearer than all but a few pictures of styles.
    assert (encoder.embed_images(photos) @ neutral).min() > (heldout["pictures"] @ neutral).quantile(0.98)
