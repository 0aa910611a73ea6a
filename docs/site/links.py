"""Links from a page to files outside of `docs/` lead to the repository."""

import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
_LINK = re.compile(r"\]\((\.\./[^)\s#]+)(#[^)\s]*)?\)")


def on_page_markdown(markdown: str, *, page: Any, config: Any, **_: Any) -> str:
    """Called by mkdocs with the text of every page."""

    def outside(found: re.Match[str]) -> str:
        file = (Path(page.file.abs_src_path).parent / found[1]).resolve()
        if not file.exists():
            return found[0]  # which the strict build refuses
        return f"]({config.repo_url}/blob/main/{file.relative_to(ROOT).as_posix()}{found[2] or ''})"

    return _LINK.sub(outside, markdown)
