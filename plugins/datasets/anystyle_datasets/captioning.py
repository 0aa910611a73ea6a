"""Describing images with an image-to-text model."""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import torch
from PIL import Image

from anystyle.data.captions import read_captions
from anystyle.data.images import SUFFIXES, open_image
from anystyle.errors import UserError
from anystyle.io.atomic import atomic_path
from anystyle.types import OnProgress, Progress, no_progress

PROMPT = (
    "In 300 chars, give a precise description of image style visual features: exact color and brightness specs, "
    "contrast, contour line shape/weight, and brushwork or texture patterns."
)
"""The question of AnyStyle's authors, quoted from ``assets/wikiart_desc_generation.md`` of joaxkal/AnyStyle."""
DEFAULT_MODEL = "openbmb/MiniCPM-V-4_5"
"""The model that they asked, which answers by code that its page brings."""
SIDE = 224
"""Height and width of the pictures that it was shown."""

Captioner = Callable[[Sequence[Image.Image], str], Sequence[str]]
"""From images and a prompt to one text for each image."""


def transformers_captioner(model: str, device: str) -> Captioner:
    """A model of transformers' ``image-text-to-text`` pipeline, by its name on the hub or its folder."""
    try:
        from transformers import pipeline  # pyright: ignore[reportMissingImports]
    except ModuleNotFoundError:
        raise _needs_transformers() from None
    describe = pipeline("image-text-to-text", model=model, device=device)

    def captions(images: Sequence[Image.Image], prompt: str) -> Sequence[str]:
        chats = [
            [{"role": "user", "content": [{"type": "image", "image": image}, {"type": "text", "text": prompt}]}]
            for image in images
        ]
        return [output[0]["generated_text"] for output in describe(text=chats, return_full_text=False)]

    return captions


def chat_captioner(model: str, device: str) -> Captioner:
    """A model whose page brings the code of a method ``chat``, as MiniCPM-V's do: that code is downloaded and run."""
    try:
        from transformers import AutoModel, AutoTokenizer  # pyright: ignore[reportMissingImports]
    except ModuleNotFoundError:
        raise _needs_transformers() from None
    tokenizer = AutoTokenizer.from_pretrained(model, trust_remote_code=True)
    network = AutoModel.from_pretrained(model, trust_remote_code=True, torch_dtype=torch.bfloat16).eval().to(device)

    def captions(images: Sequence[Image.Image], prompt: str) -> Sequence[str]:
        chats = ([{"role": "user", "content": [image, prompt]}] for image in images)
        return [network.chat(msgs=chat, tokenizer=tokenizer, enable_thinking=False) for chat in chats]

    return captions


def _needs_transformers() -> ImportError:
    return ImportError('captions need transformers; pip install "anystyle[captions]"')


def caption_folder(
    root: Path,
    captioner: Captioner,
    *,
    out: Path,
    prompt: str = PROMPT,
    batch: int = 8,
    on_progress: OnProgress = no_progress,
) -> Mapping[str, str]:
    """Describe every image below a folder; the result is, for each image that could not be read, why.

    The file, ``.jsonl`` for ``styles=folder`` or lines ``path;text`` for ``styles=wikiart``, grows with every batch;
    captions in it are kept, so that an interrupted run is continued.
    """
    names = sorted(path.relative_to(root).as_posix() for path in root.rglob("*") if path.suffix.lower() in SUFFIXES)
    if not names:
        raise UserError(f"there are no pictures below {root}")
    texts = read_captions(out) if out.is_file() else {}
    left = [name for name in names if not texts.get(name)]
    failed: dict[str, str] = {}
    for start in range(0, len(left), batch):
        images: dict[str, Image.Image] = {}
        for name in left[start : start + batch]:
            try:
                images[name] = open_image(root / name).resize((SIDE, SIDE), Image.Resampling.BICUBIC)
            except (UserError, OSError) as error:
                failed[name] = str(error)
        if images:
            answers = list(captioner(list(images.values()), prompt))
            if len(answers) != len(images):
                raise UserError(f"the model gave {len(answers)} texts for {len(images)} pictures")
            texts |= {name: tidy(text) for name, text in zip(images, answers, strict=True)}
            _write(out, texts)
        done = len(names) - len(left) + min(start + batch, len(left))
        on_progress(Progress.count("describing", done, len(names)))
    return failed


def tidy(text: str) -> str:
    """A caption in one line without the file's separator."""
    return " ".join(text.replace(";", ",").split())


def _write(out: Path, texts: Mapping[str, str]) -> None:
    with atomic_path(out) as temporary, temporary.open("w", encoding="utf-8") as file:
        for name, text in sorted(texts.items()):
            row = json.dumps({"image": name, "text": text}, ensure_ascii=False)
            file.write(f"{row}\n" if out.suffix.lower() == ".jsonl" else f"{name};{text}\n")
