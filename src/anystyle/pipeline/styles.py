"""Styles as inputs: texts, images and mixtures of two."""

import logging
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from jaxtyping import Float
from torch import Tensor

from anystyle.errors import UserError
from anystyle.io.sheet import Cell, to_pil
from anystyle.paths import distinct
from anystyle.pipeline.controls import Controls, rescaled
from anystyle.pipeline.provenance import Entry, entry
from anystyle.stylizer import Stylizer
from anystyle.types import Style, StyleEmbedding, TextMatch

_log = logging.getLogger(__name__)

MAX_TEXT = 2000
"""Characters of a description."""


@dataclass(frozen=True)
class Mixture:
    """The point at ``amount`` of the way from one style to another."""

    first: "StyleInput"
    second: "StyleInput"
    amount: float

    def __post_init__(self) -> None:
        if not 0 <= self.amount <= 1:
            raise UserError(f"a mixture takes an amount between 0 and 1, not {self.amount}")


@dataclass(frozen=True)
class Named:
    """A description or an image file under a name of its own, for folders, sheets and pages.

    Example:
        >>> named = Named(Path("IMG_0045.jpg"), "Grandmother's quilt")
    """

    style: str | Path
    name: str


StyleInput = str | Path | Style | Float[Tensor, "3 _ _"] | Mixture | Named
"""A description, an image file, a batch of one style, an sRGB image in [0, 1], a mixture, or one with a name."""


@dataclass(frozen=True)
class EmbeddedStyle:
    """An embedded style, with what is displayed of it.

    Args:
        name: Lower-case words joined by hyphens, for a folder.
        title: For a heading.
        cell: Its picture, where there is one.
        embedding: A batch of one.
        style: The image or the text itself; neither for a point between two styles.
        matches: For each text, the nearest description that the encoder knows.
        made_of: The texts and images.
        controls: How it is applied.
    """

    name: str
    title: str
    cell: Cell
    embedding: StyleEmbedding
    style: Style = field(default_factory=Style)
    matches: tuple[TextMatch, ...] = ()
    made_of: tuple[Entry, ...] = ()
    controls: Controls = field(default_factory=Controls)

    def under(self, controls: Controls) -> "EmbeddedStyle":
        """This style applied as controls say, named after what they change."""
        if not controls.label:
            return self
        name = f"{self.name}_{slug(controls.label.replace('.', '-'), 60)}"
        return replace(self, name=name, title=f"{self.title}, {controls.label}", controls=controls)


def check_text(text: str, what: str = "the text of a style") -> None:
    """Refuse a description that is empty or longer than :data:`MAX_TEXT`."""
    if not text.strip():
        raise UserError(f"{what} is empty; say what the result should look like")
    if len(text) > MAX_TEXT:
        raise UserError(f"{what} has {len(text)} characters; describe the style in at most {MAX_TEXT}")


def check_styles(styles: Sequence[StyleInput]) -> None:
    """Refuse texts that are empty and image files that are not there or no images, before networks are loaded."""
    for style in styles:
        if isinstance(style, str):
            check_text(style)
        elif isinstance(style, Path):
            from anystyle.data.images import image_size
            from anystyle.examples import resolved

            image_size(resolved(style))
        elif isinstance(style, Named):
            check_text(style.name, "the name of a style")
            check_styles([style.style])
        elif isinstance(style, Mixture):
            check_styles([style.first, style.second])


def embed_styles(
    styles: Sequence[StyleInput], stylizer: Stylizer, controls: Sequence[Controls] = (Controls(),)
) -> list[EmbeddedStyle]:
    """Embed styles in their order, each under all controls; one that occurs several times is embedded once.

    Names and titles are distinct: of two files ``01.jpg`` in two folders the second is ``01 2``.
    """
    embedded: dict[tuple[int, float], EmbeddedStyle] = {}

    def embed(style: StyleInput, scale: float) -> EmbeddedStyle:
        if (id(style), scale) in embedded:
            return embedded[id(style), scale]
        match style:
            case Mixture(first=first, second=second, amount=amount):
                result = mix(embed(first, scale), embed(second, scale), amount)
            case Named(style=inner, name=name):
                result = replace(embed(inner, scale), name=slug(name), title=" ".join(name.split()))
            case _:
                result = _embed(style, stylizer, scale)
        return embedded.setdefault((id(style), scale), result)

    found = [embed(style, one.scale).under(one) for style in styles for one in controls]
    titles = distinct(["unstyled", *(one.title for one in found)], " ")[1:]
    names = distinct([one.name for one in found], "-")
    return [replace(one, title=title, name=name) for one, title, name in zip(found, titles, names, strict=True)]


def _embed(style: str | Path | Style | Float[Tensor, "3 _ _"], stylizer: Stylizer, scale: float) -> EmbeddedStyle:
    paints = stylizer.branch.paints_strokes
    match style:
        case Style(image=None, text=(str() as text, *_)):
            return _embed(text, stylizer, scale)
        case str():
            check_text(style)
            if scale != 1 and not paints:
                raise UserError(
                    f"scale={scale:g} enlarges the strokes of a style image; {style[:40]!r} is a text, and this model "
                    "paints no strokes"
                )
            title = f"“{' '.join(style.split())}”"
            embedding = replace(stylizer.embed(text=style), scale=scale)
            given, made_of = Style(text=(style,)), (entry("text", text=style),)
            return EmbeddedStyle(slug(style), title, None, embedding, given, _matches(style, stylizer), made_of)
        case Path():
            from anystyle.data.images import read_image
            from anystyle.examples import resolved, title_of

            file = resolved(style)
            title, image, made_of = title_of(style), read_image(file, masked=True)[None], (entry("image", [file]),)
        case Tensor() if style.ndim == 3:
            title, image, made_of = "image", style[None], (entry("image"),)
        case Style(image=Tensor() as image, names=names):
            title, made_of = names[0] if names else "image", (entry("image", names=names),)
        case _:
            given = f"a style has neither an image nor a text: {type(style).__name__} is given"
            raise UserError(f"{given}; give a text, a Path, or a tensor [3, H, W] of sRGB in [0, 1]")
    cell, image = to_pil(image[0]), image if paints else rescaled(image[0], scale)[None]
    embedding = replace(stylizer.embed(image=image.to(stylizer.device)), scale=scale)
    return EmbeddedStyle(slug(title), title, cell, embedding, Style(image=image, names=(title,)), made_of=made_of)


def _matches(text: str, stylizer: Stylizer) -> tuple[TextMatch, ...]:
    match = stylizer.style_encoder.match_text(text)
    if match is not None and match.unknown_words and match.similarity <= 0:
        raise UserError(f"the style encoder knows no word of the text {text!r}; say it in English, or give a picture")
    if match is not None and match.unknown_words:
        line = "of the style %r the encoder never learnt: %s; it comes nearest to %r (similarity %.2f of 1)%s"
        words, remedy = ", ".join(match.unknown_words), match.remedy and f"; {match.remedy}"
        _log.warning(line, text, words, match.description, match.similarity, remedy)
    return () if match is None else (match,)


def mix(first: EmbeddedStyle, second: EmbeddedStyle, amount: float) -> EmbeddedStyle:
    """The point between two styles, at ``amount`` in [0, 1] of the way from the first."""
    return EmbeddedStyle(
        name=f"{slug(first.name, 24)}_{amount:.2f}_{slug(second.name, 24)}",
        title=f"{1 - amount:.0%} {first.title}, {amount:.0%} {second.title}",
        cell=first.cell if amount == 0 else second.cell if amount == 1 else None,
        embedding=first.embedding.toward(second.embedding, amount),
        style=first.style if amount == 0 else second.style if amount == 1 else Style(),
        matches=tuple(dict.fromkeys(first.matches + second.matches)),
        made_of=first.made_of + second.made_of,
    )


def slug(text: str, limit: int = 40) -> str:
    """A text as part of a file name: lower-case words in letters of any script, joined by hyphens.

    ``limit`` is in bytes of UTF-8; a text without letters and digits is ``style``.
    """
    plain = unicodedata.normalize("NFKC", text).lower()
    words = "".join(letter if unicodedata.category(letter)[0] in "LMN" else " " for letter in plain).split()
    return "-".join(words).encode()[:limit].decode(errors="ignore").rstrip("-") or "style"
