"""Results cached between commands: whole or not at all, and within a limit."""

import os

import pytest
import torch

from anystyle_captures import cache
from anystyle_captures.cache import cached, key_of


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv(cache.VARIABLE, str(tmp_path))
    return tmp_path / "scenes"


def value():
    return {"means": torch.arange(6.0).view(2, 3), "steps": 7}


def never():
    raise AssertionError("it is computed anew")


def test_a_value_is_computed_once():
    assert cached("fit", "a", value)[1] is False
    again, before = cached("fit", "a", never)
    assert before and again["steps"] == 7 and torch.equal(again["means"], value()["means"])
    assert cached("fit", "b", value)[1] is False


def test_keys_tell_content_shape_and_options_apart():
    ones = torch.ones(2, 3)
    keys = {key_of(ones), key_of(ones * 2), key_of(ones.view(3, 2)), key_of(ones.double()), key_of(ones, "best")}
    assert len(keys) == 5
    assert key_of(ones, {"steps": 3}) == key_of(ones.clone(), {"steps": 3})


def flip(content):
    number = torch.arange(6.0)[5].numpy().tobytes()
    return content.replace(number, bytes([number[0] ^ 1]) + number[1:])


@pytest.mark.parametrize("damage", [flip, lambda content: content[:100]], ids=["a flipped bit", "cut off"])
def test_a_damaged_file_is_computed_again(folder, damage):
    cached("fit", "a", value)
    path = folder / "fit-a.pt"
    content = path.read_bytes()
    path.write_bytes(damage(content))
    assert path.read_bytes() != content
    again, before = cached("fit", "a", value)
    assert not before and torch.equal(again["means"], value()["means"]) and cached("fit", "a", never)[1]


def test_a_failure_leaves_nothing_behind(folder, monkeypatch):
    def broken(content, path):
        path.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(torch, "save", broken)
    assert cached("fit", "a", value)[0]["steps"] == 7
    assert list(folder.iterdir()) == []


def test_what_was_used_least_recently_goes_first(folder, monkeypatch):
    for number, name in enumerate("abc"):
        cached("fit", name, value)
        os.utime(folder / f"fit-{name}.pt", (number, number))
    cached("fit", "a", never)
    monkeypatch.setattr(cache, "LIMIT", 3 * (folder / "fit-a.pt").stat().st_size)
    cached("fit", "d", value)
    assert {path.name for path in folder.iterdir()} == {"fit-a.pt", "fit-c.pt", "fit-d.pt"}


def test_nothing_is_kept_where_that_is_asked_for(monkeypatch, folder):
    monkeypatch.setenv(cache.VARIABLE, "off")
    assert [cached("fit", "a", value)[1] for _ in range(2)] == [False, False]
    assert not folder.exists()
