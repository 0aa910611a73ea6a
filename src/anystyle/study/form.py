"""The form: one page that shows the sets and keeps the answers, with or without a server."""

import base64
import hashlib
import json
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

from anystyle.io.atomic import atomic_path
from anystyle.study.protocol import PICTURES, Study


def picture_files(study: Study, folder: Path) -> dict[str, Path]:
    """The file of every picture.

    Raises:
        ValueError: One is missing.
    """
    paths = {name: folder / PICTURES / f"{name}.jpg" for name in study.pictures}
    missing = [file.name for file in paths.values() if not file.is_file()]
    if missing:
        raise ValueError(
            f"{folder / PICTURES} lacks {len(missing)} pictures, such as {missing[0]}; design the study again"
        )
    return paths


def page_data(study: Study, *, server: bool) -> dict[str, Any]:
    """What the page knows: nothing that names a method, and the two pictures of a set in an order of no meaning."""
    multiple = len(study.baselines) > 1
    pairs = {item.id: sorted((item.ours, item.theirs)) for item in study.items}
    ours = {item.id: item.ours for item in study.items}

    def entry(identity: str, ours_is_a: frozenset[str]) -> str:
        if identity not in pairs:
            return identity
        ours_first = pairs[identity][0] == ours[identity]
        return f"{identity}:{int(ours_first != (identity in ours_is_a))}"

    return {
        "id": study.id,
        "server": server,
        "title": study.plan.title,
        "instructions": study.plan.instructions,
        "questions": [{"name": question.name, "text": question.text} for question in study.plan.questions],
        "labels": list(study.plan.labels),
        "low": study.plan.low,
        "items": {
            item.id: {
                "pair": pairs[item.id],
                "content": item.content,
                "reference": item.reference,
                "text": item.text,
                "comparison": comparison(study, item.baseline) if multiple else "",
            }
            for item in study.items
        },
        "checks": {check.id: {"expected": check.expected} for check in study.checks},
        "participants": {
            participant.id: [entry(name, participant.ours_is_a) for name in participant.order]
            for participant in study.participants
        },
    }


def comparison(study: Study, baseline: str) -> str:
    """The name by which a baseline stands in the answers of a study with several."""
    return f"baseline-{study.baselines.index(baseline) + 1}"


def render(study: Study, pictures: dict[str, str], *, server: bool) -> str:
    """The page, with pictures given as addresses or data URLs."""
    pages = files("anystyle.study") / "pages"
    script = (pages / "form.js").read_text(encoding="utf-8")
    data = json.dumps(page_data(study, server=server) | {"pictures": pictures}, ensure_ascii=False)
    return Template((pages / "form.html").read_text(encoding="utf-8")).substitute(
        title=escape(study.plan.title),
        style=(pages / "form.css").read_text(encoding="utf-8"),
        # Inside a script element, no text may look like its end.
        data=data.replace("<", "\\u003c").replace(">", "\\u003e").replace("\u2028", "\\u2028"),
        script=script,
        hash=base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
    )


def static_page(study: Study, folder: Path) -> str:
    """The page with every picture inside it: one file that works offline and needs no server."""
    pictures = {
        name: "data:image/jpeg;base64," + base64.b64encode(file.read_bytes()).decode()
        for name, file in picture_files(study, folder).items()
    }
    return render(study, pictures, server=False)


def write_page(study: Study, folder: Path, out: Path) -> None:
    """Write the static page."""
    page = static_page(study, folder)
    with atomic_path(out) as path:
        path.write_text(page, encoding="utf-8")
