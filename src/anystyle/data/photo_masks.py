"""Masks of photographs: their alpha channels, and pictures in a folder that are white where a photograph counts."""

import logging
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image, ImageChops
from torch import Tensor

from anystyle.data.images import SUFFIXES, image_size, open_alpha, open_image, to_tensor
from anystyle.errors import UserError, listing
from anystyle.io import video
from anystyle.io.images import opened
from anystyle.types import Original, SourceImage, Views

MAX_ASPECT_ERROR = 0.02
"""A mask may differ by this fraction from its photograph's aspect."""
WHITE = 0.98
"""Of a mask that is scaled: a pixel that is darker lies at an edge, and does not count."""
MAX_LABELS = 32
"""Grey levels are labels where those of all masks are below this, and colours are such whose channels differ by it."""
FEW = 0.2
"""Masks that leave a smaller share of the pixels may be inverted."""

_log = logging.getLogger(__name__)


def find_masks(folder: Path, photographs: Sequence[Path]) -> dict[Path, Path]:
    """The mask of each photograph that has one in a folder: ``a.png`` or ``a.jpg.png`` of ``a.jpg``, in sub-folders.

    Photographs without a mask and masks without a photograph are logged.
    """
    if films := [path for path in photographs if path.suffix.lower() in video.SUFFIXES]:
        raise UserError(f"{films[0]} is a film, and masks belong to photographs; give its frames as images")
    files = sorted(path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES and path.is_file())
    known: dict[tuple[str, ...], list[Path]] = {}
    for file in files:
        known.setdefault(_key(file.relative_to(folder), file.stem), []).append(file)
    longest = max(map(len, known), default=0)
    masks: dict[Path, Path] = {}
    for path in dict.fromkeys(photographs):
        tails = [Path(*path.parts[-length:]) for length in range(min(longest, len(path.parts)), 0, -1)]
        keys = [_key(tail, name) for tail in tails for name in (path.name, path.stem)]
        found = next((known[key] for key in keys if key in known), [])
        if len(found) > 1:
            raise UserError(f"{path.name} has {len(found)} masks: {listing(found)}; leave one")
        if found and (other := next((one for one, mask in masks.items() if mask == found[0]), None)) is not None:
            both = f"{other} and {path}"
            raise UserError(f"{found[0]} would be the mask of both {both}; put masks in folders like theirs")
        masks |= {path: found[0]} if found else {}
    if not masks:
        names = listing([f"{path.stem}.png" for path in photographs], 3)
        raise UserError(f"none of the {len(files)} images in {folder} is named as a photograph is; expected {names}")
    if missing := [path.name for path in photographs if path not in masks]:
        count = f"{len(missing)} of {len(photographs)}"
        _log.warning("%s photographs have no mask in %s and count whole: %s", count, folder, listing(missing))
    if spare := [file.name for file in files if file not in masks.values()]:
        _log.warning("%d masks in %s belong to no photograph: %s", len(spare), folder, listing(spare))
    return masks


def _key(path: Path, name: str) -> tuple[str, ...]:
    return tuple(unicodedata.normalize("NFC", part).casefold() for part in (*path.parts[:-1], name))


def with_masks(originals: Sequence[Original], masks: Mapping[Path, Path]) -> list[Original]:
    """Photographs that do not count where their masks are black, besides where they are transparent."""
    labels = are_labels(masks.values())

    def masked(original: Original) -> Original:
        mask = _mask_of(masks, original.path, labels)
        if mask is None:
            return original
        mask = mask.resize(original.picture.size)
        return original._replace(mask=mask if original.mask is None else ImageChops.darker(mask, original.mask))

    return [masked(original) for original in originals]


def masked_views(
    views: Views, sources: Sequence[SourceImage], masks: Mapping[Path, Path], *, empty: bool
) -> tuple[Views, dict[str, int | float]]:
    """Views of one scene with their ``alpha`` and which of their pixels are ``valid``, and what a report says of both.

    Where a mask of :func:`find_masks` is black, nothing is there if ``empty``; otherwise it is unknown what is there,
    as it is beside a photograph that does not fill its view.
    """
    alpha, valid = (torch.ones_like(views.images[0, :, 0]) for _ in range(2))  # V H W
    num_masks, labels = 0, are_labels(masks.values())
    for view, source in enumerate(sources):
        transparency = None if source.path is None else open_alpha(source.path, longest=2 * max(source.view_size))
        mask = _mask_of(masks, source.path, labels)
        if transparency is not None:
            alpha[view] = _of_view(transparency, source)
        if mask is not None:
            (alpha if empty else valid)[view].mul_(_of_view(mask, source))
        num_masks += transparency is not None or mask is not None
        left, top, right, bottom = source.inside
        outside = torch.ones_like(valid[view], dtype=torch.bool)
        outside[top:bottom, left:right] = False
        valid[view].masked_fill_(outside, 0)
    valid = valid > WHITE
    nothing = (alpha * valid).flatten(1).amax(1) <= 1 - WHITE
    if nothing.any():
        # An object that lies outside of the picture, or a mask that failed: it is not taken for the former.
        names = [source.name for source, none in zip(sources, nothing.tolist(), strict=True) if none]
        _log.warning("nothing is left of %d photographs, and they are ignored: %s", len(names), listing(names))
        alpha[nothing], valid[nothing] = 1.0, False
    if not num_masks:
        return replace(views, valid=None if valid.all() else valid[None]), {}
    transparent, ignored = float((1 - alpha).mean()), float((~valid).double().mean())
    if masks and (left := (1 - transparent) * (1 - ignored)) < FEW:
        remedy = "white counts; invert them if black is what is to stay"
        _log.warning("masks leave %.0f%% of the pixels: %s", 100 * left, remedy)
    report = {"photographs": num_masks, "transparent": round(transparent, 4), "ignored": round(ignored, 4)}
    alpha, valid = alpha[None] if transparent else None, valid[None] if ignored else None
    return replace(views, alpha=alpha, valid=valid), report


def _of_view(mask: Image.Image, source: SourceImage) -> Float[Tensor, "H W"]:
    return to_tensor(source.of_view(mask.convert("RGB")))[0]


def _mask_of(masks: Mapping[Path, Path], path: Path | None, labels: bool) -> Image.Image | None:
    """The mask of a photograph in black and white."""
    if path is None or path not in masks:
        return None
    return open_mask(masks[path], path, labels=labels).point([0] * 128 + [255] * 128)


def are_labels(masks: Iterable[Path]) -> bool:
    """Whether no level of any mask reaches 32, so that they are labels; one soft mask may be as dark."""
    return all(np.asarray(_shown(mask).convert("L")).max() < MAX_LABELS for mask in masks)


def _shown(file: Path) -> Image.Image:
    """A mask, black where it is transparent throughout."""
    shown, alpha = open_image(file), open_alpha(file)
    if alpha is not None:
        shown.paste("black", mask=alpha.point([255] + [0] * 255))
    return shown


def open_mask(file: Path, photograph: Path | None, *, labels: bool) -> Image.Image:
    """The grey levels of a mask, or of a segmentation, which is black at label 0 and in black, and white elsewhere.

    A segmentation has ``labels`` or few colours, as the palettes of video segmentation. Of other colours the brightness
    counts. What is transparent is black.
    A UserError says that a mask has not the aspect of the upright photograph, where that is still there.
    """
    shown, alpha = _shown(file), open_alpha(file)
    mask = shown.convert("L")
    few = np.array([color for _, color in shown.getcolors(256) or [(0, (0, 0, 0))]])
    if labels or np.ptp(few, axis=1).max() >= MAX_LABELS:
        mask = Image.fromarray(np.asarray(shown).max(2) > 0).convert("L")
    with opened(file) as image:
        most = np.asarray(image).max() if image.mode.startswith("I;16") else 0
        if 0 < most <= 65535 // 2:
            raise UserError(f"no level is white, the largest is {most} of 65535; save labels with 8 bits")
    if photograph is not None and photograph.is_file():
        width, height = image_size(photograph)
        if abs(mask.width * height / (mask.height * width) - 1) > MAX_ASPECT_ERROR:
            sizes = f"has {mask.width}x{mask.height} pixels, and {photograph.name} {width}x{height}, upright"
            raise UserError(f"the mask {file} {sizes}; give a mask of the same aspect")
    return mask if alpha is None else ImageChops.multiply(mask, alpha)
