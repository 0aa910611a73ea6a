#!/usr/bin/env bash
# Hydra 1.3.8 and OmegaConf: one value, in a file and on the command line, is of two types; `off` becomes true.
#
# Files are read as YAML 1.1, the command line by a grammar of its own. In a config without types:
#                            in the file, and by OmegaConf.from_dotlist     on Hydra's command line
#   x: off, no, on, yes      False, False, True, True                       words, all of them true in `if`
#   x: -.5                   the word "-.5"                                 -0.5
#   x: inf, nan              the words                                      the numbers
#   x: .inf, .nan            the numbers                                    the words
#   x: 010, 0x10, 0b11       8, 16, 3                                       the words
#   x: 1:30, 12:30:45        90, 45045                                      the words
# So `wandb=off` of a sweep leaves it on, `clip=.inf` is a word, and so is `gain: -.5` of the file. No warning. Where a
# structured config says `bool`, `off` is False in both. Write false and true, -0.5; inf on the command line and .inf in
# a file; times in quotes.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet hydra-core==1.3.8 omegaconf==2.3.1
mkdir conf
cat > app.py <<'PYTHON'
import json
from dataclasses import dataclass
from pathlib import Path

import hydra
from omegaconf import OmegaConf


@dataclass
class Typed:
    flag: bool = True


@hydra.main(version_base="1.3", config_path="conf", config_name="main")
def main(config):
    value = config.x
    typed = OmegaConf.merge(OmegaConf.structured(Typed), {"flag": value}).flag if value in ("off", False) else None
    Path("seen.json").write_text(json.dumps([repr(value), bool(value), typed]))


main()
PYTHON
env/bin/python - <<'PYTHON'
import json
import subprocess
from pathlib import Path

from omegaconf import OmegaConf

words = {"off": False, "no": False, "on": True, "yes": True, "-.5": "-.5", "inf": "inf", "nan": "nan"}
words |= {".inf": float("inf"), ".nan": float("nan"), "010": 8, "0x10": 16, "0b11": 3, "1:30": 90, "12:30:45": 45045}
numbers = {"-.5": -0.5, "inf": float("inf"), "nan": float("nan")}


def run(*arguments):
    command = ["env/bin/python", "-W", "error", "app.py", *arguments]
    options = ["hydra.run.dir=.", "hydra.output_subdir=null", "hydra/job_logging=disabled"]
    done = subprocess.run([*command, *options], capture_output=True, text=True, check=True)
    assert not done.stdout and not done.stderr, done
    return json.loads(Path("seen.json").read_text())


for word, meant in words.items():
    Path("conf/main.yaml").write_text(f"x: {word}\n")
    in_file = run()
    Path("conf/main.yaml").write_text("x: null\n")
    on_line = run(f"x={word}")
    print(f"{word:9} in the file {in_file[0]:6} command line {on_line[0]:11} true in `if`: {in_file[1]}, {on_line[1]}")
    assert in_file[0] == repr(meant) == repr(OmegaConf.from_dotlist([f"x={word}"]).x)
    assert on_line[0] == repr(numbers.get(word, word)) and on_line[1]
    assert word != "off" or (in_file[2], on_line[2]) == (False, False)
PYTHON
echo "as described"
