import pytest

from anystyle.files import atomic_directory, atomic_path


def test_a_failed_write_leaves_the_old_file(tmp_path):
    target = tmp_path / "a.txt"
    target.write_text("old")
    with pytest.raises(RuntimeError), atomic_path(target) as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert target.read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]


def test_a_directory_appears_whole_and_replaces_what_it_names(tmp_path):
    target = tmp_path / "out"
    (target / "renders").mkdir(parents=True)
    (target / "renders" / "stale.png").touch()
    (target / "mine.txt").touch()
    with atomic_directory(target) as temporary:
        (temporary / "renders").mkdir()
        (temporary / "renders" / "new.png").touch()
        (temporary / "report.json").touch()
    assert sorted(str(path.relative_to(target)) for path in target.rglob("*")) == [
        "mine.txt",
        "renders",
        "renders/new.png",
        "report.json",
    ]


def test_a_failed_directory_leaves_nothing(tmp_path):
    with pytest.raises(RuntimeError), atomic_directory(tmp_path / "a" / "b") as temporary:
        (temporary / "x").touch()
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []


def test_a_file_is_no_directory(tmp_path):
    (tmp_path / "f").touch()
    with pytest.raises(ValueError, match="is a file"), atomic_directory(tmp_path / "f"):
        pass
