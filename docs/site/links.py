"""Links from a page to files outside of `docs/`, which the site does not hold, become paths in a checkout."""

import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
_LINK = re.compile(r"\[([^\]]*)\]\((\.\./[^)\s#]+)(?:#[^)\s]*)?\)")


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """Called by mkdocs with the text of every page."""

    def outside(match: re.Match[str]) -> str:
        file = (Path(page.file.abs_src_path).parent / match[2]).resolve()
        if not file.exists():
            return match[0]  # which the strict build refuses
        return f"{match[1]}, `{file.relative_to(ROOT).as_posix()}`"

    return _LINK.sub(outside, markdown)
