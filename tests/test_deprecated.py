import importlib

import pytest

from anystyle import contracts
from anystyle.contracts import protocol, training


@pytest.mark.parametrize(
    ("module", "name", "now"),
    [
        ("data.camera_reader", "StoredCamera", contracts.StoredCamera),
        ("evaluation.base", "required", protocol.required),
        ("methods.base", "Method", contracts.Method),
        ("pipeline.poses", "Verdict", contracts.Verdict),
        ("published", "Published", contracts.Published),
        ("registry.socket", "Command", contracts.Command),
        ("registry.socket", "Socket", contracts.Pluggable),
        ("training.base", "required", training.required),
    ],
)
def test_contracts_are_found_where_they_were(module, name, now):
    old = importlib.import_module(f"anystyle.{module}")
    with pytest.warns(DeprecationWarning, match=rf"anystyle.{module}.{name} is anystyle.contracts.*\..* now"):
        assert getattr(old, name) is now
    with pytest.raises(AttributeError, match="nothing"):
        _ = old.nothing
