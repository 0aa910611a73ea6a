"""Layouts of results: a pattern such as ``{scene}/{style}/{frame}``, and what a file is of by it."""

import re
import unicodedata
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from anystyle.errors import UserError
from anystyle.evaluation.names import Names

DEFAULTS = ("{scene}/{style}/{frame}", "{scene}/{style}_{frame}", "{style}/{frame}")
"""Those that are tried where none is given: the two commonest, and what this program writes."""

_PART = re.compile(r"(\{\w*\}|\*)")


class Meaning(NamedTuple):
    """What a result is of: a scene, a style and a photograph, by the names that these have."""

    scene: str
    style: str
    frame: str


class ResultLayout:
    """Reads what results are of from their names.

    ``{scene}``, ``{style}`` and ``{frame}`` stand for the name of a scene, of a style and of a photograph, in any
    spelling that :class:`~anystyle.evaluation.names.Names` finds; ``*`` for any text without ``/``; all else for
    itself.

    Args:
        text: The pattern of paths without suffix. It leaves out ``{scene}`` or ``{style}`` where there is only one.
        frames: The names of photographs by scene.
        styles: The names of styles.

    Raises:
        UserError: The pattern names no frame, a field twice, or none of several scenes or styles.
    """

    def __init__(self, text: str, frames: Mapping[str, Iterable[str]], styles: Iterable[str]) -> None:
        self.text = text
        self.known = {
            "scene": [*frames],
            "style": [*styles],
            "frame": list(dict.fromkeys(frame for names in frames.values() for frame in names)),
        }
        fields = [part[1:-1] for part in _PART.findall(text) if part != "*"]
        if "frame" not in fields or len({*fields}) < len(fields) or not {*fields} <= self.known.keys():
            raise UserError(
                f"layout={text}: give {{frame}}, {{style}} and {{scene}} once each, as in {DEFAULTS[0]}; * is any text"
            )
        if not frames:
            raise UserError(f"layout={text}: the photographs are of one scene, in no folder; leave out {{scene}}")
        for field in ("scene", "style"):
            if field not in fields and (count := len(self.known[field])) > 1:
                raise UserError(f"layout={text}: there are {count} {field}s; name {{{field}}}, or give one of them")
        self.names = {"scene": Names(frames), "style": Names(self.known["style"])}
        self.frames = {scene: Names(names) for scene, names in frames.items()}
        # Of several readings of a path, one pattern finds the first in the order of names, and the other the last.
        orders = self.known, {field: names[::-1] for field, names in self.known.items()}
        self.patterns = [_compiled(text, known) for known in orders]
        self.form = _compiled(text, {field: [*names, None] for field, names in self.known.items()})

    def meanings(self, path: str) -> list[Meaning]:
        """What a path may be of; none where it is of nothing that is known."""
        found: dict[Meaning, None] = {}
        for match in filter(None, (pattern.fullmatch(path) for pattern in self.patterns)):
            named = match.groupdict()
            scenes, styles = (
                names.find(named[field]) if field in named else self.known[field] for field, names in self.names.items()
            )
            for scene in scenes:
                frames = self.frames[scene].find(named["frame"])
                found |= {Meaning(scene, style, frame): None for style in styles for frame in frames}
        return [*found]

    def reason(self, path: str) -> str | None:
        """What of a path's names is not there, such as ``no style waves``; ``None`` where it has another form."""
        match = self.form.fullmatch(path)
        if match is None:
            return None
        named = match.groupdict()
        lacks = [
            f"no {field} {named[field]}"
            for field in self.names
            if field in named and not self.names[field].find(named[field])
        ]
        return ", ".join(lacks) or f"no photograph {named['frame']}"

    def of(self, path: str) -> str | None:
        """The layout of a path, its known names replaced by fields; ``None`` where one is not found."""
        for field in ("style", "scene", "frame"):
            names = sorted(filter(None, self.known[field]), key=len, reverse=True)
            spelled = "|".join(map(_any_spelling, names)) or "(?!)"
            path = re.sub(rf"(?<![^\W_])({spelled})(?![^\W_])", f"{{{field}}}", path, count=1, flags=re.IGNORECASE)
        needed = ["frame", *(field for field in self.names if len(self.known[field]) > 1)]
        return path if all(f"{{{field}}}" in path for field in needed) else None


def _compiled(text: str, known: Mapping[str, Iterable[str | None]]) -> re.Pattern[str]:
    """A layout as a pattern with a group for each field: one of the known names, of which ``None`` is any text."""

    def written(part: str) -> str:
        if part == "*":
            return "[^/]*"
        if not _PART.fullmatch(part):
            return _any_spelling(part)
        names = ("[^/]+?" if name is None else _any_spelling(name) for name in known[part[1:-1]])
        return f"(?P<{part[1:-1]}>{'|'.join(names)})"

    return re.compile("".join(map(written, _PART.split(text))), re.IGNORECASE)


def _any_spelling(text: str) -> str:
    """A pattern of a text with any number of zeros before its numbers."""
    return re.sub(r"(?<![0-9])0*([0-9]+)", r"0*\1", re.escape(unicodedata.normalize("NFC", text)))
