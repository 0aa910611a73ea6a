"""One configuration for each folder of an evaluation, and one process at a time."""

import json
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
from omegaconf import DictConfig, OmegaConf

from anystyle.documents import read_json
from anystyle.evaluation.resume import forget
from anystyle.io.atomic import folder_lock, write_json
from anystyle.registry.changes import changes, flat

FILE = "bound.json"
_STYLIZER = ("backbone", "style_encoder", "placement", "injector", "renderer", "branch", "seed")


_WHAT = "record of an evaluation; choose another --out, or delete that folder"


class _Bound(msgspec.Struct):
    """What the files of a folder rest on."""

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
    """Tie a folder to a configuration, so that all files in it are of the same one, and lock it.

    Metrics may be added and changed; the figures of a changed one are deleted.

    Args:
        config: Of the evaluation.
        weights: What was loaded, with checksums.
        out: The folder.
        parts: The parts that the protocol takes; the configuration of others is ignored.
        metric_weights: For each metric, the weights that it rests on, with checksums.

    Raises:
        ValueError: The folder holds an evaluation of another configuration, or another process is at work there.
    """
    names = ["protocol", *(name for name in ("scenes", "styles") if name in parts)]
    names += _STYLIZER if "stylizer" in parts else ()
    names += ("method", "loss") if "method" in parts else ()
    plain = OmegaConf.to_container(config, resolve=True, enum_to_str=True)
    assert isinstance(plain, dict)
    images = {name: plain.get(name) for name in names}
    images["weights"] = {part: row["sha256"] for part, row in weights.items()}
    nodes = plain.get("metric") or {}
    metrics = {
        name: [nodes.get(name), plain.get("correspondence"), dict(files)] for name, files in metric_weights.items()
    }
    current = json.loads(json.dumps({"images": images, "metrics": metrics}))
    path = out / FILE
    refusal = f"another evaluation is at work in {out}; wait for its end, or give another --out"
    with folder_lock(out, refusal):
        earlier: _Bound = read_json(path, _Bound, what=_WHAT) if path.is_file() else _Bound(**current)
        changed = changes(flat(earlier.images), flat(current["images"]))
        if changed:
            raise ValueError(
                f"{out} holds an evaluation of another configuration ({changed}); choose another --out, or delete that "
                "folder"
            )
        forget(out, [name for name, row in current["metrics"].items() if earlier.metrics.get(name) != row])
        current["metrics"] = {**earlier.metrics, **current["metrics"]}
        new = not path.is_file()
        write_json(path, current)
        try:
            yield
        except BaseException:
            if new and {entry.name for entry in out.iterdir()} <= {FILE, ".lock"}:
                path.unlink()  # nothing is here yet that rests on it
            raise
