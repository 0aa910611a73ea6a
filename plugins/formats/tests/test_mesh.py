"""Meshes of Gaussians that lie on known surfaces."""

import json
import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from anystyle.commands.export import export, parser
from anystyle.contracts import Format, Renderer
from anystyle.errors import UserError
from anystyle.geometry.cameras import look_at
from anystyle.geometry.harmonics import constant_from_rgb
from anystyle.geometry.transforms import wxyz_from_matrix
from anystyle.pipeline.export import export_styles
from anystyle.registry.build import build
from anystyle.types import Cameras, Gaussians, StyledScene
from anystyle_formats.mesh.depth import render_depth
from anystyle_formats.mesh.fusion import Mesh, coverage, fused, pieces

trimesh = pytest.importorskip("trimesh", reason="trimesh, which opens OBJ files, is not installed")
pytest.importorskip("skimage", reason="the extra `mesh` is not installed")
RADIUS = 0.8


def cover(means, normals, spacing):
    """Flat Gaussians on a surface; the colour of each is that of its normal."""
    number = len(means)
    aside = F.normalize(torch.linalg.cross(normals, normals.roll(1, 1) + 0.1), dim=1)
    frames = torch.stack([aside, torch.linalg.cross(normals, aside), normals], dim=2)
    return Gaussians(
        means[None],
        wxyz_from_matrix(frames)[None],
        (torch.tensor([0.6, 0.6, 0.02]) * spacing).expand(1, number, 3),
        torch.full((1, number), 0.95),
        constant_from_rgb(0.5 + 0.4 * normals)[None, :, None],
    )


def sphere(number=8000):
    height = 1 - 2 * (torch.arange(number) + 0.5) / number
    turn = torch.arange(number) * math.pi * (3 - math.sqrt(5))
    flat = (1 - height.square()).sqrt()
    normals = torch.stack([flat * turn.cos(), height, flat * turn.sin()], dim=1)
    return cover(RADIUS * normals, normals, RADIUS * math.sqrt(4 * math.pi / number))


def around(number=14, size=(120, 120)):
    turn = 2 * math.pi * torch.arange(number) / number
    rise = torch.where(torch.arange(number) % 2 == 0, 0.6, -0.6)
    eyes = 3 * torch.stack([turn.cos() * rise.cos(), rise.sin(), turn.sin() * rise.cos()], dim=1)
    intrinsics = torch.tensor([[1.6 * size[1], 0, size[1] / 2], [0, 1.6 * size[0], size[0] / 2], [0, 0, 1]])
    return Cameras(look_at(eyes, torch.zeros_like(eyes))[None], intrinsics.repeat(1, number, 1, 1), size)


def test_a_sphere_comes_back_within_a_voxel():
    views = render_depth(sphere(), around(), build(Renderer, "auto"))
    assert views.agreement > 0.8
    mesh = fused(views, resolution=48)
    voxel = 2 * RADIUS / 48
    surface = trimesh.Trimesh(mesh.vertices, mesh.faces)
    distances = np.abs(np.linalg.norm(surface.vertices, axis=1) - RADIUS)
    assert distances.mean() < 0.3 * voxel and np.quantile(distances, 0.99) < voxel
    # It faces outwards, is one piece, and has the colours of the Gaussians.
    away = surface.triangles_center / np.linalg.norm(surface.triangles_center, axis=1, keepdims=True)
    outward = (surface.face_normals * away).sum(1)
    assert np.quantile(outward, 0.02) > 0.7
    assert surface.area == pytest.approx(4 * math.pi * RADIUS**2, rel=0.15)
    error = np.abs(mesh.colors - (0.5 + 0.4 * mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)))
    assert error.mean() < 0.03


def part_of(mesh, kept):
    """The faces of a mesh whose middle is where ``kept`` says, and their vertices."""
    used, faces = np.unique(mesh.faces[kept(mesh.vertices[mesh.faces].mean(1))], return_inverse=True)
    return Mesh(mesh.vertices[used], faces.reshape(-1, 3), mesh.colors[used])


def test_a_mesh_with_holes_is_measured_and_refused_or_told_of(tmp_path, monkeypatch, caplog):
    views = render_depth(sphere(), around(), build(Renderer, "auto"))
    whole = fused(views, resolution=48)
    half = part_of(whole, lambda middle: middle[:, 1] > 0)
    assert coverage(whole, views) > 0.98 and len(pieces(whole)) == 1
    assert coverage(half, views) == pytest.approx(0.55, abs=0.05)  # the half, and what is near its edge
    scene = StyledScene((("x", sphere()),), around(), tuple("abcdefghijklmn"))
    bowl = part_of(whole, lambda middle: middle[:, 1] > -0.2)
    monkeypatch.setattr("anystyle_formats.mesh.obj.fused", lambda views: bowl)
    export_styles(scene, tmp_path / "bowl.obj", "obj")
    assert "of the surfaces that the cameras see, in pieces: 1; the rest are holes" in caplog.text
    for kept, told in (
        (lambda middle: (np.abs(middle) > 0.2).all(1), r"in pieces: 8, the largest with 1\d% of the faces"),
        (lambda middle: middle[:, 1] > 0.9 * RADIUS, r"the mesh has \d% of the surfaces .* 10% and 50% are needed"),
    ):
        part = part_of(whole, kept)
        monkeypatch.setattr("anystyle_formats.mesh.obj.fused", lambda views, part=part: part)
        with pytest.raises(UserError, match=told):
            export_styles(scene, tmp_path / "part.obj", "obj")
        assert not (tmp_path / "part.obj").exists()


def test_what_cannot_be_meshed_says_so(tmp_path):
    gaussians, path = sphere(500), tmp_path / "mesh.obj"
    with pytest.raises(UserError, match="two cameras or more, and this scene has none"):
        export_styles(StyledScene((("x", gaussians),)), path, "obj")
    means = torch.randn(1, 500, 3, generator=torch.Generator().manual_seed(0))
    fog = replace(gaussians, means=means, scales=torch.full((1, 500, 3), 0.4), opacities=torch.full((1, 500), 0.1))
    with pytest.raises(UserError, match="is at the same depth for others") as raised:
        export_styles(StyledScene((("x", fog),), around(4, (30, 30)), tuple("abcd")), path, "obj")
    assert len(str(raised.value).splitlines()) == 1 and not path.exists()


def test_the_command_finds_cameras_beside_a_file_and_writes_what_trimesh_opens(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("anystyle_formats.mesh.obj.fused", partial(fused, resolution=32))
    cameras = around(14, (60, 60))
    build(Format, "ply").write(StyledScene((("ball", sphere(2000)),), notes=("of clay",)), tmp_path / "scene.ply")
    words = [str(tmp_path / "scene.ply"), "--to", "obj", "--out", str(tmp_path / "ball.obj")]
    with pytest.raises(UserError, match=r"put cameras\.json, transforms\.json or a COLMAP model beside the file"):
        export(parser().parse_args(words))
    rows = zip("abcdefghijklmn", cameras.intrinsics[0].tolist(), cameras.world_from_camera[0].tolist(), strict=True)
    names = ("name", "intrinsics", "world_from_camera")
    views = [{"height": 60, "width": 60, **dict(zip(names, row, strict=True))} for row in rows]
    (tmp_path / "cameras.json").write_text(json.dumps({"convention": "", "views": views}))
    export(parser().parse_args(words))
    assert "ball.obj" in capsys.readouterr().out and not list(tmp_path.glob("*.txt"))
    mesh = trimesh.load(tmp_path / "ball.obj", process=False)
    assert mesh.visual.kind == "vertex" and "# of clay\n" in (tmp_path / "ball.obj").read_text()
    turned = mesh.vertices * [1, -1, -1]  # the file is y up
    expected = 0.5 + 0.4 * turned / np.linalg.norm(turned, axis=1, keepdims=True)
    assert np.abs(mesh.visual.vertex_colors[:, :3] / 255 - expected).mean() < 0.06
