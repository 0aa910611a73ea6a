"""What a scene was made of, as notes of its files; folders and the EXIF data of photographs are left out."""

import hashlib
import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from anystyle.data.folder import files_of
from anystyle.data.names import short_names
from anystyle.examples import FOLDER, examples
from anystyle.io import video
from anystyle.io.checkpoint import sha256
from anystyle.io.documents import parse_json
from anystyle.paths import text_of
from anystyle.types import SourceImage, StyledScene
from anystyle.vision.weights import binding

MADE_OF = "made of "
"""The beginning of a note that is a table in JSON; others are plain text."""


def note(kind: str, files: Sequence[Path] = (), /, **facts: object) -> str:
    """A note on one or several files or a text; the hash of several is that of the lines of ``sha256sum``."""
    if files:
        names = short_names(files)
        lines = [f"{sha256(file)}  {name}\n" for file, name in zip(files, names, strict=True)]
        listed = hashlib.sha256("".join(lines).encode(errors="surrogateescape")).hexdigest()
        known = next((one for one in examples().values() if files[0].is_relative_to(FOLDER / one.file)), None)
        facts |= {"names": [text_of(name) for name in names], "sha256": lines[0][:64] if len(files) == 1 else listed}
        if known is not None:
            facts |= {"title": known.title, "author": known.author, "year": known.year}
            facts |= {"license": known.license, "source": known.provenance}
    return MADE_OF + json.dumps({"kind": kind, **facts})


def photographs(inputs: Iterable[Path], sources: Sequence[SourceImage]) -> tuple[str, ...]:
    """The note on the photographs and films that views come from."""
    shown, found = {source.path for source in sources}, [file for path in inputs for file in files_of(path)]
    used = [file for file in found if file in shown or file.suffix.lower() in video.SUFFIXES]
    return (note("photographs", used, views=len(sources)),) if used else ()


def without_folders(config: DictConfig) -> object:
    """A resolved configuration for a report: of absolute paths the names."""
    text = json.dumps(OmegaConf.to_container(config, resolve=True, enum_to_str=True))
    return json.loads(re.sub(r'"/(?:[^"\\]*/)?([^"\\/]*)"', r'"\1"', text))


def tables(notes: Iterable[str]) -> list[dict[str, Any]]:
    """The tables among notes."""
    texts = (line.removeprefix(MADE_OF) for line in notes if line.startswith(MADE_OF))
    return [parse_json(text, dict[str, Any], source="a note on provenance") for text in texts]


def anonymous(scene: StyledScene) -> StyledScene:
    """A scene without names, texts and notes but those on licences that bind results."""
    first = int(scene.styles[0][0] != "unstyled")
    titles = [title if title == "unstyled" else f"style {n}" for n, (title, _) in enumerate(scene.styles, first)]
    styles = zip(titles, (gaussians for _, gaussians in scene.styles), strict=True)
    names = tuple(f"view_{index:02d}" for index in range(len(scene.names)))
    return replace(scene, styles=tuple(styles), names=names, notes=binding(scene.notes), title="", pictures={})
