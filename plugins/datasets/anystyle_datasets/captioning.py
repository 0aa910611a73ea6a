"""Describing images with an image-to-text model."""

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import torch
from PIL import Image

from anystyle.data.captions import read_captions
from anystyle.data.images import open_image
from anystyle.errors import UserError
from anystyle.types import OnProgress, Progress, no_progress
from anystyle_datasets.files import caption_row, pictures_below, write_lines

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
    describe = _transformers().pipeline("image-text-to-text", model=model, device=device)

    def captions(images: Sequence[Image.Image], prompt: str) -> Sequence[str]:
        chats = [
            [{"role": "user", "content": [{"type": "image", "image": image}, {"type": "text", "text": prompt}]}]
            for image in images
        ]
        return [output[0]["generated_text"] for output in describe(text=chats, return_full_text=False)]

    return captions


def chat_captioner(model: str, device: str) -> Captioner:
    """A model whose page brings the code of a method ``chat``, as MiniCPM-V's do: that code is downloaded and run."""
    library = _transformers()
    tokenizer = library.AutoTokenizer.from_pretrained(model, trust_remote_code=True)
    network = library.AutoModel.from_pretrained(model, trust_remote_code=True, torch_dtype=torch.bfloat16)
    network = network.eval().to(device)

    def captions(images: Sequence[Image.Image], prompt: str) -> Sequence[str]:
        chats = ([{"role": "user", "content": [image, prompt]}] for image in images)
        return [network.chat(msgs=chat, tokenizer=tokenizer, enable_thinking=False) for chat in chats]

    return captions


def _transformers() -> Any:
    try:
        return import_module("transformers")
    except ModuleNotFoundError:
        raise ImportError('captions need transformers; pip install "anystyle[captions]"') from None


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
    names = [path.relative_to(root).as_posix() for path in pictures_below(root)]
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
            # In one line, without the file's separator.
            tidy = (" ".join(text.replace(";", ",").split()) for text in answers)
            texts |= dict(zip(images, tidy, strict=True))
            as_json = out.suffix.lower() == ".jsonl"
            write_lines(out, (caption_row(*row) if as_json else ";".join(row) for row in sorted(texts.items())))
        done = len(names) - len(left) + min(start + batch, len(left))
        on_progress(Progress.count("describing", done, len(names)))
    return failed
