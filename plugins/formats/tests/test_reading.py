"""Files of other programs, of older versions, and damaged ones."""

import gzip
import json
import random
import struct
import subprocess
import zipfile
from itertools import pairwise

import numpy as np
import pytest
import torch
from plyfile import PlyData

from anystyle.commands import export as command
from anystyle.commands import stylize
from anystyle.contracts import Format
from anystyle.errors import UserError
from anystyle.geometry.transforms import Similarity
from anystyle.io import ply
from anystyle.io.splats import NEAR
from anystyle.pipeline.export import export, export_styles, in_axes
from anystyle.pipeline.saved import read_saved
from anystyle.registry.build import build
from anystyle.types import Gaussians, StyledScene
from anystyle_formats import glb
from anystyle_formats.reading import joined
from tests.support.export_readers import SPLAT_TRANSFORM, read_with_gaussforge
from tests.support.export_scene import LEAST, picture, psnr, scene

READ = ("glb", "ksplat", "ply", "sog", "splat", "spz")
QUANTISED = {"ply": 80, "glb": 80, "ksplat": 40, "sog": 34, "splat": 30, "spz": 34}
"""PSNR in dB of files of other programs, some of which quantise more than this one."""


def read(path):
    """The picture of a file, as its format says that it stands."""
    return picture(read_saved(path).styles[-1][1])


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("name", ["spz", "splat", "sog", "ksplat"])
def test_files_of_gaussforge_are_read(name, version, tmp_path):
    """It turns no axes: its SPZ files stand on their heads until that is said."""
    gaussforge = pytest.importorskip("gaussforge", reason="the other program is in the group dev")
    gaussians = scene({"splat": 1, "ksplat": 4}.get(name, 16))
    export(gaussians, tmp_path / "scene.ply", "ply")
    theirs = gaussforge.GaussForge().convert((tmp_path / "scene.ply").read_bytes(), "ply", name, spz_version=version)
    (tmp_path / f"theirs.{name}").write_bytes(theirs["data"])
    found = read_saved(tmp_path / f"theirs.{name}", "opencv").styles[-1][1]
    assert found.harmonics.shape == gaussians.harmonics.shape
    assert psnr(picture(found), picture(gaussians)) > QUANTISED[name]
    export(gaussians, tmp_path / f"ours.{name}", name)
    back = read_with_gaussforge(tmp_path / f"ours.{name}", tmp_path)
    assert psnr(picture(back), picture(gaussians)) > LEAST[name]


@pytest.mark.skipif(SPLAT_TRANSFORM is None, reason="npm install -g @playcanvas/splat-transform")
@pytest.mark.parametrize(("name", "options"), [("glb", ""), ("sog", ""), ("spz", ""), ("spz", "--spz-version 3")])
def test_files_of_splat_transform_are_read(name, options, tmp_path):
    gaussians = scene(16)
    export(gaussians, tmp_path / "scene.ply", "ply")
    path = tmp_path / f"theirs.{name}"
    words = [SPLAT_TRANSFORM, "-q", "-g", "cpu", *options.split(), tmp_path / "scene.ply", path]
    subprocess.run(words, check=True, capture_output=True)
    found = read_saved(path, "opencv" if name == "spz" else None).styles[-1][1]
    if name == "glb":  # upright, and seen from behind: glTF says what is up, and nothing of the world's front
        half = Similarity(torch.tensor(1.0), torch.diag(torch.tensor([-1.0, 1.0, -1.0])), torch.zeros(3))
        found = half.gaussians(found)
    assert psnr(picture(found), picture(gaussians)) > QUANTISED[name]


# What other writers of glTF do


def packed_glb(path, document, binary):
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)


def parts(path):
    data = path.read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    return json.loads(data[20 : 20 + length]), data[28 + length :]


def test_nodes_move_what_they_hold(tmp_path):
    """Half of the scene lies in a node that moves, turns and scales it back; another node has lower harmonics."""
    whole = scene(4)
    halves = [whole.map(lambda tensor: tensor[:, :200]), whole.map(lambda tensor: tensor[:, 200:])]
    halves[1] = Gaussians(*[*list(vars(halves[1]).values())[:4], halves[1].harmonics[:, :, :1]])
    expected = picture(joined([(half, np.eye(4)) for half in halves], NEAR))
    turned = in_axes("z", StyledScene((("", halves[0]),), up="opencv")).styles[0][1]  # half of a right angle's way
    columns = vars(turned) | {"means": 2 * turned.means + 1, "scales": 2 * turned.scales}
    export(Gaussians(**columns), tmp_path / "first.glb", "glb", up="opencv")
    export(halves[1], tmp_path / "second.glb", "glb")
    (one, binary), (other, more) = parts(tmp_path / "first.glb"), parts(tmp_path / "second.glb")
    for entry in other["bufferViews"]:
        entry["byteOffset"] += len(binary)
    for entry in other["accessors"]:
        entry["bufferView"] += len(one["bufferViews"])
    attributes = other["meshes"][0]["primitives"][0]["attributes"]
    other["meshes"][0]["primitives"][0]["attributes"] = {
        name: index + len(one["accessors"]) for name, index in attributes.items()
    }
    for key in ("bufferViews", "accessors", "meshes"):
        one[key] += other[key]
    # From z up to y up: a quarter turn about x; then the inverse of what was done to the coordinates.
    turn = [-(0.5**0.5), 0, 0, 0.5**0.5]
    one["nodes"] = [
        {"children": [1, 2]},
        {"rotation": turn, "children": [3]},
        {"mesh": 1},
        {"mesh": 0, "scale": [0.5, 0.5, 0.5], "translation": [-0.5, -0.5, -0.5]},
    ]
    one["scenes"] = [{"nodes": [0]}]
    packed_glb(tmp_path / "both.glb", one, binary + more)
    assert psnr(read(tmp_path / "both.glb"), expected) > 60
    one["nodes"][3]["scale"] = [0.5, 0.5, 1]
    packed_glb(tmp_path / "both.glb", one, binary + more)
    with pytest.raises(UserError, match=r"both\.glb is not a readable GLB file .* scale unevenly"):
        read(tmp_path / "both.glb")
    one["nodes"][3] = {"children": [0]}
    packed_glb(tmp_path / "both.glb", one, binary + more)
    with pytest.raises(UserError, match="their own children"):
        read(tmp_path / "both.glb")


def test_normalised_and_interleaved_attributes_are_read(tmp_path):
    """Rotations as shorts and opacities as bytes, row by row beside each other, as the extension allows."""
    gaussians = scene(1)
    export(gaussians, tmp_path / "plain.glb", "glb")
    document, binary = parts(tmp_path / "plain.glb")
    count = 400
    rows = np.zeros(count, [("rotation", "<i2", 4), ("opacity", "u1"), ("unused", "u1", 3)])
    turned = in_axes("y", StyledScene((("", gaussians),))).styles[0][1]
    unit = torch.nn.functional.normalize(turned.rotations[0], dim=-1)[:, [1, 2, 3, 0]].numpy()
    rows["rotation"], rows["opacity"] = np.round(unit * 32767), np.round(gaussians.opacities[0].numpy() * 255)
    view = {"buffer": 0, "byteOffset": len(binary), "byteLength": rows.nbytes, "byteStride": 12}
    document["bufferViews"].append(view)
    index = {"bufferView": len(document["bufferViews"]) - 1, "count": count, "normalized": True}
    attributes = document["meshes"][0]["primitives"][0]["attributes"]
    for name, more in (
        ("ROTATION", {"type": "VEC4", "componentType": 5122}),
        ("OPACITY", {"type": "SCALAR", "componentType": 5121, "byteOffset": 8}),
    ):
        document["accessors"].append(index | more)
        attributes[f"{glb.NAME}:{name}"] = len(document["accessors"]) - 1
    packed_glb(tmp_path / "packed.glb", document, binary + rows.tobytes())
    assert psnr(read(tmp_path / "packed.glb"), picture(gaussians)) > 45


def test_spz_within_glb_is_read(tmp_path):
    gaussians = scene(4)
    export(gaussians, tmp_path / "scene.spz", "spz")
    data = (tmp_path / "scene.spz").read_bytes()
    how = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display", "extensions": {glb.PACKED: {"bufferView": 0}}}
    document = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {}, "mode": 0, "extensions": {glb.NAME: how}}]}],
        "bufferViews": [{"buffer": 0, "byteOffset": 0, "byteLength": len(data)}],
    }
    packed_glb(tmp_path / "scene.glb", document, data + b"\0" * (-len(data) % 4))
    assert psnr(read(tmp_path / "scene.glb"), picture(gaussians)) > LEAST["spz"]
    how["colorSpace"] = "lin_rec709_display"
    packed_glb(tmp_path / "scene.glb", document, data)
    with pytest.raises(UserError, match="ellipses in sRGB are read"):
        read(tmp_path / "scene.glb")


def test_styles_of_a_glb_share_their_geometry(tmp_path):
    """Each is a scene of the file; the last is shown, and comes last again."""
    gaussians = scene(4)
    pale = Gaussians(**{**vars(gaussians), "harmonics": 0.5 * gaussians.harmonics})
    export(gaussians, tmp_path / "one.glb", "glb")
    styles = StyledScene((("unstyled", gaussians), ("pale", pale)), notes=("mine",))
    export_styles(styles, tmp_path / "two.glb", "glb")
    document, binary = parts(tmp_path / "two.glb")
    assert document["scene"] == 1 and [each["name"] for each in document["scenes"]] == ["unstyled", "pale"]
    assert len(binary) - len(parts(tmp_path / "one.glb")[1]) == 400 * (4 * 12 + 4)
    found = read_saved(tmp_path / "two.glb")
    assert [title for title, _ in found.styles] == ["unstyled", "pale"] and found.notes[0] == "mine"
    assert psnr(picture(found.styles[0][1]), picture(gaussians)) > 80
    assert psnr(picture(found.styles[1][1]), picture(pale)) > 80


@pytest.mark.parametrize(("number", "up"), [(4, "y"), (6, "opencv"), (12, "z"), (8, None)])
def test_an_extension_of_spz_may_name_the_axes(number, up, tmp_path):
    """Version 4, behind a record that nobody knows."""
    zstandard = pytest.importorskip("zstandard", reason='pip install "anystyle[spz]"')
    gaussians, count = scene(1), 400
    export(gaussians, tmp_path / "old.spz", "spz", up=up or "y")
    old = gzip.decompress((tmp_path / "old.spz").read_bytes())
    ends = np.cumsum([16, 9 * count, count, 3 * count, 3 * count, 4 * count])
    streams = [old[start:end] for start, end in pairwise(ends)]
    packed = [zstandard.ZstdCompressor().compress(each) for each in streams]
    records = struct.pack("<IIQ", 0x12340001, 8, 0) + struct.pack("<III", 0xADBE0003, 4, number)
    header = old[:4] + struct.pack("<I", 4) + old[8:14] + struct.pack("<BBI12x", 2, 5, 32 + len(records))
    table = b"".join(struct.pack("<QQ", len(short), len(each)) for short, each in zip(packed, streams, strict=True))
    (tmp_path / "new.spz").write_bytes(header + records + table + b"".join(packed))
    if up is None:
        with pytest.raises(UserError, match="axes have the number 8"):
            read(tmp_path / "new.spz")
    else:
        assert psnr(read(tmp_path / "new.spz"), picture(gaussians)) > LEAST["spz"]


# Axes


@pytest.mark.parametrize(
    ("said", "up"),
    [
        ("Vertical axis: y", "opencv"),
        ("Vertical axis: 0.02 -0.98 0.1", "opencv"),
        ("Vertical axis: 0 1 0", "y"),
        ("Vertical Axis: z", "z"),
        ("Vertical axis: 1e-2 0 1", "z"),
        ("Vertical axis: here", "opencv"),
    ],
)
def test_a_ply_header_that_names_the_axis_is_obeyed(said, up, tmp_path):
    """As Brush writes it, whose y is 3DGS's, and nerfstudio; what is asked for wins."""
    turned = in_axes(up, StyledScene((("", scene(4)),))).styles[0][1]
    splats = ply.Splats(*(tensor[0] for tensor in vars(turned).values()))
    ply.write(splats, tmp_path / "scene.ply", ["from elsewhere", said])
    found = read_saved(tmp_path / "scene.ply")
    assert psnr(picture(found.styles[0][1]), picture(scene(4))) > 80
    assert found.notes == ("from elsewhere",)
    other = read_saved(tmp_path / "scene.ply", "z" if up != "z" else "y")
    assert psnr(picture(other.styles[0][1]), picture(scene(4))) < 30
    assert ply.recolor(tmp_path / "scene.ply", splats.harmonics, tmp_path / "again.ply")
    assert PlyData.read(tmp_path / "again.ply").comments == ["from elsewhere", said]


# Commands


def test_every_format_is_exported_to_every_other(tmp_path, capsys):
    gaussians = scene(1)
    for name in READ:
        export(gaussians, tmp_path / f"scene.{name}", name)
        for other in (*READ, "html"):
            out = tmp_path / f"from_{name}.{other}"
            command.export(command.parser().parse_args([str(tmp_path / f"scene.{name}"), "--out", str(out)]))
            if other != "html":
                assert psnr(read(out), picture(gaussians)) > min(LEAST[name], LEAST[other]) - 2
    with pytest.raises(UserError, match="written, and not read"):
        read_saved(tmp_path / "from_ply.html")


def test_stylize_takes_a_file_of_any_format(tmp_path, capsys):
    export(scene(1), tmp_path / "scene.spz", "spz")
    texts = ["--text", "charcoal drawing", "--text", "red dots", "--export", "glb,html"]
    small = ["video.frames=2", "views.short_side=28", "splat.cameras=2", "method.fit_colors=1"]
    words = [str(tmp_path / "scene.spz"), *texts, "--out", str(tmp_path / "out"), *small]
    stylize.main(words)
    assert capsys.readouterr().out.strip().endswith("look at " + str(tmp_path / "out" / "scene.html"))
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["reconstruction"]["kind"] == "given" and report["reconstruction"]["num_gaussians"] == 400
    expected = read_saved(tmp_path / "scene.spz").styles[0][1].means
    (scene_file,) = (tmp_path / "out").glob("01-*/scene.ply")
    torch.testing.assert_close(Gaussians.load(scene_file).means, expected, rtol=0, atol=1e-5)
    titles = [title for title, _ in read_saved(tmp_path / "out" / "scene.glb").styles]
    assert len(titles) == 3 and titles[0] == "unstyled"


# Damage


@pytest.mark.parametrize("name", READ)
def test_damaged_files_end_in_one_line(name, tmp_path, caplog):
    """Cut, with other bytes, or of another format: a UserError of one line, or a scene of finite numbers."""
    export(scene(4, 30), tmp_path / f"scene.{name}", name)
    data, path, draw = (tmp_path / f"scene.{name}").read_bytes(), tmp_path / f"damaged.{name}", random.Random(0)
    refused = 0
    for number in range(150):
        changed = bytearray(data[: draw.randrange(len(data))] if number % 3 == 0 else data)
        for _ in range(number % 3 and draw.choice((1, 4, 64))):
            changed[draw.randrange(min(len(changed), draw.choice((64, len(changed)))))] = draw.choice((0, 255, 37))
        path.write_bytes(changed)
        caplog.clear()
        try:
            found = build(Format, name).read(path)
        except UserError as error:
            assert "\n" not in str(error) and path.name in str(error)
            refused += 1
        else:
            assert all(bool(tensor.isfinite().all()) for tensor in vars(found.styles[0][1]).values())
            refused += any("left out" in message for message in caplog.messages)  # rows of it, told in a line
    assert refused >= 50


@pytest.mark.parametrize(
    ("name", "data"),
    [
        (
            "spz",
            gzip.compress(struct.pack("<IIIBBBB", 0x5053474E, 3, 4_000_000_000, 3, 12, 0, 0) + b"\0" * 64, mtime=0),
        ),
        ("spz", struct.pack("<IIIBBBBI12xQQ", 0x5053474E, 4, 9, 0, 12, 0, 1, 32, 99, 1 << 60) + b"\0" * 99),
        ("splat", b"\0" * 31),
        ("glb", struct.pack("<4sIII4s", b"glTF", 2, 1 << 31, 1 << 31, b"JSON") + b"[" * 100_000),
        ("ply", b"ply\nformat binary_little_endian 1.0\nelement vertex 99999999999\nproperty float x\nend_header\n"),
    ],
)
def test_headers_that_promise_too_much_are_refused(name, data, tmp_path):
    (tmp_path / f"scene.{name}").write_bytes(data)
    with pytest.raises((UserError, ImportError)):
        build(Format, name).read(tmp_path / f"scene.{name}")


def test_a_sog_of_vast_images_is_refused(tmp_path):
    export(scene(1), tmp_path / "scene.sog", "sog")
    with zipfile.ZipFile(tmp_path / "scene.sog") as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    for count in (10**12, 100_000):
        meta = json.loads(members["meta.json"]) | {"count": count}
        with zipfile.ZipFile(tmp_path / "vast.sog", "w") as archive:
            for name, data in (members | {"meta.json": json.dumps(meta).encode()}).items():
                archive.writestr(name, data)
        with pytest.raises(UserError, match=r"vast\.sog"):
            read_saved(tmp_path / "vast.sog")


# Nodes far away


def test_nodes_of_a_glb_at_coordinates_of_utm_keep_their_gaussians_apart(tmp_path, caplog):
    export(scene(4), tmp_path / "scene.glb", "glb")
    document, binary = parts(tmp_path / "scene.glb")
    document["nodes"][0]["translation"] = [4.5e6, 100.25, -5.4e5]
    packed_glb(tmp_path / "far.glb", document, binary)
    found = read_saved(tmp_path / "far.glb")
    assert found.offset == (4.5e6, 0, 5.4e5) and len(caplog.messages) == 1
    near = read_saved(tmp_path / "scene.glb").styles[0][1]
    torch.testing.assert_close(found.styles[0][1].means, near.means + torch.tensor([0, -100.25, 0]), rtol=0, atol=1e-4)
