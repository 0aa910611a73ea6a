"""What a configuration may build: judged wherever Hydra composes, in the process of a launcher's job as well."""

import subprocess
import sys

import cloudpickle
import pytest
from hydra import compose, initialize_config_dir
from hydra._internal.sources_registry import SourcesRegistry
from hydra.core.singleton import Singleton

from anystyle.errors import UserError
from anystyle.registry.guard import FileConfigSource
from anystyle.registry.source import register

CALLBACK = "+hydra.callbacks.evil={_target_: os.system, command: touch ran}"
JOB = """
import pickle, sys
from hydra.core.singleton import Singleton
with open(sys.argv[1], "rb") as file:
    Singleton.set_state(pickle.load(file))
from hydra import compose, initialize_config_dir
from hydra._internal.sources_registry import SourcesRegistry
from anystyle.errors import UserError
print(SourcesRegistry.instance().resolve("file").__module__)
with initialize_config_dir(sys.argv[2], version_base="1.3"):
    try:
        compose("config", [sys.argv[3]])
    except UserError as error:
        print(error)
"""
"""What a launcher of Hydra does in the process of a job, before the job."""


def test_installing_again_changes_nothing(tmp_path):
    (tmp_path / "config.yaml").write_text("seed: 0\n")
    register()
    register()
    assert SourcesRegistry.instance().resolve("file") is FileConfigSource
    with initialize_config_dir(str(tmp_path), version_base="1.3"):
        assert compose("config", ["seed=1"]).seed == 1
        with pytest.raises(UserError, match=r"hydra\.callbacks\.evil\._target_ is 'os\.system'") as caught:
            compose("config", [CALLBACK])
    frames = [entry.name for entry in caught.traceback]
    assert frames.count("_load_judged") == 1


def test_the_process_of_a_job_judges_as_well(tmp_path):
    (tmp_path / "config.yaml").write_text("seed: 0\n")
    register()
    (tmp_path / "state").write_bytes(cloudpickle.dumps(Singleton.get_state()))
    done = subprocess.run(
        [sys.executable, "-c", JOB, str(tmp_path / "state"), str(tmp_path), CALLBACK],
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    module, refusal = done.stdout.splitlines()
    assert module == "anystyle.registry.guard"
    assert refusal.startswith("hydra.callbacks.evil._target_ is 'os.system'")
