"""The scenes of the start page on disk: one folder each, whose ``scene.json`` says what it is and how far it is."""

import re
import secrets
import shutil
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from msgspec import Meta

from anystyle.errors import UserError
from anystyle.io.atomic import PARTIAL, write_json
from anystyle.io.documents import kept_json
from anystyle.paths import natural

_ID = re.compile(r"[0-9a-f]{12}")
Text = Annotated[str, Meta(max_length=2000)]
Kind = Literal["photographs", "film", "splat", "example"]
ACTIVE = ("waiting", "running")
ERROR = "anystyle: error: "
"""What the program prints before the reason why it fails."""


@dataclass(frozen=True)
class Settings:
    """What a scene is made with: the fields of the form."""

    texts: Annotated[tuple[Text, ...], Meta(max_length=24)] = ()  # styles in words
    images: Annotated[tuple[Text, ...], Meta(max_length=24)] = ()  # ``example:NAME``, or names of uploaded pictures
    mix: float | None = None  # the point between exactly two styles, in [0, 1]
    quality: str = "good"  # of the fit
    strength: float = 1.0  # in [0, 1]
    preserve_color: float = 0.0  # in [0, 1]
    scale: float = 1.0  # size of strokes
    masked: Literal["ignored", "empty"] = "ignored"  # what masks mark: not of the scene, or nothing is there
    method: str = "branch"  # a plugin or preset of the kind ``method``
    more: Text = ""  # more arguments of the command line


@dataclass(frozen=True)
class Job:
    """The latest run of a scene."""

    # ``interrupted``: the program ended while it ran or waited
    state: Literal["none", "waiting", "running", "done", "failed", "cancelled", "interrupted"] = "none"
    error: str = ""  # why it failed, in one line
    number: int = 0  # of the run; its results lie in ``runs/NUMBER``
    seconds: float = 0.0  # that it took
    notes: tuple[str, ...] = ()  # warnings of the run
    words: tuple[str, ...] = ()  # of its command line


@dataclass(frozen=True)
class Record:
    """``scene.json``."""

    title: str = ""  # given by the user
    created: float = 0.0  # seconds since 1970
    kind: Kind | None = None  # what the scene is made of; ``None`` while nothing was uploaded
    source: str = ""  # ``example:NAME`` for an example
    transparent: tuple[str, ...] = ()  # photographs with an alpha channel
    settings: Settings = field(default_factory=Settings)  # of the latest run
    job: Job = field(default_factory=Job)  # the latest run
    result: int | None = None  # the number of the run whose results are shown


class Library:
    """All scenes in a folder; threads share it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._scenes, self._lock = folder / "scenes", threading.RLock()
        self._scenes.mkdir(parents=True, exist_ok=True)
        for leftover in self._scenes.glob(f"{PARTIAL}*"):
            shutil.rmtree(leftover, ignore_errors=True)
        self._records: dict[str, Record] = {}
        for path in self._scenes.iterdir():
            record = kept_json(path / "scene.json", Record) if _ID.fullmatch(path.name) else None
            if record is None:
                continue
            self._records[path.name] = record
            shutil.rmtree(self.uploads(path.name), ignore_errors=True)
            if record.job.state in ACTIVE:
                self.drop_run(path.name, record.job.number)
                self.update(path.name, lambda old: replace(old, job=replace(old.job, state="interrupted")))
            elif record.kind is None:
                self.delete(path.name)

    def scenes(self) -> dict[str, Record]:
        """All scenes by their ids, the newest first."""
        with self._lock:
            return dict(sorted(self._records.items(), key=lambda item: -item[1].created))

    def __getitem__(self, scene: str) -> Record:
        if (record := self._records.get(scene)) is None:
            raise UserError("this scene is not there any more; go back to the list of scenes")
        return record

    def create(self, title: str = "") -> str:
        """A new scene without photographs; its id."""
        scene = secrets.token_hex(6)
        with self._lock:
            (self._scenes / scene).mkdir()
            self._records[scene] = Record(title, created=time.time())
            self.update(scene, lambda record: record)
        return scene

    def update(self, scene: str, change: Callable[[Record], Record]) -> Record:
        """Replace a record by a function of it."""
        with self._lock:
            record = change(self[scene])
            write_json(self.path(scene) / "scene.json", asdict(record))
            self._records[scene] = record
            return record

    def set_job(self, scene: str, **changes: Any) -> Record:
        """Change fields of the latest run."""
        return self.update(scene, lambda record: replace(record, job=replace(record.job, **changes)))

    def delete(self, scene: str) -> None:
        """Delete a scene and all its files."""
        with self._lock:
            path, gone = self.path(scene), self._scenes / f"{PARTIAL}{scene}"
            del self._records[scene]
            path.rename(gone)
        shutil.rmtree(gone, ignore_errors=True)

    def path(self, scene: str) -> Path:
        """The folder of a scene."""
        self[scene]  # no id from a request becomes a path unless it is known
        return self._scenes / scene

    def inputs(self, scene: str) -> list[Path]:
        """The files that a scene is made of, in natural order."""
        folder = self.path(scene) / "input"
        return sorted(folder.iterdir(), key=lambda path: natural(path.name)) if folder.is_dir() else []

    def thumbnails(self, scene: str) -> Path:
        """The folder of small pictures of its inputs."""
        return self.path(scene) / "thumbnails"

    def masks(self, scene: str) -> Path:
        """The folder of masks of its photographs."""
        return self.path(scene) / "masks"

    def uploads(self, scene: str) -> Path:
        """The folder of files whose upload has not ended."""
        return self.path(scene) / "uploads"

    def pictures(self) -> Path:
        """The folder of uploaded pictures, which all scenes share as styles."""
        return self.folder / "pictures"

    def run(self, scene: str, number: int) -> Path:
        """The folder of a run's results."""
        return self.path(scene) / "runs" / str(number)

    def files(self, scene: str, number: int) -> Path:
        """The folder of files that were made of a run's results for downloads."""
        return self.path(scene) / "runs" / f"{number}-files"

    def log(self, scene: str, number: int) -> Path:
        """What a run has printed."""
        return self.path(scene) / "runs" / f"{number}.log"

    def drop_run(self, scene: str, number: int) -> None:
        """Delete a run's results, its log excepted."""
        for folder in (self.run(scene, number), self.files(scene, number)):
            shutil.rmtree(folder, ignore_errors=True)
