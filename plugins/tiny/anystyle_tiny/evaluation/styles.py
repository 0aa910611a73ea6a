"""How a stylized scene is judged: whose style it looks like, its colours, its edges, and the way between two styles."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import kornia
import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import StyleEncoder
from anystyle.inference.assemble import weights_file
from anystyle.io.checkpoint import load_part, read_header
from anystyle.perception.histogram import hellinger, rgb_uv_histogram
from anystyle.registry.build import build
from anystyle.stylizer import Stylizer
from anystyle.types import Cameras, Gaussians, Scene, StyleEmbedding

CHUNK = 5
"""Styles that are restyled and rendered at a time; a matter of memory alone."""
HISTOGRAM_SIDE = 64
"""Images are brought to this size for their histograms of colour, which cost by the pixel."""


@dataclass(frozen=True)
class Targets:
    """What the renders of some styles are held against.

    Args:
        judged_images: The judge's vectors of the style images.
        judged_texts: The judge's vectors of the captions.
        by_image: The model's embeddings of the style images.
        by_text: The model's embeddings of the captions.
        histograms: Of the style images.
        palettes: The sRGB colours each was painted with.
    """

    judged_images: Float[Tensor, "S D"]
    judged_texts: Float[Tensor, "S D"]
    by_image: StyleEmbedding
    by_text: StyleEmbedding
    histograms: Float[Tensor, "S 3 b b"]
    palettes: tuple[Float[Tensor, "_ 3"], ...]


def load_judge(name: str) -> StyleEncoder:
    """A style encoder as its file of weights describes it, frozen.

    Args:
        name: What ``anystyle weights`` lists, or a file.

    Raises:
        ValueError: The file holds something else.
        FileNotFoundError: It is missing.
    """
    file = weights_file(name)
    judge = build(StyleEncoder, read_header(file).config.get("style_encoder", {}))
    load_part(file, judge, "style_encoder")
    return judge.requires_grad_(False).eval()


def histograms(images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M 3 b b"]:
    """Histograms of colour as the published colour-matching loss has them, of small copies."""
    return rgb_uv_histogram(images, limit=HISTOGRAM_SIDE)


def edges(images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M P"]:
    """Magnitude of the gradient of the luma at every pixel, by Sobel filters."""
    return kornia.filters.sobel(kornia.color.rgb_to_grayscale(images)).flatten(1)


def correlation(first: Float[Tensor, "M P"], second: Float[Tensor, "M P"]) -> Float[Tensor, " M"]:
    """Pearson's correlation of each row; 0 where a row is constant."""
    first, second = first - first.mean(-1, keepdim=True), second - second.mean(-1, keepdim=True)
    return (first * second).sum(-1) / (first.norm(dim=-1) * second.norm(dim=-1)).clamp_min(1e-12)


def first_choices(judge: StyleEncoder, images: Float[Tensor, "M 3 H W"], targets: Float[Tensor, "S D"]) -> list[int]:
    """The style that the judge finds each image most alike."""
    return (judge.embed_images(images) @ targets.T).argmax(-1).tolist()


def fraction_of_second(
    images: Float[Tensor, "M 3 H W"], first: Float[Tensor, "_ 3"], second: Float[Tensor, "_ 3"]
) -> Float[Tensor, " M"]:
    """The fraction of each image that is of the second palette rather than of the first.

    A pixel counts as ``a / (a + b)``, where a and b are the distances in CIELAB to the nearest colour of the first and
    of the second palette: 1 where it is a colour of the second, half where it is as near to one as to the other.
    """
    pixels = kornia.color.rgb_to_lab(images.clamp(0, 1)).flatten(2).mT  # M P 3

    def distance(palette: Tensor) -> Tensor:
        lab = kornia.color.rgb_to_lab(palette.T[None, :, :, None])[0, :, :, 0].T
        return torch.cdist(pixels, lab.expand(len(pixels), -1, -1)).amin(-1)

    off, near = distance(first), distance(second)
    return (off / (off + near).clamp_min(1e-6)).mean(-1)


def style_record(
    stylizer: Stylizer, judge: StyleEncoder, scene: Scene, cameras: Cameras, targets: Targets
) -> dict[str, list[float]]:
    """What the renders of one scene in all styles are worth, in the order styles, then views; plain numbers by name.

    The judge's choices are numbers of styles; ``unstyled`` ones are of the reconstruction itself.
    """
    plain = stylizer.render(stylizer.unstyled(scene), cameras).color[0].clamp(0, 1)
    plain_edges, plain_colors = edges(plain), histograms(plain)
    record: dict[str, list[float]] = {
        "unstyled_image": [float(choice) for choice in first_choices(judge, plain, targets.judged_images)],
        "unstyled_text": [float(choice) for choice in first_choices(judge, plain, targets.judged_texts)],
        "chosen_image": [],
        "chosen_text": [],
        "color": [],
        "unstyled_color": [],
        "edge_correlation": [],
    }
    views = len(plain)
    for styles, images in _restyled(stylizer, scene, cameras, targets.by_image):
        colors = targets.histograms[styles].repeat_interleave(views, 0)
        count = len(images) // views
        record["chosen_image"] += first_choices(judge, images, targets.judged_images)
        record["color"] += hellinger(histograms(images), colors).tolist()
        record["unstyled_color"] += hellinger(plain_colors.repeat(count, 1, 1, 1), colors).tolist()
        record["edge_correlation"] += correlation(edges(images), plain_edges.repeat(count, 1)).tolist()
    for _, images in _restyled(stylizer, scene, cameras, targets.by_text):
        record["chosen_text"] += first_choices(judge, images, targets.judged_texts)
    return {name: [float(value) for value in values] for name, values in record.items()}


def strip_record(
    stylizer: Stylizer, scene: Scene, targets: Targets, pair: tuple[int, int], steps: int
) -> dict[str, list[float]]:
    """The fraction of the second style's palette along the way from one style to another, in the first view."""
    first, second = (_rows(targets.by_image, slice(style, style + 1)) for style in pair)
    amounts = torch.linspace(0, 1, steps + 1, device=first.vector.device)
    way = StyleEmbedding(
        vector=first.vector.expand(len(amounts), -1), direction=first.direction.expand(len(amounts), -1)
    ).toward(
        StyleEmbedding(
            vector=second.vector.expand(len(amounts), -1), direction=second.direction.expand(len(amounts), -1)
        ),
        amounts,
    )
    fractions: list[float] = []
    for _, images in _restyled(stylizer, scene, scene.cameras.select([0]), way):
        fractions += fraction_of_second(images, targets.palettes[pair[0]], targets.palettes[pair[1]]).tolist()
    return {"pair": [float(style) for style in pair], "fractions": fractions}


def rises(fractions: Sequence[float]) -> bool:
    """Whether every step of a strip shows more of the second style's palette than the one before."""
    return all(after > before for before, after in pairwise(fractions))


def _restyled(
    stylizer: Stylizer, scene: Scene, cameras: Cameras, embedding: StyleEmbedding
) -> list[tuple[slice, Float[Tensor, "M 3 H W"]]]:
    """Renders of a scene in some styles: which styles, and their images, style by style and view by view."""
    drawn: list[tuple[slice, Tensor]] = []
    for start in range(0, len(embedding.vector), CHUNK):
        styles = slice(start, min(start + CHUNK, len(embedding.vector)))
        gaussians: Gaussians = stylizer.restyle(scene, _rows(embedding, styles))
        drawn.append((styles, stylizer.render(gaussians, cameras).color.flatten(0, 1).clamp(0, 1)))
    return drawn


def _rows(embedding: StyleEmbedding, rows: slice) -> StyleEmbedding:
    return StyleEmbedding(vector=embedding.vector[rows], direction=embedding.direction[rows])
