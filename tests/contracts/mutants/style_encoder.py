"""Style encoders that each break one promise, and what is found."""

import torch

from anystyle.testing.toy.style_encoder import ToyStyleEncoder


class WithoutNeutral(ToyStyleEncoder):
    def __init__(self):
        super().__init__(neutral="")


class LongTexts(ToyStyleEncoder):
    def embed_texts(self, texts):
        return 2 * super().embed_texts(texts)


class LongImages(ToyStyleEncoder):
    def embed_images(self, images):
        return 2 * super().embed_images(images)


class OneSize(ToyStyleEncoder):
    def embed_images(self, images):
        return super().embed_images(images.reshape(-1, 3, 32, 32))


class Centred(ToyStyleEncoder):
    def embed_images(self, images):
        return super().embed_images(images - images.mean(0, keepdim=True) * 0.5)


class Noisy(ToyStyleEncoder):
    def embed_images(self, images):
        return super().embed_images(images + 1e-3 * torch.rand(1, 3, 1, 1))


class Blind(ToyStyleEncoder):
    def embed_texts(self, texts):
        return super().embed_texts(["grey" if text else text for text in texts])


class Permissive(ToyStyleEncoder):
    def embed_texts(self, texts):
        return super().embed_texts([text or "grey" for text in texts])


class Detached(ToyStyleEncoder):
    def embed_images(self, images):
        return super().embed_images(images.detach())


class OfAnyNorm(ToyStyleEncoder):
    unit_norm = False

    def embed_texts(self, texts):
        return 2 * super().embed_texts(texts)


CHANGED = {
    "as it is": (ToyStyleEncoder, set()),
    "texts of norm 2, as it says": (OfAnyNorm, set()),
    "no neutral prompt": (WithoutNeutral, {"space is declared"}),
    "texts of norm 2": (LongTexts, {"texts become vectors"}),
    "images of norm 2": (LongImages, {"images become vectors"}),
    "one size of images": (OneSize, {"images become vectors"}),
    "centred over the batch": (Centred, {"batches are loops"}),
    "noise": (Noisy, {"embedding twice is the same", "batches are loops"}),
    "every text alike": (Blind, {"styles differ"}),
    "an empty text accepted": (Permissive, {"empty text is refused"}),
    "images without gradient": (Detached, {"images carry gradients"}),
}
