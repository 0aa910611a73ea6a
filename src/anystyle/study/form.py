"""The form: one page that shows the sets and keeps the answers, with or without a server."""

import base64
import hashlib
import json
from collections.abc import Mapping
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

import msgspec

from anystyle.io.atomic import atomic_path
from anystyle.study.protocol import PICTURES, Check, Participant, Study

_SHOWN = ("title", "instructions", "consent", "demographics", "questions", "show", "frames_per_second", "id_parameters")
"""What of a plan the page knows."""


def picture_files(study: Study, folder: Path) -> dict[str, Path]:
    """The file of every picture and video.

    Raises:
        ValueError: One is missing.
    """
    paths = {name: folder / PICTURES / name for name in study.pictures}
    missing = [name for name, file in paths.items() if not file.is_file()]
    if missing:
        raise ValueError(f"{folder / PICTURES} lacks {len(missing)} pictures, such as {missing[0]}; design anew")
    return paths


def sequence(study: Study, participant: Participant) -> list[dict[str, Any]]:
    """What a participant sees, in order: no method is named, and a check looks like any other set."""
    sets = []
    for name in participant.order:
        entry = study.shown[name]
        item = study.shown[entry.of] if isinstance(entry, Check) else entry
        assert not isinstance(item, Check)
        ours_is_a = name in participant.ours_is_a
        sets.append(
            {
                "id": name,
                "A": entry.ours if ours_is_a else entry.theirs,
                "B": entry.theirs if ours_is_a else entry.ours,
                "content": item.content,
                "reference": item.reference,
                "text": item.text,
            }
        )
    return sets


def render(study: Study, pictures: Mapping[str, str] | None = None) -> str:
    """The page; with ``pictures`` as data URLs it needs no server, and holds what every participant sees."""
    pages = files("anystyle.study") / "pages"
    script = (pages / "form.js").read_text(encoding="utf-8")
    plan = msgspec.to_builtins(study.plan)
    data = {"id": study.id, "server": pictures is None, **{name: plan[name] for name in _SHOWN}}
    if pictures is not None:
        data |= {"pictures": pictures, "people": {one.id: sequence(study, one) for one in study.participants}}
    text = json.dumps(data, ensure_ascii=False)
    return Template((pages / "form.html").read_text(encoding="utf-8")).substitute(
        title=escape(study.plan.title),
        style=(pages / "form.css").read_text(encoding="utf-8"),
        # Inside a script element, no text may look like its end.
        data=text.replace("<", "\\u003c").replace(">", "\\u003e").replace("\u2028", "\\u2028"),
        script=script,
        hash=base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
    )


def write_page(study: Study, folder: Path, out: Path) -> None:
    """Write the page with every picture inside it: one file that works offline.

    Raises:
        ValueError: A picture is missing.
    """
    kinds = {".jpg": "image/jpeg", ".mp4": "video/mp4"}
    pictures = {
        name: f"data:{kinds[file.suffix]};base64,{base64.b64encode(file.read_bytes()).decode()}"
        for name, file in picture_files(study, folder).items()
    }
    page = render(study, pictures)
    with atomic_path(out) as path:
        path.write_text(page, encoding="utf-8")
