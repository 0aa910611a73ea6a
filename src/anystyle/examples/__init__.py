"""A capture and paintings that come with the package; ``example:NAME`` stands for one wherever a path is taken."""

from dataclasses import dataclass
from pathlib import Path

from anystyle.errors import check_known
from anystyle.io.documents import read_json
from anystyle.paths import text_of

PREFIX = "example:"
FOLDER = Path(__file__).parent


@dataclass(frozen=True)
class Example:
    """An example, with the attribution that its licence requires.

    Args:
        file: A folder of photographs or a painting, relative to this package.
        title: What it is.
        author: Who made it, and the years that a painter lived.
        year: When it was made.
        license: Under which it may be passed on.
        provenance: Where the files come from.
    """

    file: str
    title: str
    author: str
    year: str
    license: str
    provenance: str


def examples() -> dict[str, Example]:
    """All examples by their names."""
    return read_json(FOLDER / "index.json", dict[str, Example])


def listed() -> str:
    """A line on each example: the name that stands for it, what it is, who made it when, and its licence."""
    width = max(map(len, examples())) + len(PREFIX)
    rows = ((f"{PREFIX}{name}", one) for name, one in examples().items())
    return "\n".join(f"  {name:<{width}}  {one.title}; {one.author}, {one.year}; {one.license}" for name, one in rows)


def resolved(path: Path) -> Path:
    """The files that ``example:NAME`` stands for; any other path as it is."""
    if not str(path).startswith(PREFIX):
        return path
    name, known = str(path).removeprefix(PREFIX), examples()
    check_known("example", [name], known)
    return FOLDER / known[name].file


def title_of(path: Path) -> str:
    """What an example is called; of any other file the name without suffix."""
    if str(path).startswith(PREFIX):
        return examples()[str(path).removeprefix(PREFIX)].title
    return text_of(path.stem)
