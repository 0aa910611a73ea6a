"""What of the comparison with the published code needs none of it."""

import sys
from importlib.util import module_from_spec

import numpy as np
import pytest
import torch

from anystyle.errors import UserError
from anystyle.testing.oracle import fill_named, hashed
from tests.benchmarks import published, published_stand_ins
from tests.benchmarks.published_networks import NETWORKS


@pytest.mark.parametrize("variant", NETWORKS)
def test_a_folder_that_is_no_checkout(variant, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "argv", [published.__file__, variant, str(tmp_path)])
    network = NETWORKS[variant]
    with pytest.raises(UserError, match=f"{tmp_path} is no checkout of {network.repository}: it has no {network.file}"):
        published.main()


def test_weights_are_those_of_the_goldens():
    name, other = "camera_head.pose_branch.fc2.weight", "camera_head.norm.weight"
    state = {f"model.encoder.{name}": torch.empty(9, 8), f"model.encoder.{other}": torch.empty(8)}
    published.fill(state, NETWORKS["head"])
    plain = fill_named({name: torch.empty(9, 8), other: torch.empty(8)})
    torch.testing.assert_close(state[f"model.encoder.{name}"], 0.1 * plain[name])  # by a rule of the goldens
    assert torch.equal(state[f"model.encoder.{other}"], plain[other])


def test_differences_are_of_gaussians_at_the_same_place():
    mine = {"means": np.float32([[0, 0, 0], [1, 0, 0], [2, 0, 0]]), "scales": np.float32([[1], [2], [3]])}
    theirs = {"means": np.float32([[1, 0, 0], [0, 0, 5]]), "scales": np.float32([[2.5], [7]])}
    found = published.differences(mine, theirs)
    assert found["Gaussians"] == [3, 2] and found["same centres"] == 0.5
    assert found["means"] == [0, 0] and found["scales"] == [0.5, pytest.approx(0.2)]


def test_what_is_imported_is_made_up_and_what_is_used_is_not(monkeypatch):
    monkeypatch.setattr(sys, "meta_path", [*sys.meta_path])
    published_stand_ins.install()
    finder = sys.meta_path[0]
    specs = {name: finder.find_spec(name, None) for name in ("e3nn.o3", "src.dataset", "src.datasets", "einops")}
    assert [name for name, spec in specs.items() if spec] == ["e3nn.o3", "src.dataset"]
    assert module_from_spec(specs["e3nn.o3"]).wigner_D is published_stand_ins.StandIn


def test_sums_and_maxima_of_rows():
    index, rows = torch.tensor([2, 0, 2, 1]), torch.arange(8.0).view(4, 2)
    assert published_stand_ins.scatter_add(rows, index).tolist() == [[2, 3], [6, 7], [4, 6]]
    assert published_stand_ins.scatter_max(rows[:, 0] - 9, index)[0].tolist() == [-7, -3, -5]


def test_attention_is_that_of_the_definition():
    query, key, value = (hashed(index, (1, 5, 2, 4), -1, 1) for index in range(3))
    weight = torch.einsum("bnhc,bmhc->bhnm", query, key).mul(0.25).softmax(-1)
    attended = published_stand_ins.attention(query, key, value, scale=0.25)
    torch.testing.assert_close(attended, torch.einsum("bhnm,bmhc->bnhc", weight, value))
