import subprocess
import sys

import psutil

from anystyle_benchmark.process import kill

PARENT = "import subprocess, sys; print(subprocess.Popen([sys.executable, '-c', 'input()']).pid); input()"


def test_what_a_process_started_ends_with_it():
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-uc", PARENT], stdin=pipe, stdout=pipe) as process:
        child = psutil.Process(int(process.stdout.readline()))
        kill(process)
        assert process.wait(10) != 0
        psutil.wait_procs([child], 10)
        assert not child.is_running() or child.status() == psutil.STATUS_ZOMBIE
        kill(process)  # it has ended already
