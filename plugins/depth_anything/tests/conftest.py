"""Makes the package importable through the catalog, as a user's session does, and the helpers beside the tests."""

import sys
from pathlib import Path

from anystyle.registry.catalog import catalog

sys.path.insert(0, str(Path(__file__).parent))
catalog().find("backbone", "depth_anything").load()
