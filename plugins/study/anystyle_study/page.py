"""The form as one page that works offline."""

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

from anystyle.errors import UserError
from anystyle.io.atomic import write_text
from anystyle_study.protocol import PICTURES, Participant, Study

_KINDS = {".jpg": "image/jpeg", ".mp4": "video/mp4"}
_SHOWN = ("title", "instructions", "consent", "demographics", "questions", "show", "frames_per_second")
"""Fields of the plan that the page gets."""


def sequence(study: Study, participant: Participant) -> list[dict[str, Any]]:
    """The sets for a participant, in order; methods are not named, and checks look like any other set."""
    sets = []
    for name in participant.order:
        entry = study.shown[name]
        item = study.item(name)
        a, b = (entry.ours, entry.theirs) if name in participant.ours_is_a else (entry.theirs, entry.ours)
        sets.append(
            {"id": name, "A": a, "B": b, "content": item.content, "reference": item.reference, "text": item.text}
        )
    return sets


def render(study: Study, pictures: Mapping[str, str]) -> str:
    """The page with the sets of every participant; ``pictures`` are the data URLs of all files."""
    pages = files("anystyle_study") / "pages"
    page, style, script = ((pages / f"form.{name}").read_text(encoding="utf-8") for name in ("html", "css", "js"))
    plan = msgspec.to_builtins(study.plan)
    data = {
        "id": study.id,
        **{name: plan[name] for name in _SHOWN},
        "pictures": pictures,
        "people": {person.id: sequence(study, person) for person in study.participants},
    }
    # No text may look like the end of the script element.
    text = json.dumps(data, ensure_ascii=False).replace("<", "\\u003c").replace(">", "\\u003e")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    title = escape(study.plan.title)
    return Template(page).substitute(title=title, style=style, data=text, script=script, hash=digest)


def write_page(study: Study, folder: Path, out: Path) -> None:
    """Write the page with all pictures of the designed study's ``folder`` in it."""
    paths = [folder / PICTURES / name for name in study.pictures]
    if missing := [path for path in paths if not path.is_file()]:
        raise UserError(f"{folder / PICTURES} lacks {len(missing)} pictures, such as {missing[0].name}; design anew")
    contents = ((path, base64.b64encode(path.read_bytes()).decode()) for path in paths)
    pictures = {path.name: f"data:{_KINDS[path.suffix]};base64,{content}" for path, content in contents}
    write_text(out, render(study, pictures))
