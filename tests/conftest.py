"""What holds for all tests: nothing is kept in the user's cache folder, and what is compiled is kept for the next."""

import os
import sys

os.environ["ANYSTYLE_CACHE"] = "off"
# Where bytecode is forbidden, each worker and each process that a test starts would compile every module again: of the
# libraries too, since what an instrumented module imports is looked for under the instrumentation's own name.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
