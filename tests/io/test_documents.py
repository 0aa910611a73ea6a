"""Whatever a document holds, its reader gets the declared shape or one line that names the file."""

import json
import math
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from anystyle.errors import UserError
from anystyle.io.arrays import read_array, read_arrays, read_tensors
from anystyle.io.documents import as_number, plain, read_json, read_text, read_toml, read_yaml, regular, stored_number


@dataclass(frozen=True)
class Shape:
    name: str
    numbers: list[float]
    inner: dict[str, int]


VALID = {"name": "a", "numbers": [1, 2.5], "inner": {"b": 3}}
ANY = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=12,
)


def refused(read, path: Path, *arguments: object) -> str:
    """The one line that a reader ends with."""
    with pytest.raises(ValueError, match=r"\S") as caught:
        read(path, *arguments)
    message = str(caught.value)
    assert "\n" not in message and path.name in message and len(message) < 1000
    return message


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(ANY, st.sampled_from(["name", "numbers", "inner", "other", ""]))
def test_a_document_of_any_content_fits_or_is_refused(tmp_path, value, key):
    path = tmp_path / "a.json"
    path.write_bytes(json.dumps({**VALID, key: value} if key else value).encode("utf-8", "surrogatepass"))
    try:
        read = read_json(path, Shape)
    except UserError as error:
        assert "a.json" in str(error) and "\n" not in str(error)
    else:
        assert isinstance(read, Shape) and all(math.isfinite(number) for number in read.numbers)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.binary(max_size=200), st.sampled_from([read_json, read_toml, read_yaml]))
def test_bytes_of_any_kind_are_read_or_refused(tmp_path, data, read):
    path = tmp_path / "a.txt"
    path.write_bytes(data)
    try:
        read(path, Shape)
    except UserError as error:
        assert "a.txt" in str(error) and "\n" not in str(error)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("null", "object"), ("[]", "object"), ("{", "truncated"), ("1e999", "range"), ("[" * 10_000, "deep"),
        ('{"name": 3, "numbers": [], "inner": {}}', "'name'"),
        ('{"name": "a", "numbers": [null], "inner": {}}', "numbers"),
        ('{"name": "a", "numbers": [], "inner": {"b": ' + "9" * 400 + "}}", "64 bits"), ('{"name": "a"}', "numbers"),
        ('{"name": "a", "numbers": [NaN], "inner": {}}', "malformed"),
    ],
)  # fmt: skip
def test_a_refusal_names_file_key_and_expectation(tmp_path, text, words):
    (tmp_path / "a.json").write_text(text)
    assert words in refused(read_json, tmp_path / "a.json", Shape)


def test_yaml_bombs_tags_and_infinities(tmp_path):
    path = tmp_path / "a.yaml"
    pairs = zip("abcdefghijklmnopqrstuvw", "bcdefghijklmnopqrstuvwx", strict=True)
    path.write_text("a: &a [x, x]\n" + "".join(f"{after}: &{after} [*{name}, *{name}]\n" for name, after in pairs))
    assert "more than" in refused(read_yaml, path)
    path.write_text("a: &a [*a]\n")
    assert "deep" in refused(read_yaml, path)
    path.write_text("a: !!python/object/apply:os.system [x]\n")
    refused(read_yaml, path)
    path.write_text("a: .nan\n")
    assert "finite" in refused(read_yaml, path)
    path.write_text("a: ${oc.env:HOME}\n")
    assert read_yaml(path) == {"a": "${oc.env:HOME}"}


def test_what_is_no_regular_file_is_never_opened(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "zero").symlink_to("/dev/zero")
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "folder").mkdir()
    for name in ("pipe", "zero", "loop", "folder", "gone"):
        for read in (read_text, read_array, read_tensors, lambda path: read_json(path, Shape)):
            refused(read, tmp_path / name)
    (tmp_path / "large").write_bytes(b"x" * 11)
    with pytest.raises(UserError, match="at most 10"):
        regular(tmp_path / "large", most=10)


def test_arrays(tmp_path):
    path = tmp_path / "a.npy"
    np.save(path, np.arange(6, dtype=np.int16).reshape(2, 3))
    assert read_array(path).tolist() == [[0, 1, 2], [3, 4, 5]]
    path.write_bytes(b"\x93NUMPY\x01\x00v\x00" + b"{'descr': '<f8', 'fortran_order': False, 'shape': (9999999999, 17)}")
    refused(read_array, path)
    for values in (np.array([None]), np.array(["a"]), np.array([np.nan]), np.array([1j])):
        np.save(path, values, allow_pickle=True)
        refused(read_array, path)
    np.savez(tmp_path / "a.npz", x=np.ones(2), names=np.array(["a", "b"]))
    assert read_arrays(tmp_path / "a.npz", ["x"], ["names"], what="pair")["names"].tolist() == ["a", "b"]
    with pytest.raises(UserError, match=r"a\.npz is not a valid pair \(y is not"):
        read_arrays(tmp_path / "a.npz", ["y"], what="pair")


def test_a_flipped_byte_of_a_tensor_is_noticed(tmp_path):
    path = tmp_path / "a.pt"
    torch.save({"a": torch.zeros(4096)}, path)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    refused(read_tensors, path)


@given(st.floats())
def test_every_number_survives_json(value):
    again = as_number(json.loads(json.dumps(plain({"a": [value]}), allow_nan=False))["a"][0])
    assert again == value or (math.isnan(again) and math.isnan(value))
    assert stored_number(1.5) == 1.5
