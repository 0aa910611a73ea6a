"""The sets of a study as their scene, style and pictures: the best and the worst for ours, and all of them."""

import base64
import io
import math
from html import escape
from pathlib import Path

from PIL import Image

from anystyle.study.analysis import QuestionAnalysis
from anystyle.study.protocol import PICTURES, Item, Study

_EXTREMES = 3
_LARGE, _SMALL = 220, 72  # pixels of the longer side


def gallery(question: QuestionAnalysis, study: Study, folder: Path) -> str:
    """HTML: ours' best and worst sets of a question with their pictures, then every set by its mean."""
    items = {item.id: item for item in study.items}
    side = question.by_item
    ranked = sorted(zip(side.names, side.means.tolist(), side.half_width.tolist(), strict=True), key=lambda row: row[1])
    ranked = [row for row in ranked if row[0] in items]
    extremes = min(_EXTREMES, len(ranked) // 2)
    groups = (("Best for ours", ranked[:extremes]), ("Worst for ours", ranked[len(ranked) - extremes :][::-1]))
    large = "".join(
        f"<h4>{title}</h4>"
        + "".join(_pictures(study, items[name], mean, half_width, folder) for name, mean, half_width in rows)
        for title, rows in groups
    )
    rows = "".join(
        f"<tr><td>{_image(folder, items[name].ours, _SMALL, study.ours)}"
        f"{_image(folder, items[name].theirs, _SMALL, items[name].baseline)}</td>"
        f"<td>{escape(items[name].scene)}</td><td>{escape(items[name].style)}</td>"
        f"<td>{escape(items[name].baseline)}</td>"
        f'<td class="number">{_mean(mean, half_width)}</td></tr>'
        for name, mean, half_width in ranked
    )
    head = "<tr><th>ours, theirs</th><th>scene</th><th>style</th><th>against</th><th>mean, from neutral</th></tr>"
    table = f'<div class="scroll"><table><thead>{head}</thead><tbody>{rows}</tbody></table></div>'
    return (
        f"<h3>{escape(question.title)}</h3>{large}"
        f"<details><summary>All {len(ranked)} sets, best for ours first</summary>{table}</details>"
    )


def _mean(mean: float, half_width: float) -> str:
    return f"{mean:+.2f}".replace("-", "−") + (f" ± {half_width:.2f}" if math.isfinite(half_width) else "")


def _pictures(study: Study, item: Item, mean: float, half_width: float, folder: Path) -> str:
    reference = (item.reference,) if item.reference else ()
    shown = (("photograph", item.content), ("style", reference), (study.ours, item.ours), (item.baseline, item.theirs))
    figures = "".join(
        f"<div>{_image(folder, files, _LARGE, name)}<small>{escape(name)}</small></div>"
        for name, files in shown
        if files
    )
    words = f"<div><q>{escape(item.text)}</q><small>style</small></div>" * bool(item.text)
    caption = f"{escape(item.scene)}, {escape(item.style)}: {_mean(mean, half_width)} points"
    return f'<figure class="set"><div class="views">{figures}{words}</div><figcaption>{caption}</figcaption></figure>'


def _image(folder: Path, files: tuple[str, ...], longest: int, name: str) -> str:
    """The middle view, small, inside the page; a video's poster. Nothing where the file is not there."""
    file = (folder / PICTURES / files[len(files) // 2]).with_suffix(".jpg")
    if not file.is_file():
        return ""
    with Image.open(file) as picture:
        small = picture.convert("RGB")
    small.thumbnail((longest, longest), Image.Resampling.LANCZOS)
    data = io.BytesIO()
    small.save(data, "JPEG", quality=82)
    source = f"data:image/jpeg;base64,{base64.b64encode(data.getvalue()).decode()}"
    return f'<img alt="{escape(name)}" width="{small.width}" height="{small.height}" src="{source}">'
