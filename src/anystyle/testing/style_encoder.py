"""What a style encoder promises: see :class:`anystyle.contracts.StyleEncoder`."""

from contextlib import suppress

import pytest
import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import StyleEncoder
from anystyle.testing import asserts
from anystyle.testing.asserts import ONE_LINE
from anystyle.testing.inputs import images, noise
from anystyle.testing.subject import Subject
from anystyle.types.shapes import check_tensor

TEXTS = ("thick swirling strokes in deep blue", "red", "a mosaic of green and white tiles, seen from above")


@torch.no_grad()
def test_texts_become_vectors(plugin: Subject[StyleEncoder]) -> None:
    """Texts, such as ``neutral``, give finite vectors of ``dim`` numbers, of norm 1 if ``unit_norm`` is set."""
    for texts in (_texts(plugin), [plugin.instance.neutral]):
        _assert_vectors(plugin, _frozen(plugin).embed_texts(texts), len(texts))


@torch.no_grad()
def test_images_become_vectors(plugin: Subject[StyleEncoder]) -> None:
    """Images of any size give finite vectors, of norm 1 if ``unit_norm`` is set; black and white ones too."""
    pictures = [images(2, size) for size in ((32, 32), (17, 31), (80, 48))]
    for given in (*pictures, torch.zeros(1, 3, 32, 32), torch.ones(1, 3, 32, 32)):
        _assert_vectors(plugin, _frozen(plugin).embed_images(given), len(given))


@torch.no_grad()
def test_batches_are_loops(plugin: Subject[StyleEncoder]) -> None:
    """A batch gives what its members give alone, and the same bits again."""
    encoder, texts, pictures = _frozen(plugin), _texts(plugin), images(3, (32, 48))
    words, looks = encoder.embed_texts(texts), encoder.embed_images(pictures)
    for row in range(3):
        asserts.close(words[row : row + 1], encoder.embed_texts([texts[row]]), f"text {row} of a batch")
        asserts.close(looks[row : row + 1], encoder.embed_images(pictures[row : row + 1]), f"image {row} of a batch")
    asserts.same(encoder.embed_texts(texts), words, "the same texts again")
    asserts.same(encoder.embed_images(pictures), looks, "the same images again")


@torch.no_grad()
def test_styles_differ(plugin: Subject[StyleEncoder]) -> None:
    """Different images, and different texts where it reads texts, have different vectors."""
    plain = torch.tensor([[0.9, 0.1, 0.1], [0.1, 0.1, 0.9]])[:, :, None, None].expand(2, 3, 32, 32)
    pairs = {"a red and a blue image": _frozen(plugin).embed_images(plain)}
    if plugin.instance.reads_texts:
        pairs["two texts"] = _frozen(plugin).embed_texts(TEXTS[:2])
    for what, vectors in pairs.items():
        assert float((vectors[0] - vectors[1]).norm()) > 1e-4, f"one vector for {what}"


def test_empty_text_is_refused(plugin: Subject[StyleEncoder]) -> None:
    """An empty text raises a ValueError of one line, also among others; a text too long is refused or embedded."""
    for texts in ([""], [TEXTS[0], ""]):
        with pytest.raises(ValueError, match=ONE_LINE):
            _frozen(plugin).embed_texts(texts)
    with suppress(ValueError):
        _assert_vectors(plugin, _frozen(plugin).embed_texts(["blue strokes " * 200]), 1)


def test_images_carry_gradients(plugin: Subject[StyleEncoder]) -> None:
    """``embed_images`` is differentiable in the images."""
    pictures = images(2, (32, 48)).requires_grad_()
    vectors = _frozen(plugin).embed_images(pictures)
    (vectors * noise(vectors)).sum().backward()
    asserts.gradient(pictures.grad, "the images")


def _texts(plugin: Subject[StyleEncoder]) -> list[str]:
    return list(TEXTS) if plugin.instance.reads_texts else [plugin.instance.neutral] * len(TEXTS)


def _frozen(plugin: Subject[StyleEncoder]) -> StyleEncoder:
    return plugin.instance.requires_grad_(False).eval()


def _assert_vectors(plugin: Subject[StyleEncoder], vectors: Tensor, number: int) -> None:
    check_tensor(vectors, Float[Tensor, "M D"], "the encoder", M=number, D=plugin.instance.dim)
    asserts.finite(vectors, "the vectors")
    norms = vectors.detach().norm(dim=-1)
    unit = bool(((norms - 1).abs() < 1e-3).all())
    assert unit or not plugin.instance.unit_norm, f"vectors of norm {norms.tolist()}, and `unit_norm` is set"
