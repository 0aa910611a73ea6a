#!/usr/bin/env bash
# Names of scenes that look like numbers, on five command lines: declared as `str`, 2024_10_05 becomes "20241005".
#
# A field `scene: str`, given on the command line; a dot where the word comes through as it was written:
#                                        2024_10_05    3.10     12e3       007    yes     room#2
#   Hydra 1.3.8                          20241005      3.1      12000.0    .      .       raises
#   OmegaConf 2.3.1, from_dotlist, and
#           files, merged into `str`     20241005      3.1      12000.0    7      True    .
#   fire 0.7.1, def f(scene: str)        20241005      3.1      12000.0    .      .       room
#   jsonargparse 4.53.0, tyro 1.0.17     .             .        .          .      .       .
#   jsonargparse, int | str              20241005      .        .          7      .       .
#           str | int                    .             .        .          .      .       .
# Hydra and OmegaConf make a number of the word first and a word of the number then; fire does not look at annotations:
# these are an int and floats, and what follows # is gone. So a folder of another name is read, or made, and two
# captures, 3.1 and 3.10, are one. No warning. With Hydra write scene='"2024_10_05"', and quote names in files.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet hydra-core==1.3.8 omegaconf==2.3.1 fire==0.7.1 jsonargparse==4.53.0 tyro==1.0.17
cat > app.py <<'PYTHON'
from dataclasses import dataclass

import hydra
from hydra.core.config_store import ConfigStore


@dataclass
class Config:
    scene: str = "garden"


ConfigStore.instance().store(name="config", node=Config)


@hydra.main(version_base=None, config_name="config")
def main(config):
    print(repr(config.scene))


main()
PYTHON
env/bin/python -W error::UserWarning - <<'PYTHON'
import ast
import contextlib
import io
import subprocess
from dataclasses import dataclass
from pathlib import Path

import fire
import jsonargparse
import tyro
from omegaconf import OmegaConf


@dataclass
class Config:
    scene: str = "garden"


def by_hydra(word):
    command = ["env/bin/python", "app.py", f"scene={word}", "hydra.output_subdir=null", "hydra.run.dir=."]
    done = subprocess.run(command, capture_output=True, text=True)
    return ast.literal_eval(done.stdout) if done.returncode == 0 else None


def by_dotlist(word):
    return OmegaConf.merge(OmegaConf.structured(Config), OmegaConf.from_dotlist([f"scene={word}"])).scene


def by_file(word):
    Path("scene.yaml").write_text(f"scene: {word}\n")
    return OmegaConf.merge(OmegaConf.structured(Config), OmegaConf.load("scene.yaml")).scene


def by_fire(word):
    def command(scene: str):
        return [scene]

    with contextlib.redirect_stdout(io.StringIO()):
        return fire.Fire(command, command=[f"--scene={word}"])[0]


def by_jsonargparse(kind):
    def way(word):
        parser = jsonargparse.ArgumentParser()
        parser.add_argument("--scene", type=kind)
        return parser.parse_args([f"--scene={word}"]).scene

    return way


def by_tyro(word):
    return tyro.cli(Config, args=["--scene", word]).scene


words = ("2024_10_05", "3.10", "12e3", "007", "yes", "room#2")
for name, way, expected in (
    ("Hydra", by_hydra, ("20241005", "3.1", "12000.0", "007", "yes", None)),
    ("Hydra, quoted", lambda word: by_hydra(f'"{word}"'), words),
    ("OmegaConf, dotlist", by_dotlist, ("20241005", "3.1", "12000.0", "7", "True", "room#2")),
    ("OmegaConf, file", by_file, ("20241005", "3.1", "12000.0", "7", "True", "room#2")),
    ("OmegaConf, file, quoted", lambda word: by_file(f'"{word}"'), words),
    ("fire", by_fire, (20241005, 3.1, 12000.0, "007", "yes", "room")),
    ("jsonargparse, str", by_jsonargparse(str), words),
    ("jsonargparse, int | str", by_jsonargparse(int | str), (20241005, "3.10", "12e3", 7, "yes", "room#2")),
    ("jsonargparse, str | int", by_jsonargparse(str | int), words),
    ("tyro", by_tyro, words),
):
    found = tuple(way(word) for word in words)
    print(f"{name:24}", *map(repr, found))
    assert found == expected and list(map(type, found)) == list(map(type, expected)), name
PYTHON
echo "as described"
