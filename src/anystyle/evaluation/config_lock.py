"""Ties a folder of results to one configuration, so that an interrupted evaluation resumes with the same one."""

import json
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from anystyle.io.atomic import folder_lock, write_json
from anystyle.io.run_folder import RECORD, refuse_changes

_STYLIZER = ("backbone", "style_encoder", "placement", "injector", "renderer", "branch", "seed")


@contextmanager
def bind(config: DictConfig, weights: Mapping[str, Any], out: Path, parts: Collection[str]) -> Iterator[None]:
    """Lock a folder, and refuse it if its images come from another configuration or other weights.

    Only the configuration of the ``parts`` that the protocol takes counts. Metrics may change: figures are computed
    from the images each time.
    """
    names = ["protocol", *(name for name in ("scenes", "styles") if name in parts)]
    names += _STYLIZER if "stylizer" in parts else ()
    names += ("method", "loss") if "method" in parts else ()
    plain: Any = OmegaConf.to_container(config, resolve=True, enum_to_str=True)
    images = {name: plain.get(name) for name in names}
    images["protocol"].pop("missing", None)  # no image depends on it
    images["weights"] = {part: row["sha256"] for part, row in weights.items()}
    images = json.loads(json.dumps(images))
    with folder_lock(out, f"another evaluation is at work in {out}; wait for its end, or give another --out"):
        remedy = "choose another --out, or delete that folder"
        known = refuse_changes(out, images, "an evaluation", remedy)
        write_json(out / RECORD, images)
        try:
            yield
        except BaseException:
            if not known and {entry.name for entry in out.iterdir()} <= {RECORD, ".lock"}:
                (out / RECORD).unlink()  # no result depends on it yet
            raise
