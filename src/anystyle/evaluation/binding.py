"""One evaluation a folder: what was configured is written down, and another configuration is refused."""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from anystyle.evaluation.parts import forget
from anystyle.files import atomic_path

FILE = "bound.json"
_STYLIZER = ("backbone", "style_encoder", "placement", "injector", "renderer", "branch", "seed")


@contextmanager
def bind(
    config: DictConfig,
    weights: Mapping[str, Any],
    out: Path,
    named: Mapping[str, bool],
    judges: Mapping[str, Mapping[str, str]],
) -> Iterator[None]:
    """Tie a folder to a configuration, so that what an earlier run left there is of the same one.

    Metrics may be added and changed: what a changed one said before is forgotten.

    Args:
        config: What is evaluated.
        weights: What was loaded, with checksums.
        out: The folder.
        named: The parts that the protocol takes; others do not count.
        judges: For each metric, the weights that it rests on, with checksums.

    Raises:
        ValueError: The folder holds an evaluation of another configuration, or another one is at work there.
    """
    kept = ["protocol", *(name for name in ("scenes", "styles") if name in named)]
    kept += _STYLIZER if "stylizer" in named else ()
    whole = OmegaConf.to_container(config, resolve=True, enum_to_str=True)
    assert isinstance(whole, dict)
    plain = {name: whole.get(name) for name in kept}
    plain["weights"] = {part: row["sha256"] for part, row in weights.items()}
    nodes = whole.get("metric") or {}
    metrics = {name: [nodes.get(name), whole.get("correspondence"), dict(files)] for name, files in judges.items()}
    current = json.loads(json.dumps({"images": plain, "metrics": metrics}))
    path = out / FILE
    with alone(out):
        earlier = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else current
        before, now = dict(_flat(earlier["images"])), dict(_flat(current["images"]))
        changed = sorted(key for key in {*before, *now} if before.get(key) != now.get(key))
        if changed:
            shown = ", ".join(f"{key} {before.get(key)} -> {now.get(key)}" for key in changed[:4])
            raise ValueError(
                f"{out} holds an evaluation of another configuration ({shown}{', …' if len(changed) > 4 else ''}); "
                "choose another --out, or delete that folder"
            )
        forget(out, [name for name, row in current["metrics"].items() if earlier["metrics"].get(name) != row])
        current["metrics"] = {**earlier["metrics"], **current["metrics"]}
        with atomic_path(path) as temporary:
            temporary.write_text(json.dumps(current, indent=1, sort_keys=True) + "\n", encoding="utf-8")
        yield


@contextmanager
def alone(out: Path) -> Iterator[None]:
    """Keep other evaluations out of a folder until this one ends, however it ends.

    Raises:
        ValueError: Another one is in it.
    """
    try:
        import fcntl
    except ImportError:  # no such locks on this system
        yield
        return
    with (out / ".lock").open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ValueError(
                f"another evaluation is at work in {out}; wait for its end, or give another --out"
            ) from None
        yield


def _flat(node: Any, prefix: str = "") -> list[tuple[str, Any]]:
    if isinstance(node, dict):
        return [row for key, value in node.items() for row in _flat(value, f"{prefix}.{key}" if prefix else str(key))]
    return [(prefix, node)]
