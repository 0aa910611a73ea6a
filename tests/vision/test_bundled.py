"""The bundled texture network."""

from anystyle.io.checkpoint import read_header
from anystyle.vision import weights


def test_the_file_says_how_it_was_made() -> None:
    header = read_header(weights.find("texture"))
    assert header.part == "texture"
    assert header.provenance["command"].startswith("anystyle train experiment=tiny_perceptual")
    assert header.provenance["steps"] > 0
    assert header.provenance["commit"]
