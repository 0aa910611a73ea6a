from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.lib.recfunctions import append_fields
from plyfile import PlyData, PlyElement

from anystyle.io import ply
from anystyle.types import Gaussians
from tests.support.ply_files import BASE, write_ply
from tests.support.scenes import gaussians as random_gaussians

GOLDENS = Path(__file__).parents[1] / "goldens"


@pytest.mark.parametrize("degree", range(5))
def test_what_is_written_is_read_back(tmp_path, degree):
    gaussians = random_gaussians(1, 50, degree)
    gaussians.save(tmp_path / "scene.ply")
    back = Gaussians.load(tmp_path / "scene.ply")
    torch.testing.assert_close(back.harmonics, gaussians.harmonics, rtol=1e-5, atol=1e-6)
    for name in ("means", "scales", "opacities"):
        torch.testing.assert_close(getattr(back, name), getattr(gaussians, name), rtol=1e-5, atol=1e-6)
    unit = torch.nn.functional.normalize(gaussians.rotations, dim=-1)
    torch.testing.assert_close(back.rotations, unit, rtol=1e-6, atol=1e-6)


def test_the_layout_is_that_of_3dgs(tmp_path):
    gaussians = random_gaussians(1, 3, 1)
    gaussians.save(tmp_path / "scene.ply")
    vertex = PlyData.read(tmp_path / "scene.ply")["vertex"]
    assert [item.name for item in vertex.properties] == [
        *["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"],
        *(f"f_rest_{place}" for place in range(9)),
        *["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"],
    ]
    assert {item.dtype().lstrip("<=") for item in vertex.properties} == {"f4"}
    opacity = gaussians.opacities[0].double().numpy()
    np.testing.assert_allclose(vertex["opacity"], np.log(opacity / (1 - opacity)), rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(vertex["scale_1"], np.log(gaussians.scales[0, :, 1].numpy()), rtol=1e-5)
    # Colour-major: green's second coefficient is the fifth of the rest.
    np.testing.assert_array_equal(vertex["f_rest_4"], gaussians.harmonics[0, :, 2, 1].numpy())


def test_extremes_stay_finite_and_padding_is_left_out(tmp_path):
    gaussians = random_gaussians(1, 4)
    gaussians.opacities[0] = torch.tensor([0.0, 1.0, 1e-9, 0.5])
    gaussians.scales[0, 1] = 0.0
    gaussians.save(tmp_path / "scene.ply")
    vertex = PlyData.read(tmp_path / "scene.ply")["vertex"]
    assert vertex.count == 3 and all(np.isfinite(vertex[item.name]).all() for item in vertex.properties)


def test_other_files_are_refused(tmp_path):
    (tmp_path / "text.ply").write_text("no ply")
    with pytest.raises(ValueError, match="is not a valid PLY file of Gaussians"):
        Gaussians.load(tmp_path / "text.ply")
    header = "ply\nformat ascii 1.0\nelement vertex 99999999999\nproperty float x\nend_header\n"
    (tmp_path / "vast.ply").write_text(header)
    with pytest.raises((ValueError, MemoryError)):
        Gaussians.load(tmp_path / "vast.ply")
    random_gaussians(1, 50, 1).save(tmp_path / "scene.ply")
    data = (tmp_path / "scene.ply").read_bytes().replace(b"property float opacity", b"property float opulence")
    (tmp_path / "other.ply").write_bytes(data)
    with pytest.raises(ValueError, match="without the properties opacity"):
        Gaussians.load(tmp_path / "other.ply")


def test_names_as_cloudcompare_writes_them_are_read_and_leave_with_new_colors(tmp_path):
    random_gaussians(1, 5, 1).save(tmp_path / "scene.ply")
    rows = PlyData.read(tmp_path / "scene.ply")["vertex"].data
    rows.dtype.names = tuple(name if name[-1] in "xyz" else f"scalar_{name}" for name in rows.dtype.names)
    PlyData([PlyElement.describe(rows, "vertex")]).write(tmp_path / "part.ply")
    expected, found = (Gaussians.load(tmp_path / name) for name in ("scene.ply", "part.ply"))
    for item in fields(found):
        assert torch.equal(getattr(found, item.name), getattr(expected, item.name))
    assert ply.recolor(tmp_path / "part.ply", torch.zeros(5, 1, 3), tmp_path / "painted.ply")
    assert not Gaussians.load(tmp_path / "painted.ply").harmonics.any()


def test_a_compressed_file_is_read_as_its_own_program_reads_it():
    """Both files are splat-transform's (3.7.0): 300 Gaussians of degree 2, and what it unpacks of them."""
    packed = Gaussians.load(GOLDENS / "splat_transform.compressed.ply")
    unpacked = Gaussians.load(GOLDENS / "splat_transform.ply")
    assert packed.harmonics.shape == (1, 300, 9, 3)
    for item in fields(packed):
        torch.testing.assert_close(getattr(packed, item.name), getattr(unpacked, item.name), rtol=1e-5, atol=1e-5)


def test_a_damaged_compressed_file_is_refused(tmp_path):
    data = PlyData.read(GOLDENS / "splat_transform.compressed.ply")
    chunk, vertex = data["chunk"].data, data["vertex"].data
    PlyData([PlyElement.describe(chunk[:1], "chunk"), PlyElement.describe(vertex, "vertex")]).write(tmp_path / "a.ply")
    with pytest.raises(ValueError, match="1 chunks for 300 Gaussians"):
        Gaussians.load(tmp_path / "a.ply")


@pytest.mark.parametrize("degree", [4, 5])
def test_degrees_beyond_those_of_viewers_are_read(tmp_path, degree):
    gaussians = random_gaussians(1, 5, degree)
    rest = gaussians.harmonics[0, :, 1:].mT.flatten(1).numpy()
    values = {"opacity": np.zeros(5), **{f"f_rest_{index}": rest[:, index] for index in range(rest.shape[1])}}
    path = write_ply(tmp_path / "scene.ply", {name: np.ones(5) for name in BASE} | values)
    torch.testing.assert_close(Gaussians.load(path).harmonics[:, :, 1:], gaussians.harmonics[:, :, 1:])


def test_the_filter_of_mip_splatting_is_applied(tmp_path, caplog):
    """Variances add up, and opacities fall by the ratio of volumes; a copy in other colours keeps both as they are."""
    given = Gaussians(
        torch.randn(1, 5, 3), torch.eye(4)[:1].expand(1, 5, 4), torch.full((1, 5, 3), 0.01), torch.full((1, 5), 0.8),
        torch.randn(1, 5, 1, 3),
    )  # fmt: skip
    given.save(tmp_path / "plain.ply")
    data = PlyData.read(tmp_path / "plain.ply")["vertex"].data
    wider = append_fields(data, "filter_3D", [0.0, 0.01, 0.02, 0.01, np.nan], "f4", usemask=False)
    PlyData([PlyElement.describe(wider, "vertex")]).write(tmp_path / "mip.ply")
    read = Gaussians.load(tmp_path / "mip.ply")
    width = torch.tensor([0.0, 0.01, 0.02, 0.01, 0.0])
    torch.testing.assert_close(read.scales[0, :, 0], (0.01**2 + width**2).sqrt())
    torch.testing.assert_close(read.opacities[0], 0.8 * (0.01**2 / (0.01**2 + width**2)) ** 1.5)
    assert "filter_3D, as Mip-Splatting writes it, is applied" in caplog.text
    assert ply.recolor(tmp_path / "mip.ply", given.harmonics[0] + 1, tmp_path / "copy.ply")
    copy = Gaussians.load(tmp_path / "copy.ply")
    assert torch.equal(copy.scales, read.scales) and torch.equal(copy.opacities, read.opacities)
