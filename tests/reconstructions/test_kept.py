"""What is kept between commands: found again, whole or not at all, and within a limit."""

import os

import pytest
import torch

from anystyle.reconstructions import kept as keeping
from anystyle.reconstructions.colors import colors_alone
from anystyle.reconstructions.fit import Fit
from anystyle.reconstructions.kept import kept, key_of
from anystyle.reconstructions.options import FitOptions
from anystyle.reconstructions.photographs import fit_photographs
from anystyle.renderers.cpu.renderer import CpuRenderer
from anystyle.types import Views
from reconstructions.scenes import photographed_wall


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv(keeping.VARIABLE, str(tmp_path))
    return tmp_path / "scenes"


def value():
    return {"means": torch.arange(6.0).view(2, 3), "steps": 7}


def never():
    raise AssertionError("it is computed anew")


def test_a_value_is_computed_once():
    assert kept("fit", "a", value)[1] is False
    again, before = kept("fit", "a", never)
    assert before and again["steps"] == 7 and torch.equal(again["means"], value()["means"])
    assert kept("fit", "b", value)[1] is False


def test_keys_tell_content_shape_and_options_apart():
    ones = torch.ones(2, 3)
    keys = {key_of(ones), key_of(ones * 2), key_of(ones.view(3, 2)), key_of(ones.double()), key_of(ones, "best")}
    assert len(keys) == 5
    assert key_of(ones, {"steps": 3}) == key_of(ones.clone(), {"steps": 3})


def test_a_flipped_bit_is_noticed(folder):
    kept("fit", "a", value)
    path = folder / "fit-a.pt"
    content = path.read_bytes()
    number = torch.arange(6.0)[5].numpy().tobytes()
    path.write_bytes(content.replace(number, bytes([number[0] ^ 1]) + number[1:]))
    assert path.read_bytes() != content
    again, before = kept("fit", "a", value)
    assert not before and torch.equal(again["means"], value()["means"])


def test_what_is_damaged_is_computed_anew(folder):
    kept("fit", "a", value)
    path = folder / "fit-a.pt"
    path.write_bytes(path.read_bytes()[:100])
    again, before = kept("fit", "a", value)
    assert not before and again["steps"] == 7
    assert kept("fit", "a", never)[1]


def test_a_failure_leaves_nothing_behind(folder, monkeypatch):
    def broken(content, path):
        path.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(torch, "save", broken)
    assert kept("fit", "a", value)[0]["steps"] == 7
    assert list(folder.iterdir()) == []


def test_what_was_used_least_recently_goes_first(folder, monkeypatch):
    for number, name in enumerate("abc"):
        kept("fit", name, value)
        os.utime(folder / f"fit-{name}.pt", (number, number))
    kept("fit", "a", never)
    monkeypatch.setattr(keeping, "LIMIT", 3 * (folder / "fit-a.pt").stat().st_size)
    kept("fit", "d", value)
    assert {path.name for path in folder.iterdir()} == {"fit-a.pt", "fit-c.pt", "fit-d.pt"}


def test_nothing_is_kept_where_that_is_asked_for(monkeypatch, folder):
    monkeypatch.setenv(keeping.VARIABLE, "off")
    assert [kept("fit", "a", value)[1] for _ in range(2)] == [False, False]
    assert not folder.exists()


def test_a_scene_is_fitted_once_and_again_for_other_options():
    """The second fit of the same photographs is the first one's, to the bit; of other options it is another."""
    images, cameras, _ = photographed_wall(num_views=5)
    views = Views(images[None], cameras=cameras)

    def fit(**options):
        reconstruction = Fit(quality="draft", num_gaussians=300, num_steps=4, holdout=0, **options)
        return reconstruction(views, lambda views: colors_alone(views, cameras), CpuRenderer())

    first, again, other, alone = fit(), fit(), fit(seed=1), fit(keep=False)
    assert "kept" not in first.measures and again.measures["kept"] == 1
    assert "kept" not in other.measures and "kept" not in alone.measures
    fits = [result.scene.gaussians for result in (first, again, alone, other)]
    assert all(gaussians is not None for gaussians in fits)
    for name in ("means", "scales", "opacities", "harmonics"):
        values = [getattr(gaussians, name) for gaussians in fits]
        assert torch.equal(values[0], values[1]) and torch.equal(values[0], values[2]), name
        assert values[0].shape != values[3].shape or not torch.equal(values[0], values[3]), name


def test_a_scene_is_found_again_in_another_order_of_photographs():
    """With the views that its pixels come from and their exposures."""
    images, cameras, _ = photographed_wall(num_views=5)
    order = [3, 0, 4, 1, 2]

    def fit(images, cameras):
        options = FitOptions(num_steps=4, final_steps=0)
        return fit_photographs(images, cameras, CpuRenderer(), num_gaussians=300, options=options, keep=True)

    first, again = fit(images, cameras), fit(images[order], cameras.select(order))
    assert not first.kept and again.kept and torch.equal(first.gains[order], again.gains)
    assert torch.equal(torch.tensor(order)[again.pixels[:, 0]], first.pixels[:, 0])
