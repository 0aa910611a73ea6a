"""CSD: how alike the styles of stylized images and of the style image are to a network trained to describe style."""

from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor

from anystyle.vision import preprocess, weights
from anystyle.vision.clip import MEAN, STD, Vision, quick_gelu
from anystyle.vision.feature_cache import CACHE
from anystyle.vision.features import Frozen, load_frozen
from anystyle_metrics.style_sets import StyleSet, named

NAME = "csd_vit_l"
SIDE = 224  # pixels of the square that is seen, the middle of an image whose shorter side it is
HEAD = "last_layer_style"


class CSD(StyleSet):
    """Cosine of the style descriptors of stylized and style image, averaged over views, in [-1, 1].

    Contrastive Style Descriptors (Somepalli et al., ECCV 2024, arXiv 2404.01292): CLIP's ViT-L/14, trained further to
    tell artists apart. A cosine says little by itself: on 91 artists it does not tell 23 from another one, and less
    so the corrected ``csd_csls``, in [-4, 4] (arXiv 2605.09030). ``csd_gap`` says how far the styles at hand are apart:
    see :class:`~anystyle_metrics.style_sets.StyleSet`. There is no stand-in: without its weights it refuses, and a
    benchmark goes on without it.

    Args:
        file: The published checkpoint; where :func:`anystyle.vision.weights.find` looks if it is not given.

    Example:
        >>> import tempfile
        >>> metric = CSD(**CSD.example(Path(tempfile.mkdtemp())))
        >>> image = torch.full((1, 3, 224, 224), 0.5)
        >>> round(float(metric(image, style=image)["csd"]), 4)
        1.0
    """

    better: ClassVar[Mapping[str, str]] = named("csd")

    def __init__(self, *, file: str | None = None) -> None:
        super().__init__()
        self._file = file
        self._network: tuple[Frozen, str] | None = None  # loaded when first needed, with its weights' identity

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        tower = Vision(64, 1, 56, SIDE, 8, quick_gelu)
        state = {f"backbone.{key}": tensor for key, tensor in tower.state_dict().items() if key != "proj"}
        heads = {HEAD: tower.proj.data, "last_layer_content": -tower.proj.data}
        published = {f"module.{key}": tensor for key, tensor in (state | heads).items()}
        torch.save({"model_state_dict": published}, folder / "csd.pth")
        return {"file": str(folder / "csd.pth")}

    def vectors(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M 1 D"]:
        return self.describe(images)[:, None].double()

    def similar(self, rows: Float[Tensor, "N D"], styles: Float[Tensor, "G D"]) -> Float[Tensor, "N G"]:
        """Cosines, as those of a row's views have their mean."""
        return rows @ styles.mT

    def value(self, similar: Float[Tensor, "N G"], own: Int[Tensor, " N"]) -> Float[Tensor, " N"]:
        return similar.gather(1, own[:, None])[:, 0]

    def describe(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M D"]:
        """Unit style descriptors of sRGB images in [0, 1]."""
        network, identity = self._network = self._network or self._load()

        def embed(batch: Tensor) -> list[Tensor]:
            square = preprocess.middle_square(preprocess.resized(batch, SIDE, mode="bicubic").clamp(0, 1))
            return [F.normalize(network(preprocess.normalised(square, MEAN, STD)), dim=-1)]

        return CACHE.features(images, ("csd", identity), embed)[0]

    def _load(self) -> tuple[Frozen, str]:
        file = weights.find(NAME, self._file)
        source = weights.published(NAME, file)
        self.weights = {**self.weights, **weights.checksums(source)}
        return load_csd(weights.read(file), file).to(self.device), source.identity


class StyleTower(Frozen, Vision):
    """CLIP's image tower whose projection is CSD's style head."""


def load_csd(state: Mapping[str, Tensor], file: Path) -> StyleTower:
    """The network of a published checkpoint; its second head, which describes content, is left out."""
    given = {key.removeprefix("module."): tensor for key, tensor in state.items()}
    given = {key.removeprefix("backbone."): tensor for key, tensor in given.items() if key != "last_layer_content"}
    if HEAD in given:
        given["proj"] = given.pop(HEAD)
    width, _, patch, _ = given["conv1.weight"].shape if "conv1.weight" in given else (1024, 3, 14, 14)
    layers = len({key.split(".")[2] for key in given if key.startswith("transformer.resblocks.")})
    dim = given["proj"].shape[1] if "proj" in given else 768
    return load_frozen(StyleTower(width, layers, patch, SIDE, dim, quick_gelu), given, file)
