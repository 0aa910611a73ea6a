"""What a result was made of, as ``report.json`` records it: names without folders, and hashes of the files."""

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from anystyle.io.checkpoint import sha256
from anystyle.paths import short_names, text_of

Entry = Mapping[str, object]
"""Of photographs, a scene, an image or a text: its kind, and what is known of it."""


def entry(kind: str, files: Sequence[Path] = (), /, **facts: object) -> Entry:
    """An entry on one or several files or a text; the hash of several is that of the lines of ``sha256sum``."""
    if files:
        from anystyle.examples import FOLDER, examples

        names = short_names(files)
        lines = [f"{sha256(file)}  {name}\n" for file, name in zip(files, names, strict=True)]
        listed = hashlib.sha256("".join(lines).encode(errors="surrogateescape")).hexdigest()
        known = next((one for one in examples().values() if files[0].is_relative_to(FOLDER / one.file)), None)
        facts |= {"names": [text_of(name) for name in names], "sha256": lines[0][:64] if len(files) == 1 else listed}
        if known is not None:
            facts |= {"title": known.title, "author": known.author, "year": known.year}
            facts |= {"license": known.license, "source": known.provenance}
    return {"kind": kind, **facts}


def without_folders(config: DictConfig) -> object:
    """A resolved configuration for a report: of absolute paths the names."""
    text = json.dumps(OmegaConf.to_container(config, resolve=True, enum_to_str=True))
    return json.loads(re.sub(r'"/(?:[^"\\]*/)?([^"\\/]*)"', r'"\1"', text))
