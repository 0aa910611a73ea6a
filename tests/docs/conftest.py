"""The documented commands of ``anystyle study`` are run with the helpers of its own tests."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "plugins" / "study" / "tests"))
