"""ComfyUI's interface, which the nodes import."""

import importlib.util
import sys

import pytest

from tests.support import comfy_interface


@pytest.fixture
def comfy(monkeypatch, tmp_path):
    """ComfyUI's published interface, and the nodes loaded from their folder as ComfyUI loads them."""
    root = comfy_interface.ROOT
    interface = comfy_interface.install(monkeypatch, tmp_path)
    name = "custom_nodes_anystyle"
    spec = importlib.util.spec_from_file_location(name, root / "__init__.py", submodule_search_locations=[str(root)])
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, name, module)
    spec.loader.exec_module(module)
    interface.load(module)
    yield interface
    for loaded in [key for key in sys.modules if key.startswith(name)]:
        del sys.modules[loaded]
