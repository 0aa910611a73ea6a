"""What the start page can ask for: the state of scenes, files, and changes."""

import re
import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, BinaryIO

from msgspec import Meta

from anystyle.errors import UserError
from anystyle.examples import PREFIX, examples, resolved
from anystyle.io.documents import parse_json
from anystyle.registry.compose import choices
from anystyle_start import results
from anystyle_start.jobs import Jobs
from anystyle_start.library import ACTIVE, Library, Record, Settings
from anystyle_start.live import Viewers
from anystyle_start.masks import Masks
from anystyle_start.progress import steps_of
from anystyle_start.uploads import LIMITS, PART, Uploads, save_pictures, small_pictures, suffixes
from anystyle_start.words import QUALITIES, command_words, painting_names, shown_command
from anystyle_viewer.server import MAX_UPLOAD, store_upload

_FAILED = re.compile(r"no cameras are found: (.*?)(?:; (reconstruction=.*) does without)?")
_MAX_MESSAGE = 256 * 1024
_OLD = "this page is older than the program; load it again"


@dataclass(frozen=True)
class Message:
    """What a request may hold besides settings; each uses what it needs."""

    title: Annotated[str, Meta(max_length=200)] = ""
    example: str = ""
    name: str = ""
    format: str = ""
    style: str = results.ALL


class Actions(AbstractContextManager["Actions"]):
    """Answers the page, of whatever tab, from scenes in a folder; ``program`` are the words that start ``anystyle``."""

    def __init__(self, folder: Path, program: Sequence[str]) -> None:
        self.library, self.program = Library(folder), program
        self.uploads, self.masks, self.viewers = Uploads(self.library), Masks(self.library), Viewers(program)
        self.jobs = Jobs(self.library, program, self.viewers.close)
        self.choices: dict[str, Any] = {
            "paintings": [{"name": name, "title": examples()[name].title} for name in painting_names()],
            "captures": [name for name in examples() if name not in painting_names()],
            "methods": choices("method"),
            "qualities": QUALITIES,
            "formats": results.formats(),
            "suffixes": suffixes(),
            "limits": {**LIMITS, "part": PART, "picture": MAX_UPLOAD},
            "live": find_spec("viser") is not None,
        }

    def __exit__(self, *_: object) -> None:
        self.jobs.close()
        self.viewers.close_all()

    def state(self, scene: str) -> dict[str, Any]:
        """All scenes in short, and one in full."""
        scenes = self.library.scenes()
        files = sorted(self.library.pictures().glob("[!.]*.png"), key=lambda path: -path.stat().st_mtime)
        return {
            "scenes": [self._short(name, record) for name, record in scenes.items() if record.kind is not None],
            "pictures": [path.name for path in files[:24]],
            **({"scene": self._full(scene, scenes[scene]) if scene in scenes else None} if scene else {}),
        }

    def _short(self, scene: str, record: Record) -> dict[str, Any]:
        return {
            "id": scene,
            "title": self._title(record),
            "named": bool(record.title or record.source),
            "created": record.created,
            "kind": record.kind,
            "state": record.job.state,
            "count": len(self.library.inputs(scene) or self._thumbnails(scene)),
            "picture": None if record.result is None else f"/style/{scene}/{record.result}/0",
            "thumbnails": self._thumbnails(scene)[:1],
        }

    def _title(self, record: Record) -> str:
        named = record.title or record.source.removeprefix(PREFIX).capitalize()
        return named or time.strftime("Scene of %d %B, %H:%M", time.localtime(record.created))

    def _thumbnails(self, scene: str) -> list[str]:
        # Names with a dot in front are of files that are being written.
        return sorted(path.name for path in self.library.thumbnails(scene).glob("[!.]*.jpg"))

    def _full(self, scene: str, record: Record) -> dict[str, Any]:
        job, viewer = record.job, self.viewers.of(scene)
        failed = _FAILED.fullmatch(job.error) if job.state == "failed" else None
        full = self._short(scene, record) | {
            "files": [path.name for path in self.library.inputs(scene)],
            "thumbnails": self._thumbnails(scene),
            "masks": self.masks.of(scene),
            "transparent": record.transparent,
            "settings": asdict(record.settings),
            **{name: getattr(job, name) for name in ("number", "error", "notes", "seconds")},
            "reasons": failed[1].split("; ") if failed else [],
            "without_cameras": failed[2] if failed else None,
            "steps": [name for name, _, _ in steps_of(record.kind)],
            "log": self.library.log(scene, job.number).is_file(),
            "result": None if record.result is None else self._result(scene, record, record.result),
            "live": None if viewer is None else {"address": viewer.address, "error": viewer.error},
        }
        if job.state == "waiting" and scene in self.jobs.waiting:
            full["before"] = self.jobs.waiting.index(scene) + (self.jobs.running is not None)
        if job.state == "running":
            full["progress"] = asdict(self.jobs.state) | {"started": self.jobs.started}
        return full

    def _result(self, scene: str, record: Record, number: int) -> dict[str, Any] | None:
        run = self.library.run(scene, number)
        try:
            report = results.read_report(run)
            styles = results.styles_of(run, report)
        except UserError:
            return None  # deleted by hand
        names = [path.name for path in self.library.inputs(scene)] if record.kind == "photographs" else []
        return {
            "number": number,
            "styles": [results.shown_title(style) for style in styles],
            "page": results.page_of(run) is not None,
            "gaussians": report.gaussians,
            "views": report.views,
            "reconstruction": asdict(report.reconstruction),
            "left_out": results.left_out(names, report),
            "command": shown_command(record.job.words, self._title(record)) if record.job.words else "",
            "licenses": sorted({text for terms in report.licenses.values() for text in terms.values()}),
        }

    def file(self, kind: str, words: Sequence[str]) -> Path | None:
        """The file at an address, or ``None``; no part of an address becomes a path by itself."""
        match kind, *words:
            case "painting", name:
                return resolved(Path(f"{PREFIX}{name}")) if name in painting_names() else None
            case "picture", name:
                return _inside(self.library.pictures(), name)
            case "thumbnail", scene, name:
                return _inside(self.library.thumbnails(scene), name)
            case "photograph", scene, name:
                return self.masks.shown(scene, name)
            case "mask", scene, name:
                return _inside(self.library.masks(scene), f"{name}.png")
            case _, scene, number, *rest if number.isdecimal():
                file = self._made(kind, scene, int(number), rest)
                return file if file is not None and file.is_file() else None
        return None

    def _made(self, kind: str, scene: str, number: int, rest: Sequence[str]) -> Path | None:
        """A file that a run has made, or one that is made of its results now."""
        run, extra = self.library.run(scene, number), self.library.files(scene, number)
        match kind, *rest:
            case ["log"]:
                return self.library.log(scene, number)
            case ["page"]:
                return results.page_of(run)
            case "export", style, format:
                return results.download(run, extra, format, style, self.program)
            case (("style" | "film" | "sheet"), index) if index.isdecimal() and run.is_dir():
                styles = results.styles_of(run, results.read_report(run))[int(index) :]
                if styles and kind == "style":
                    return results.picture(styles[0], extra)
                return styles[0].folder / {"film": "video.mp4", "sheet": "sheet.png"}[kind] if styles else None
        return None

    def post(self, words: Sequence[str], query: Mapping[str, str], body: BinaryIO) -> dict[str, Any]:
        """Change something; the answer is what the page needs to go on."""
        match words:
            case ["pictures"]:
                return {"name": store_upload(self.library.pictures(), query.get("name", ""), body.read()).name}
            case ["scenes", scene, "files"]:
                numbers = [query.get(name, "") for name in ("offset", "total")]
                if not all(number.isdecimal() for number in numbers):
                    raise UserError("an upload without a size; load the page again")
                name, upload, (offset, total) = query.get("name", ""), query.get("upload", ""), map(int, numbers)
                return {"name": self.uploads.receive(scene, name, upload, offset, total, body)}
            case ["scenes", scene, "masks"]:
                return {"name": self.masks.keep(scene, query.get("name", ""), body.read())}
        text = body.read(_MAX_MESSAGE) or b"{}"
        match words:
            case ["scenes"]:
                return {"id": self._create(parse_json(text, Message, source="the request"))}
            case ["scenes", scene, "run"]:
                self._run(scene, parse_json(text, Settings, source="the form"))
                return {}
            case ["scenes", scene, action]:
                self.library[scene]
                return self._change(scene, action, parse_json(text, Message, source="the request"))
        raise UserError(_OLD)

    def _change(self, scene: str, action: str, message: Message) -> dict[str, Any]:
        match action:
            case "cancel":
                self.jobs.cancel(scene)
            case "rename":
                title = " ".join(message.title.split())
                if not title:
                    raise UserError("a scene needs a name")
                self.library.update(scene, lambda record: replace(record, title=title))
            case "delete":
                self._delete(scene)
            case "remove":
                self.masks.forget(scene, message.name)
                self.uploads.remove(scene, message.name)
            case "unmask":
                self.masks.clear(scene)
            case "live":
                record, number = self._finished(scene)
                words = [word for word in record.job.words[1:] if word.startswith(("method", "model"))]
                self.viewers.start(scene, self.library.run(scene, number), self.library.path(scene) / "live", words)
            case "export":
                record, number = self._finished(scene)
                style, format = message.style, message.format
                run, files = self.library.run(scene, number), self.library.files(scene, number)
                file = results.download(run, files, format, style, self.program)
                address = f"/export/{scene}/{number}/{style}/{format}"
                return {"address": address, "name": f"{self._title(record)}.{format}", "bytes": file.stat().st_size}
            case _:
                raise UserError(_OLD)
        return {}

    def _finished(self, scene: str) -> tuple[Record, int]:
        """A scene, and the number of the run whose results are shown."""
        record = self.library[scene]
        if record.result is None:
            raise UserError("the scene is not made yet")
        return record, record.result

    def _create(self, message: Message) -> str:
        scene = self.library.create(" ".join(message.title.split()))
        if message.example:
            source = f"{PREFIX}{message.example}"
            folder = resolved(Path(source))
            for path in sorted(folder.glob("*.jpg")):
                save_pictures(small_pictures("photographs", path), self.library.thumbnails(scene), path.name)
            self.library.update(scene, lambda record: replace(record, kind="example", source=source))
        return scene

    def _run(self, scene: str, settings: Settings) -> None:
        record, inputs = self.library[scene], self.library.inputs(scene)
        if record.kind is None:
            raise UserError("there is nothing to make a scene of; add photographs, a film or a splat")
        source = record.source or str(inputs[0] if record.kind != "photographs" else inputs[0].parent)
        masks = self.library.masks(scene) if self.masks.of(scene) else None
        words = command_words(settings, record.kind, source, self.library.pictures(), masks)
        self.jobs.submit(scene, settings, words)

    def _delete(self, scene: str) -> None:
        self.jobs.cancel(scene)
        if self.library[scene].job.state in ACTIVE:
            raise UserError("the scene is still being made; try again")
        self.viewers.close(scene)
        self.library.delete(scene)


def _inside(folder: Path, name: str) -> Path | None:
    """The file of a name in a folder."""
    return next((path for path in folder.glob("*") if path.name == name), None)
