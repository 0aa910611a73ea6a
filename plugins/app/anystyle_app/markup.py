"""What the page says of a scene, as HTML."""

from collections.abc import Sequence
from html import escape
from pathlib import Path
from urllib.parse import quote

from anystyle_app.making import PAGE, files_of

EMPTY = """<div class="scene"><div class="empty">
<p>Add photographs of a place, taken with small steps between them, a video or a splat;<br>
say or show what it should look like, and make the scene.</p>
</div></div>"""


def shown(folder: Path) -> str:
    """A made scene: its page in a frame, and links to its files, which are saved under the names of scene and style."""
    address = f"made/{quote(folder.name)}"  # relative, so that it is right behind a proxy, too
    page = f"{address}/{PAGE}"
    links = [f'<a href="{page}" target="_blank">Open in a tab</a>']
    for what, path in files_of(folder).items():
        size = f"{path.suffix[1:].upper()}, {max(path.stat().st_size / 1e6, 0.1):.1f} MB"
        links.append(f'<a href="{address}/{quote(path.name)}" download>{what} <small>{size}</small></a>')
    frame = f'<iframe src="{page}" title="{escape(folder.name)}" allow="fullscreen; clipboard-write"></iframe>'
    return f'<div class="scene">{frame}<div class="files">{"".join(links)}</div></div>'


def said(lines: Sequence[str], error: str | None = None) -> str:
    """Warnings, and why a scene could not be made."""
    paragraphs = [f"<p>{escape(line)}</p>" for line in lines]
    if error is not None:
        paragraphs.append(f'<p class="error" role="alert">{escape(error)}</p>')
    return f'<div class="lines">{"".join(paragraphs)}</div>'
