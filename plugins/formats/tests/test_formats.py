"""Every format is read by others' readers, and rendered from the same camera: the same picture, the right way round."""

import json
import zipfile
from dataclasses import replace
from math import exp, log

import numpy as np
import pytest
import torch

from anystyle.cli.arguments import split
from anystyle.contracts import Format
from anystyle.errors import UserError
from anystyle.io.atomic import atomic_directory
from anystyle.io.ply import from_smallest_three
from anystyle.pipeline.export import export_styles
from anystyle.pipeline.saved import read_saved
from anystyle.registry.build import build
from anystyle.types import Gaussians, StyledScene
from anystyle.types.scene import AXES
from anystyle.vision.weights import licenses, meaning
from anystyle_formats import command_export as command
from anystyle_formats.html import _packed
from anystyle_formats.packing import codebook, smallest_three
from anystyle_formats.sog import palette
from tests.support.export_readers import READERS, SPLAT_TRANSFORM, from_axes, read_with_splat_transform
from tests.support.export_scene import LEAST, export, picture, psnr, scene


@pytest.mark.parametrize("name", READERS)
def test_a_file_shows_the_same_picture_to_other_readers(name, tmp_path):
    gaussians = scene({"splat": 1, "ksplat": 4}.get(name, 16))
    export(gaussians, tmp_path / f"scene.{name}", name)
    read = from_axes(build(Format, name).up, READERS[name](tmp_path / f"scene.{name}"))
    assert read.means.shape == gaussians.means.shape and psnr(picture(read), picture(gaussians)) > LEAST[name]


@pytest.mark.parametrize("name", ["spz", "sog", "splat", "ply", "ksplat"])
def test_splat_transform_sees_the_same_picture(name, tmp_path):
    """Its PLY of a file is neither mirrored nor upside down."""
    if SPLAT_TRANSFORM is None:
        pytest.skip("splat-transform is not installed (npm install -g @playcanvas/splat-transform)")
    gaussians = scene({"splat": 1, "ksplat": 9}.get(name, 16))
    export(gaussians, tmp_path / f"scene.{name}", name)
    read = read_with_splat_transform(tmp_path / f"scene.{name}", tmp_path)
    assert psnr(picture(read), picture(gaussians)) > LEAST[name] - 2


def test_styles_with_a_shape_of_their_own_are_left_out_of_a_page_with_a_line(tmp_path, caplog):
    plain = scene()
    moved, fewer = replace(plain, scales=2 * plain.scales), plain.map(lambda tensor: tensor[:, :30])
    styles = StyledScene((("grown", moved), ("few", fewer), ("plain", plain)))
    export_styles(styles, tmp_path / "all.html", "html")
    assert "share means, " in caplog.text and "left out are those with others: few, grown" in caplog.text
    export_styles(StyledScene((("plain", plain),)), tmp_path / "alone.html", "html")
    assert (tmp_path / "all.html").read_text() == (tmp_path / "alone.html").read_text()


@pytest.mark.parametrize("up", AXES)
def test_an_asymmetric_scene_stands_upright_and_unmirrored_in_any_axes(up, tmp_path):
    """The red cloud is right of and above the green one, along the axes that a file says."""
    export(scene(), tmp_path / "scene.ply", "ply", up=up)
    read = Gaussians.load(tmp_path / "scene.ply")
    red = read.harmonics[0, :, 0, 0] > read.harmonics[0, :, 0, 1]
    x, y, z = read.means[0].T
    right, top, away = {
        "opencv": (x, -y, z), "y": (x, y, -z), "z": (x, z, y), "-z": (x, -z, -y), "x": (y, x, z), "-x": (-y, -x, z)
    }[up]  # fmt: skip
    for along, sign in ((right, 1), (top, 1), (away, -1)):
        assert sign * float(along[red].mean() - along[~red].mean()) > 0.3
    assert psnr(picture(from_axes(up, read)), picture(scene())) > 80


@pytest.mark.parametrize("up", ["y", "z", "-z", "x"])
def test_a_file_of_others_stands_upright_once_its_axes_are_said(up, tmp_path, capsys):
    """Degree 1: the directions of colours turn with the scene."""
    export(scene(4), tmp_path / "theirs.ply", "ply", up=up)
    words = [str(tmp_path / "theirs.ply"), "--out", str(tmp_path / "ours.spz"), "--from-up", up]
    command.export(*split(command.parser(), words))
    read = from_axes("y", READERS["spz"](tmp_path / "ours.spz"))
    assert psnr(picture(read), picture(scene(4))) > LEAST["spz"]
    assert psnr(picture(Gaussians.load(tmp_path / "theirs.ply")), picture(scene(4))) < 30
    (tmp_path / "report.json").write_text("{}")
    with pytest.raises(UserError, match="a folder of results is in OpenCV's axes"):
        command.export(*split(command.parser(), [str(tmp_path), *words[1:]]))


@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
@pytest.mark.parametrize("name", ["ply", "spz", "sog"])
def test_harmonics_of_every_degree_are_kept(name, coefficients, tmp_path):
    gaussians = scene(coefficients)
    export(gaussians, tmp_path / f"scene.{name}", name, up="opencv")
    read = READERS[name](tmp_path / f"scene.{name}")
    assert read.harmonics.shape == gaussians.harmonics.shape
    nearest = torch.cdist(gaussians.means[0], read.means[0]).argmin(1)
    worst = (read.harmonics[0, nearest] - gaussians.harmonics[0]).abs()[:, 1:]
    assert coefficients == 1 or float(worst.max()) < (1e-6 if name == "ply" else 0.03)


def test_notes_are_in_the_file_or_beside_it(tmp_path):
    notes = "backbone: weights.pt, CC-BY-NC-4.0"
    for name in ("ply", "spz", "sog", "splat", "ksplat", "html"):
        export(scene(), tmp_path / f"scene.{name}", name, notes=notes)
        held = b"CC-BY-NC-4.0" in (tmp_path / f"scene.{name}").read_bytes()
        beside = tmp_path / f"scene.{name}.txt"
        assert held == build(Format, name).has_notes and beside.is_file() != held
        if not held:
            assert read_saved(tmp_path / f"scene.{name}").notes == (notes,)


def test_what_licences_mean():
    known = licenses({"backbone": {"file": "tiny_backbone.safetensors"}, "branch": {"file": "nobody.pt"}})
    assert known["backbone"]["license"] == "Apache-2.0" and "freely" in known["backbone"]["means"]
    assert known["branch"]["license"] == "not stated" and "ask" in known["branch"]["means"]
    assert "commercially" in meaning("CC-BY-NC-4.0") and "ask" in meaning("see the record")


def test_a_codebook_is_no_worse_than_quantiles_and_even_steps():
    values = np.random.default_rng(0).standard_normal(5000) ** 3
    levels, index = codebook(values)
    error = np.square(levels[index] - values).mean()
    quantiles = np.quantile(values, (np.arange(256) + 0.5) / 256)
    for other in (quantiles, np.linspace(values.min(), values.max(), 256)):
        assert error < np.square(other[np.abs(other - values[:, None]).argmin(1)] - values).mean()
    few, chosen = codebook(np.array([1.0, 2.0, 2.0]))
    np.testing.assert_allclose(few[chosen], [1, 2, 2])


def test_no_level_is_idle_beside_flat_discs():
    logs = np.concatenate([np.random.default_rng(0).normal(-4, 1, (6000, 2)), np.full((6000, 1), log(1e-12))], 1)
    levels, index = codebook(logs)
    assert len(np.unique(index)) == 256 and np.sqrt(np.square(levels[index] - logs)[:, :2].mean()) < 0.0075


def test_a_page_keeps_small_sizes_beside_a_huge_one():
    sizes = torch.full((1, 50, 3), exp(-7.0))
    sizes[0, 0] = exp(9.0)
    blob, packing, _ = _packed([StyledScene((("", replace(scene(1, 50), scales=sizes)),)).splats()])
    held = np.array(packing["scales"])[np.frombuffer(blob, np.uint8, 150, 50 * (4 + 6))]
    np.testing.assert_allclose(np.sort(held), [-7.0] * 147 + [9.0] * 3, atol=1e-4)


def test_what_a_file_cannot_hold_is_one_line(tmp_path, caplog):
    """Rows of opacity 0, harmonics of degree 4, what SPZ's bytes cut, and positions made coarse by one far out."""
    full, stray = scene(25), torch.tensor([1e5, 0.0, 0.0])
    hidden = replace(full, opacities=full.opacities.index_fill(1, torch.arange(3), 0.0))
    vast = replace(full, harmonics=full.harmonics.index_fill(1, torch.arange(2), 5.0))
    far = replace(full, means=full.means.index_copy(1, torch.tensor([0]), stray[None, None]))
    flat = replace(full, scales=full.scales.index_fill(1, torch.arange(4), exp(-12.0)))
    for given, name, lines in (
        (full, "ply", []),
        (full, "spz", ["harmonics above degree 3 are left out"]),
        (full, "ksplat", ["above degree 2 are left out", "colours of 15 of 400 Gaussians are cut to [0, 1]"]),
        (hidden, "ply", ["3 of 400 Gaussians are left out (with opacity 0)"]),
        (vast, "spz", ["above degree 3", "400 Gaussians, what SPZ cannot hold is cut: colours of 2, harmonics of 2"]),
        (flat, "spz", ["above degree 3", "of 400 Gaussians, what SPZ cannot hold is cut: sizes of 4"]),
        (far, "spz", ["above degree 3", "multiples of 0.015625, and would be of 3.8147e-06 without 1 of 400"]),
    ):
        caplog.clear()
        with atomic_directory(tmp_path / name) as folder:
            export(given, folder / f"scene.{name}", name)
        assert len(caplog.messages) == len(lines) and all(line in caplog.text for line in lines), caplog.messages
        assert all(line.startswith(f"{tmp_path / name / 'scene'}.{name}: ") for line in caplog.messages)
    export(full, tmp_path / "scene.ply", "ply")
    torch.testing.assert_close(Gaussians.load(tmp_path / "scene.ply").harmonics, full.harmonics)


def test_comments_of_other_programs_are_no_rights(tmp_path):
    export(scene(), tmp_path / "scene.sog", "sog", notes="Generated by Brush\nscene: CC-BY-4.0")
    with zipfile.ZipFile(tmp_path / "scene.sog") as archive:
        assert json.loads(archive.read("meta.json"))["asset"]["copyright"] == "scene: CC-BY-4.0"
    assert set(read_saved(tmp_path / "scene.sog").notes) == {"Generated by Brush", "scene: CC-BY-4.0"}


def test_a_palette_stands_for_more_vectors_than_it_has(monkeypatch):
    monkeypatch.setattr("anystyle_formats.sog.PALETTE", 64)
    generator = np.random.default_rng(0)
    vectors = generator.standard_normal((16, 9))[generator.integers(0, 16, 500)]
    centroids, labels = palette(vectors)
    assert len(centroids) == 64
    np.testing.assert_allclose(centroids[labels], vectors, atol=1e-12)


def test_three_of_four_components_are_a_rotation():
    unit = torch.nn.functional.normalize(torch.randn(100, 4, generator=torch.Generator().manual_seed(0)), dim=1)
    again = from_smallest_three(*smallest_three(unit.double().numpy()))
    np.testing.assert_allclose(np.abs((again * unit.numpy()).sum(1)), 1, atol=1e-6)


def test_the_command_merges_gaussians_and_says_so(tmp_path, caplog):
    export(scene(), tmp_path / "scene.ply", "ply")
    words = [str(tmp_path / "scene.ply"), "--out", str(tmp_path / "few.ply"), "--max-gaussians"]
    command.export(*split(command.parser(), [*words, "100", "splat.cameras=4"]))
    assert "kept 100 of 400 Gaussians (merged)" in caplog.text
    few = Gaussians.load(tmp_path / "few.ply")
    assert few.means.shape[1] == 100 and few.harmonics.shape[2] == 4 and psnr(picture(few), picture(scene())) > 20
    command.export(*split(command.parser(), [*words, "1000", "splat.cameras=4"]))
    assert psnr(picture(Gaussians.load(tmp_path / "few.ply")), picture(scene())) > 80
    with pytest.raises(UserError, match="max_gaussians"):
        command.export(*split(command.parser(), [*words, "0"]))
    (tmp_path / "report.json").touch()
    with pytest.raises(UserError, match="or part of a result"):
        command.export(*split(command.parser(), [str(tmp_path / "few.ply"), "--out", str(tmp_path / "scene.ply")]))


def test_the_command_converts_a_file_and_refuses_what_makes_no_sense(tmp_path, capsys):
    export(scene(), tmp_path / "scene.ply", "ply")
    command.export(command.parser().parse_args([str(tmp_path / "scene.ply"), "--out", str(tmp_path / "scene.spz")]))
    read = from_axes("y", READERS["spz"](tmp_path / "scene.spz"))
    assert psnr(picture(read), picture(scene())) > LEAST["spz"]
    assert "scene.spz" in capsys.readouterr().out
    for words in ([str(tmp_path / "scene.ply"), "--out", str(tmp_path / "scene.ply")],
                  [str(tmp_path / "scene.ply"), "--out", str(tmp_path / "scene.xyz")],
                  [str(tmp_path), "--out", str(tmp_path / "scene.sog")]):  # fmt: skip
        with pytest.raises(ValueError):
            command.export(command.parser().parse_args(words))
    nothing = replace(scene(), opacities=torch.zeros(1, 400))
    with pytest.raises(ValueError, match="no Gaussians that are visible"):
        export(nothing, tmp_path / "nothing.spz", "spz")
    assert not (tmp_path / "nothing.spz").exists()
