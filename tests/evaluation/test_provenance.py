"""What scores rest on, for their record."""

import shutil

from anystyle.evaluation import provenance
from anystyle.io.run_folder import RECORD
from tests.support.evaluation_cases import folders


def test_inputs_are_hashes_of_the_files_that_options_name(tmp_path, monkeypatch):
    content, *_ = folders(tmp_path / "in")
    config = {"protocol": {"content": str(content), "missing": "refuse", "depth": None}, "out": str(tmp_path)}
    found = provenance.foundations(config)["inputs"]
    first = found["protocol.content"]
    assert list(found) == ["protocol.content"]
    shutil.copytree(content, tmp_path / "copy")
    assert provenance.digest(tmp_path / "copy") == first and len(first) == 64
    monkeypatch.setattr(provenance, "MOST_BYTES", 10)
    assert provenance.digest(content).startswith("sizes ")


def test_results_inside_of_an_input_are_no_part_of_it(tmp_path):
    content, *_ = folders(tmp_path)
    before = provenance.digest(content)
    (content / "evaluation").mkdir()
    (content / "evaluation" / RECORD).write_text("{}")
    assert provenance.digest(content) == before
    (content / "one/more.png").write_bytes(b"")
    assert provenance.digest(content) != before
