import platform
import subprocess
import sys

import pytest

HELD = """
from pathlib import Path
import torch
from anystyle.heap import keep_freed

def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 >> 20

keep_freed({up_to} << 20)
before = resident()
large = torch.ones(5 << 20)
del large
print(resident() - before)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="the rules are those of glibc")
@pytest.mark.parametrize(("up_to", "kept"), [(31, True), (8, False)])
def test_freed_blocks_up_to_a_size_are_kept(up_to, kept):
    done = subprocess.run([sys.executable, "-c", HELD.format(up_to=up_to)], capture_output=True, text=True, check=True)
    assert (int(done.stdout) > 15) is kept
