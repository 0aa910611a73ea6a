"""Ties a folder of results to one configuration, so that an interrupted evaluation resumes with the same one."""

import json
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
from omegaconf import DictConfig, OmegaConf

from anystyle.errors import UserError
from anystyle.evaluation.judge import PARTS
from anystyle.io.atomic import folder_lock, write_json
from anystyle.io.documents import read_json
from anystyle.registry.compose import changes, flat

FILE = "bound.json"
_STYLIZER = ("backbone", "style_encoder", "placement", "injector", "renderer", "branch", "seed")


class _Bound(msgspec.Struct):
    images: dict[str, Any]
    metrics: dict[str, Any]


@contextmanager
def bind(
    config: DictConfig,
    weights: Mapping[str, Any],
    out: Path,
    parts: Collection[str],
    metric_weights: Mapping[str, Mapping[str, str]],
) -> Iterator[None]:
    """Lock a folder, and refuse it if its files come from another configuration or other weights.

    Only the configuration of the ``parts`` that the protocol takes counts. Metrics may be added and changed; the
    figures of a changed one are deleted.
    """
    names = ["protocol", *(name for name in ("scenes", "styles") if name in parts)]
    names += _STYLIZER if "stylizer" in parts else ()
    names += ("method", "loss") if "method" in parts else ()
    plain: Any = OmegaConf.to_container(config, resolve=True, enum_to_str=True)
    images = {name: plain.get(name) for name in names}
    images["weights"] = {part: row["sha256"] for part, row in weights.items()}
    nodes = plain.get("metric") or {}
    metrics = {
        name: [nodes.get(name), plain.get("correspondence"), dict(files)] for name, files in metric_weights.items()
    }
    current = json.loads(json.dumps({"images": images, "metrics": metrics}))
    path = out / FILE
    with folder_lock(out, f"another evaluation is at work in {out}; wait for its end, or give another --out"):
        what = "record of an evaluation; choose another --out, or delete that folder"
        new = not path.is_file()
        earlier: _Bound = _Bound(**current) if new else read_json(path, _Bound, what=what)
        if changed := changes(flat(earlier.images), flat(current["images"])):
            raise UserError(
                f"{out} holds an evaluation of another configuration ({changed}); choose another --out, or delete that "
                "folder"
            )
        for name, row in current["metrics"].items():
            if earlier.metrics.get(name) != row:
                for file in (out / PARTS).glob(f"{name}-*.json"):
                    file.unlink()
        current["metrics"] = {**earlier.metrics, **current["metrics"]}
        write_json(path, current)
        try:
            yield
        except BaseException:
            if new and {entry.name for entry in out.iterdir()} <= {FILE, ".lock"}:
                path.unlink()  # no result depends on it yet
            raise
