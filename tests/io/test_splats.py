"""Files of Gaussians as people have them: a few rows that are no numbers, other colours, coordinates on the globe."""

import logging
import warnings
from dataclasses import fields

import numpy as np
import pytest
import torch
from plyfile import PlyData

from anystyle.contracts import Format
from anystyle.errors import UserError
from anystyle.formats import comments
from anystyle.io import ply
from anystyle.pipeline.export import export_styles
from anystyle.pipeline.options import SplatOptions
from anystyle.pipeline.saved import read_saved
from anystyle.registry.build import build
from anystyle.types import Gaussians
from tests.support.ply_files import BASE, OPACITY, POSITION, ROTATION, SCALE, columns, write_ply

INF, NAN = np.inf, np.nan


@pytest.fixture(autouse=True)
def _only_lines(caplog):
    """What is told is a line of the log, never a warning of NumPy."""
    caplog.set_level(logging.WARNING)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def same(found, expected):
    for item in fields(Gaussians):
        assert torch.equal(getattr(found, item.name), getattr(expected, item.name)), item.name


def test_rows_that_show_nothing_are_left_out_and_the_others_keep_their_bits(tmp_path, caplog):
    values = columns()
    clean = Gaussians.load(write_ply(tmp_path / "clean.ply", values))
    assert not caplog.messages
    broken = {name: column.copy() for name, column in values.items()}
    broken["opacity"][0], broken["opacity"][1], broken["x"][2], broken["scale_2"][3] = INF, -INF, NAN, -INF
    broken["y"][4], broken["f_dc_1"][5], broken["rot_3"][6], broken["scale_0"][7] = INF, NAN, -INF, INF
    broken["opacity"][8], broken["scale_1"][9] = NAN, NAN
    found = Gaussians.load(write_ply(tmp_path / "scene.ply", broken))
    kept = [0, 3, *range(10, 300)]
    expected = clean.map(lambda tensor: tensor[:, kept].clone())
    expected.opacities[0, 0], expected.scales[0, 1, 2] = 1.0, 0.0
    same(found, expected)
    (line,) = caplog.messages
    left_out, kept = line.removeprefix(f"{tmp_path / 'scene.ply'}: 8 of 300 Gaussians are left out ").split("; ")
    assert left_out == (
        "(2 without a position, 1 with opacity -inf, 1 without an opacity, 2 with an infinite, negative or missing "
        "scale, 1 without a rotation, 1 without a colour)"
    )
    assert kept == "kept are 1 with opacity +inf, as opaque, 1 with scale -inf, as flat"


def test_a_file_of_nothing_else_is_refused(tmp_path):
    with pytest.raises(UserError, match=r"no Gaussians that can be shown \(300 with opacity -inf\)"):
        Gaussians.load(write_ply(tmp_path / "scene.ply", columns() | {"opacity": np.full(300, -INF)}))


@pytest.mark.parametrize("order", ["<", ">", ""])
@pytest.mark.parametrize("header", ["comment scène de Noël\n".encode(), "comment scène de Noël\n".encode("latin-1")])
def test_comments_are_in_any_encoding(header, order, tmp_path):
    expected = Gaussians.load(write_ply(tmp_path / "clean.ply", columns(), order=order))
    path = write_ply(tmp_path / "scene.ply", columns(), header=header, order=order)
    same(Gaussians.load(path), expected)
    assert build(Format, "ply").read(path).notes == ("scène de Noël",)
    assert ply.recolor(path, expected.harmonics[0], tmp_path / "again.ply")


@pytest.mark.parametrize(("kind", "top"), [("u1", 255), ("f4", 255), ("f4", 1)])
def test_red_green_blue_stand_for_the_constant_of_harmonics(kind, top, tmp_path, caplog):
    drawn = np.random.default_rng(1).integers(0, 256, (3, 300))
    colors = {name: row / (255 / top) for name, row in zip(("red", "green", "blue"), drawn, strict=True)}
    without = columns(names=(*POSITION, *OPACITY, *SCALE, *ROTATION))
    path = write_ply(tmp_path / "rgb.ply", without | colors, kinds=dict.fromkeys(colors, kind))
    expected = (drawn.T / 255 - 0.5) / 0.28209479177387814
    found = Gaussians.load(path)
    np.testing.assert_allclose(found.harmonics[0, :, 0].numpy(), expected, atol=2e-6)
    assert any(f"from 0 to {top}" in message for message in caplog.messages) == (kind == "f4")
    both = write_ply(tmp_path / "both.ply", columns() | colors, kinds=dict.fromkeys(colors, kind))
    same(Gaussians.load(both), Gaussians.load(write_ply(tmp_path / "plain.ply", columns())))
    for file in (path, both):  # colours that a file had before it was styled are not left in it
        assert ply.recolor(file, found.harmonics[0].flip(0), tmp_path / "again.ply")
        assert set(BASE) == {item.name for item in PlyData.read(tmp_path / "again.ply")["vertex"].properties}
        assert torch.equal(Gaussians.load(tmp_path / "again.ply").harmonics, found.harmonics.flip(1))


def globe(path, order="<", **header):
    """Points a centimetre apart in a row, at coordinates of UTM."""
    values = columns() | {"x": 4.5e6 + 0.01 * np.arange(300), "y": 5.4e5 + np.zeros(300)}
    return values, write_ply(path, values, kinds=dict.fromkeys(values, "f8"), order=order, **header)


def positions(path):
    """In double, with the offset that the header names."""
    data = PlyData.read(path)
    offsets = dict(line.split() for line in data.comments if line.startswith("offset"))
    return np.stack([data["vertex"][axis].astype(np.float64) + float(offsets[f"offset{axis}"]) for axis in "xyz"], 1)


@pytest.mark.parametrize("order", ["<", ">", ""])
def test_points_on_the_globe_stay_apart_and_get_their_offset_back(order, tmp_path, caplog):
    values, path = globe(tmp_path / "globe.ply", order)
    truth = np.stack([values[axis] for axis in "xyz"], 1)
    scene = read_saved(path)
    assert scene.offset == (4500001.0, 540000.0, 0.0)
    assert [message for message in caplog.messages if "4500001 540000 0 is taken off" in message]
    np.testing.assert_allclose(scene.styles[0][1].means[0].double().numpy() + scene.offset, truth, rtol=0, atol=1e-6)
    for name in ("ply", "spz"):
        caplog.clear()
        export_styles(scene, tmp_path / f"out.{name}", name)
        assert len(caplog.messages) == (name == "spz")
        again = read_saved(tmp_path / f"out.{name}")
        assert again.offset == (scene.offset if name != "spz" else (0, 0, 0))
        if name != "spz":
            np.testing.assert_allclose(again.styles[0][1].means, scene.styles[0][1].means, rtol=0, atol=1e-6)
    np.testing.assert_allclose(positions(tmp_path / "out.ply"), truth, rtol=0, atol=1e-6)
    assert ply.recolor(path, scene.styles[0][1].harmonics[0], tmp_path / "out.ply", comments(scene))
    np.testing.assert_allclose(positions(tmp_path / "out.ply"), truth, rtol=0, atol=1e-9)


def test_an_offset_turns_with_the_axes_and_adds_to_that_of_the_header(tmp_path):
    header = b"comment Vertical axis: 0 0 1\ncomment offsetx 100\ncomment offsety 0\ncomment offsetz 7.5\n"
    scene = read_saved(globe(tmp_path / "globe.ply", header=header)[1])
    assert scene.offset == (4500101.0, -7.5, 540000.0)
    export_styles(scene, tmp_path / "up.ply", "ply", up="z")
    assert build(Format, "ply").read(tmp_path / "up.ply").offset == (4500101.0, 540000.0, 7.5)


def test_doubles_near_the_origin_keep_theirs(tmp_path):
    values = columns()
    scene = read_saved(write_ply(tmp_path / "scene.ply", values, kinds=dict.fromkeys(values, "f8")))
    assert scene.offset == (0, 0, 0)
    same(scene.styles[0][1], Gaussians.load(write_ply(tmp_path / "single.ply", values)))


def activated(path):
    draw, values = np.random.default_rng(2), columns()
    values |= {name: draw.random(300) * 0.02 for name in SCALE} | {"opacity": draw.random(300)}
    for name in SCALE:
        values[name][0] = 300
    return values, write_ply(path, values)


def test_activated_values_are_told_and_read_when_that_is_said(tmp_path, caplog):
    values, path = activated(tmp_path / "scene.ply")
    read_saved(path)
    rows, guess = caplog.messages
    assert "1 of 300 Gaussians are left out (1 with an infinite" in rows  # the exponential of 300
    assert "scales look like lengths and opacities like fractions" in guess and "splat.activated=true" in guess
    caplog.clear()
    found = read_saved(path, SplatOptions(activated=True)).styles[0][1]
    assert not caplog.messages
    np.testing.assert_array_equal(found.scales[0, :, 1], values["scale_1"].astype(np.float32))
    np.testing.assert_array_equal(found.opacities[0], values["opacity"].astype(np.float32))
    with pytest.raises(UserError, match="leave that out"):
        read_saved(write_ply(tmp_path / "logarithms.ply", columns()), SplatOptions(activated=True))


@pytest.mark.parametrize("name", ["ply", "splat", "ksplat", "spz", "sog", "html"])
def test_writers_take_extremes_without_a_word(name, tmp_path):
    """Opaque, flat and vast Gaussians, and a scene that is a point."""
    values = {key: column[:5].copy() for key, column in columns().items()}
    values["opacity"][0], values["scale_2"][1] = INF, -INF
    for axis in SCALE:
        values[axis][2] = 44
    for axis in POSITION:
        values[axis][:] = 1
    export_styles(read_saved(write_ply(tmp_path / "scene.ply", values)), tmp_path / f"out.{name}", name)
    if name != "html":
        found = read_saved(tmp_path / f"out.{name}").styles[0][1]
        assert found.means.shape == (1, 5, 3) and all(bool(tensor.isfinite().all()) for tensor in vars(found).values())
