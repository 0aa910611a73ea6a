"""Captions of pictures: reading them, and making them with an image-to-text model."""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

import msgspec
from PIL import Image

from anystyle.data.images import SUFFIXES, open_image
from anystyle.documents import parse_json, read_text
from anystyle.io.atomic import atomic_path

_FORM = '{"image": "...", "text": "..."}'


class _Entry(msgspec.Struct):
    """A line of JSON Lines."""

    image: str
    text: str


def read_captions(path: Path) -> dict[str, str]:
    """Captions by image name, from JSON Lines or from lines ``name;text``.

    Raises:
        ValueError: The file cannot be read; the message names the line.
    """
    lines = read_text(path, what="file of captions").splitlines()
    captions: dict[str, str] = {}
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        if path.suffix.lower() in (".jsonl", ".json"):
            entry: _Entry = parse_json(line, _Entry, source=f"line {number} of {path}", what=_FORM)
            name, text = entry.image, entry.text
        else:
            name, separator, text = line.partition(";")
            if not separator:
                raise ValueError(f"line {number} of {path} has no semicolon; 'image;text' is expected")
        captions[name.strip()] = text.strip()
    return captions


PROMPT = (
    "Describe the artistic style of this painting in at most 300 characters: brushwork, palette, texture, composition. "
    "Say nothing of what it depicts."
)
DEFAULT_MODEL = "HuggingFaceTB/SmolVLM-Instruct"
"""Part of the transformers library. MiniCPM-V 4.5, the paper's, is not: its page loads code from the hub and calls a
method of its own, so its captions come from its page's script, and are read from a file here."""
SIDE = 224
LONGEST = 300
"""Characters of a description; what is longer is cut at a word."""


@runtime_checkable
class Captioner(Protocol):
    """Turns pictures into texts."""

    def __call__(self, pictures: Sequence[Image.Image], prompt: str) -> Sequence[str]:
        """One text for each picture; the prompt says what to describe."""
        ...


def transformers_captioner(model: str, device: str) -> Captioner:
    """A model, by its name on the hub or its folder, of transformers' ``image-text-to-text`` pipeline.

    Raises:
        ImportError: The library is not installed.
    """
    try:
        from transformers import pipeline  # type: ignore[import-not-found]
    except ModuleNotFoundError:
        raise ImportError('captions need transformers; pip install "anystyle[captions]"') from None
    describe = pipeline("image-text-to-text", model=model, device=device)

    def captions(pictures: Sequence[Image.Image], prompt: str) -> Sequence[str]:
        asked = [
            [{"role": "user", "content": [{"type": "image", "image": picture}, {"type": "text", "text": prompt}]}]
            for picture in pictures
        ]
        return [output[0]["generated_text"] for output in describe(text=asked, return_full_text=False)]

    return captions


def caption_folder(
    root: Path,
    captioner: Captioner,
    *,
    out: Path,
    prompt: str = PROMPT,
    batch: int = 8,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Mapping[str, str]:
    """Describe every picture below a folder, and write the file of descriptions.

    The file, ``.jsonl`` for ``styles=folder`` or lines ``path;text`` for ``styles=wikiart``, grows with every batch,
    and what it holds already is not asked again: a run that was interrupted goes on.

    Returns:
        What could not be read, and why.

    Raises:
        ValueError: There are no pictures, or the model does not answer each with one text.
    """
    names = sorted(
        path.relative_to(root).as_posix()
        for path in root.rglob("*")
        if path.suffix.lower() in SUFFIXES and path.is_file()
    )
    if not names:
        raise ValueError(f"there are no pictures below {root}")
    texts = read_captions(out) if out.is_file() else {}
    left = [name for name in names if not texts.get(name)]
    failed: dict[str, str] = {}
    for start in range(0, len(left), batch):
        pictures: dict[str, Image.Image] = {}
        for name in left[start : start + batch]:
            try:
                pictures[name] = open_image(root / name, longest=2 * SIDE).resize(
                    (SIDE, SIDE), Image.Resampling.LANCZOS
                )
            except (ValueError, OSError) as error:
                failed[name] = str(error)
        if pictures:
            answers = list(captioner(list(pictures.values()), prompt))
            if len(answers) != len(pictures):
                raise ValueError(f"the model gave {len(answers)} texts for {len(pictures)} pictures")
            texts |= {name: tidy(text) for name, text in zip(pictures, answers, strict=True)}
            _write(out, texts)
        progress(len(names) - len(left) + min(start + batch, len(left)), len(names))
    return failed


def tidy(text: str) -> str:
    """A description in one line without the separator of the file, no longer than :data:`LONGEST`."""
    words = " ".join(text.replace(";", ",").split())
    return words if len(words) <= LONGEST else words[: LONGEST + 1].rpartition(" ")[0].rstrip(",.:") + "."


def _write(out: Path, texts: Mapping[str, str]) -> None:
    lines = out.suffix.lower() == ".jsonl"
    with atomic_path(out) as temporary:
        temporary.write_text(
            "".join(
                (json.dumps({"image": name, "text": text}, ensure_ascii=False) if lines else f"{name};{text}") + "\n"
                for name, text in sorted(texts.items())
            ),
            encoding="utf-8",
        )
