"""The bundled tiny weights: where they lie, and what they say of themselves."""

import pytest

from anystyle.checkpoint import read_header
from anystyle.perception import weights

NAMES = tuple(name for name in weights.files() if name.startswith("depth_anything_tiny"))
MEGABYTES = 8.0


def test_the_preset_lies_in_the_plugin_and_is_small() -> None:
    assert NAMES
    files = [weights.find(name) for name in NAMES]
    assert {file.parent.parent.name for file in files} == {"anystyle_depth_anything"}
    assert sum(file.stat().st_size for file in files) <= MEGABYTES * 1e6


@pytest.mark.parametrize("name", NAMES)
def test_a_file_says_how_it_was_made_and_its_card_says_the_same(name: str) -> None:
    file = weights.find(name)
    made = read_header(file).provenance
    assert "anystyle train" in made["command"] and made["commit"] and "seed" in made and "steps" in made
    assert file.name in (file.parent / "README.md").read_text(encoding="utf-8")
    assert weights.row(name).bundled
