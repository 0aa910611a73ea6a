"""What holds for all tests: nothing is kept in the user's cache folder, and what is compiled is kept for the next."""

import gc
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from tests.support.pictures import save_photographs

pytest_plugins = ("tests.support.browser",)

os.environ["ANYSTYLE_CACHE"] = "off"
# Parallel kernels of numba, which a reader of splats has that tests compare with, set the threads of OpenMP, which are
# PyTorch's too: every later test of the worker would compute on all cores, and wait for them.
os.environ["NUMBA_NUM_THREADS"] = "1"
os.environ["WARP_CACHE_PATH"] = str(Path(__file__).parent / "plugins" / "warp_renderer" / "__pycache__")
# Where bytecode is forbidden, each worker and each process that a test starts would compile every module again: of the
# libraries too, since what an instrumented module imports is looked for under the instrumentation's own name.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
gc.disable()
# A suite in the background ignores SIGINT, and under nohup SIGHUP, and so would the programs that its tests signal.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
# How long a draw or an example takes depends on what else the machine does.
settings.register_profile("anystyle", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("anystyle")


def pytest_collection_finish() -> None:
    """A million objects of modules and tests are there until the end: no collection of garbage looks at them again."""
    gc.freeze()
    gc.enable()


@pytest.fixture(scope="session", autouse=True)
def _threads_stay() -> Iterator[None]:
    """No library that a test calls may leave PyTorch with other threads for the tests after it."""
    import torch  # here: what hands tests out needs none

    before = torch.get_num_threads()
    yield
    assert torch.get_num_threads() == before


@pytest.fixture(scope="session")
def photographs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of three photographs of noise."""
    return save_photographs(
        tmp_path_factory.mktemp("photographs"), [f"IMG {number}.png" for number in range(3)], 60, 80
    )
