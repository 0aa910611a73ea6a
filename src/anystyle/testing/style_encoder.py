"""What a style encoder promises: see :class:`anystyle.contracts.StyleEncoder`."""

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import StyleEncoder
from anystyle.testing.check import Check, attempt, expect, refusal
from anystyle.testing.comparing import conform_tensor, expect_close, expect_finite, expect_gradient, expect_same
from anystyle.testing.inputs import generator, images
from anystyle.testing.subject import Subject

Plugin = Subject[StyleEncoder]

TEXTS = ("thick swirling strokes in deep blue", "red", "a mosaic of green and white tiles, seen from above")
SIZES = ((32, 32), (17, 31), (80, 48))


def space_is_declared(plugin: Plugin) -> None:
    """The constructor sets ``dim`` and ``neutral``, and the neutral prompt can be embedded."""
    encoder = _eval(plugin)
    dim, neutral = getattr(encoder, "dim", None), getattr(encoder, "neutral", None)
    expect(
        isinstance(dim, int) and dim >= 1 and isinstance(neutral, str) and bool(neutral),
        given=f"dim={dim!r} and neutral={neutral!r}",
        expected="a number of dimensions, and a prompt that stands for no style",
        change="set `self.dim` and `self.neutral` in the constructor",
    )
    with attempt(f"embedding the neutral prompt {neutral!r}", change="choose a prompt that the encoder reads"):
        encoder.embed_texts([encoder.neutral])


@torch.no_grad()
def texts_become_vectors(plugin: Plugin) -> None:
    """Texts give finite vectors of ``dim`` numbers, of norm 1 if ``unit_norm`` is set."""
    for texts in (_texts(plugin), _texts(plugin)[:1]):
        with attempt(f"embedding {len(texts)} text(s)", change="make `embed_texts` work for any number of texts"):
            vectors = _eval(plugin).embed_texts(list(texts))
        _expect_vectors(plugin, vectors, "embed_texts", len(texts))


@torch.no_grad()
def images_become_vectors(plugin: Plugin) -> None:
    """Images of any size give finite vectors, of norm 1 if ``unit_norm`` is set; black and white ones too."""
    batches = [images(2, size) for size in SIZES]
    for given in (*batches, torch.zeros(1, 3, 32, 32), torch.ones(1, 3, 32, 32)):
        what = f"embedding {given.shape[0]} image(s) of {given.shape[2]}x{given.shape[3]} pixels"
        with attempt(what, change="resize or pad in `embed_images`"):
            vectors = _eval(plugin).embed_images(given)
        _expect_vectors(plugin, vectors, f"embed_images, {what}", given.shape[0])


@torch.no_grad()
def batches_are_loops(plugin: Plugin) -> None:
    """A batch gives what its members give alone."""
    encoder = _eval(plugin)
    pictures = images(3, (32, 48))
    texts, both = encoder.embed_texts(_texts(plugin)), encoder.embed_images(pictures)
    for index, text in enumerate(_texts(plugin)):
        for what, together, alone in (
            ("text", texts, encoder.embed_texts([text])),
            ("image", both, encoder.embed_images(pictures[index : index + 1])),
        ):
            expect_close(
                together[index : index + 1],
                alone,
                what=f"{what} {index} of a batch against the same {what} alone",
                change="mask the padding of shorter texts, and normalise nothing over the batch",
            )


@torch.no_grad()
def embedding_twice_is_the_same(plugin: Plugin) -> None:
    """The same style gives the same bits."""
    encoder = _eval(plugin)
    pictures = images(2, (32, 48))
    for what, once, twice in (
        ("texts", encoder.embed_texts(_texts(plugin)), encoder.embed_texts(_texts(plugin))),
        ("images", encoder.embed_images(pictures), encoder.embed_images(pictures)),
    ):
        change = "look for dropout or random crops, and for state that a call leaves behind"
        expect_same(twice, once, what=f"the same {what} again", change=change)


@torch.no_grad()
def styles_differ(plugin: Plugin) -> None:
    """Different images, and different texts where they are read, have different vectors."""
    encoder = _eval(plugin)
    plain = torch.tensor([[0.9, 0.1, 0.1], [0.1, 0.1, 0.9]])[:, :, None, None].expand(2, 3, 32, 32)
    pairs = [("a red and a blue image", encoder.embed_images(plain))]
    if encoder.reads_texts:
        pairs.append(("texts", encoder.embed_texts(TEXTS[:2])))
    for what, vectors in pairs:
        expect(
            float((vectors[0] - vectors[1]).norm()) > 1e-4,
            given=f"one vector for two: {what}",
            change="check that the input reaches the output",
        )


def empty_text_is_refused(plugin: Plugin) -> None:
    """An empty text raises a ValueError of one line, also among others; a text too long is refused or embedded."""
    encoder = _eval(plugin)
    for texts in ([""], [TEXTS[0], ""]):
        change = "raise it in `embed_texts` where a text is empty; say so, and to describe a style"
        with refusal(change, unless=f"vectors for {texts!r}"):
            encoder.embed_texts(texts)
    try:
        vectors = encoder.embed_texts(["blue strokes " * 2000])
    except ValueError:
        return
    _expect_vectors(plugin, vectors, "embed_texts of 26,000 characters", 1)


def images_carry_gradients(plugin: Plugin) -> None:
    """``embed_images`` is differentiable in the images."""
    pictures = images(2, (32, 48)).requires_grad_()
    vectors = _eval(plugin).embed_images(pictures)
    weights = torch.randn(vectors.shape, generator=generator(3))
    with attempt("the backward pass of `embed_images`", change="stay within torch, and under no `torch.no_grad`"):
        (vectors * weights).sum().backward()
    change = "do not detach, round or clamp away the images in `embed_images`"
    expect_gradient(pictures.grad, "the images", change=change)


def _texts(plugin: Plugin) -> list[str]:
    return list(TEXTS) if plugin.instance.reads_texts else [plugin.instance.neutral] * len(TEXTS)


def _eval(plugin: Plugin) -> StyleEncoder:
    return plugin.instance.requires_grad_(False).eval()


def _expect_vectors(plugin: Plugin, vectors: Float[Tensor, "M D"], where: str, number: int) -> None:
    conform_tensor(vectors, Float[Tensor, "M D"], where, M=number, D=plugin.instance.dim)
    expect_finite(vectors, where)
    norms = vectors.detach().norm(dim=-1)
    expect(
        not plugin.instance.unit_norm or bool(((norms - 1).abs() < 1e-3).all()),
        given=f"{where}: vectors of norm {float(norms.min()):.4g} to {float(norms.max()):.4g}",
        expected="norm 1, for `unit_norm` is set",
        change="end with `torch.nn.functional.normalize(vectors, dim=-1)`, or set `self.unit_norm = False`",
    )


CHECKS: tuple[Check, ...] = (
    Check(space_is_declared, needed=True),
    Check(texts_become_vectors, needed=True),
    Check(images_become_vectors, needed=True),
    Check(batches_are_loops),
    Check(embedding_twice_is_the_same),
    Check(styles_differ),
    Check(empty_text_is_refused),
    Check(images_carry_gradients),
)
