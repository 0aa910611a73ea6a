"""``anystyle benchmark run``: methods on a track, each in a process of its own."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import msgspec
from omegaconf import DictConfig, ListConfig, OmegaConf

from anystyle.cli.arguments import is_override, new_parser, split
from anystyle.cli.launch import launch
from anystyle.errors import UserError, check_known
from anystyle.io.atomic import write_json
from anystyle.io.documents import kept_json
from anystyle_benchmark.results import Cell, bind, cells_of, is_done
from anystyle_benchmark.run import run_scene
from anystyle_benchmark.spec import Spec, names, read_spec
from anystyle_benchmark.track import Inputs

CONF = Path(__file__).parent / "conf"
KEYS = """\
  track=open             a bundled track (open, smoke, tnt, ablation) or a file; root=DIR where its inputs lie
  methods=[brush,mine.toml] scenes=[street] styles=[wave] seeds=[0]      default: all
  out=benchmark          the folder of results; cells that are done are not run again
  -m methods=brush,nnfm scenes=street,banana hydra/launcher=joblib       distributed over processes, or a cluster
"""


def parser() -> argparse.ArgumentParser:
    """It has no flag but help."""
    flags = new_parser("benchmark run", "Run methods on the scenes and styles of a track.", KEYS)
    flags.formatter_class = argparse.RawDescriptionHelpFormatter
    return flags


def main(args: Sequence[str]) -> None:
    """Run ``anystyle benchmark run``."""
    _, rest = split(parser(), list(args))
    options = [str(key) for key in OmegaConf.load(CONF / "benchmark.yaml") if key not in ("defaults", "hydra")]
    keys = (word.partition("=")[0] for word in rest if is_override(word))
    check_known("option", filter(str.isidentifier, keys), options)
    launch("benchmark", benchmark, rest, CONF)


def benchmark(config: DictConfig) -> None:
    """Run what a configuration names; methods that fail are records, and stop no other."""
    inputs = Inputs(str(config.track), None if config.root is None else Path(str(config.root)))
    scenes = [inputs.scene(name) for name in _chosen(config.scenes)] or inputs.track.scenes
    styles = [inputs.style(name) for name in _chosen(config.styles)] or inputs.track.styles
    if strange := [word for word in _chosen(config.seeds) if not word.isdecimal()]:
        raise UserError(f"seeds={strange[0]}; give integers of at least 0")
    seeds = list(map(int, _chosen(config.seeds)))
    specs = [read_spec(name) for name in _chosen(config.methods) or names()]
    root = Path(str(config.out))
    for spec, _ in specs:
        _check_program(spec, root)
    bind(inputs, root)
    cells: list[Cell] = []
    for spec, home in specs:
        write_json(root / spec.name / "method.json", msgspec.to_builtins(spec))
        if spec.not_run is not None:
            _say(f"{spec.name} is not run: {spec.not_run}")
            continue
        for seed in seeds or range(spec.seeds):
            if seed >= spec.seeds:
                _say(f"{spec.name} has {spec.seeds} seed{'s' * (spec.seeds > 1)}; seed {seed} is left out")
                continue
            for scene in scenes:
                cells += run_scene(inputs, spec, home, scene, styles, seed, root, _say)
    done = sum(is_done(cell, root) for cell in cells)
    track = "" if inputs.bundled else f" --track {inputs.file}"
    _say(f"{done} of {len(cells)} cells are done; next: anystyle benchmark judge {root}{track}")


def _check_program(spec: Spec, root: Path) -> None:
    """Refuse a method where another program of its name has made images: figures would be of both."""
    folder, program = root / spec.name, ("preset", "command", "requirements", "folder")
    kept = kept_json(folder / "method.json", Spec) or spec
    fields = [name for name in program if getattr(kept, name) != getattr(spec, name)]
    if fields and any(is_done(cell, root) for cell in cells_of(root, spec.name)):
        raise UserError(f"{folder} holds images made by another {fields[0]}; delete it, or name the method differently")


def _chosen(value: object) -> list[str]:
    return [] if value is None else [str(one) for one in value] if isinstance(value, ListConfig) else [str(value)]


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
