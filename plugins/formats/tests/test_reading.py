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

from anystyle.commands import stylize
from anystyle.contracts import Format
from anystyle.errors import UserError
from anystyle.io import ply
from anystyle.pipeline.export import export_styles, in_axes
from anystyle.pipeline.options import SplatOptions
from anystyle.pipeline.saved import read_saved
from anystyle.registry.build import build
from anystyle.types import Gaussians, StyledScene
from anystyle_formats import command_export as command
from tests.support.export_readers import SPLAT_TRANSFORM
from tests.support.export_scene import LEAST, export, picture, psnr, scene

READ = ("ksplat", "ply", "sog", "splat", "spz")
QUANTISED = {"ksplat": 40, "sog": 34, "splat": 30, "spz": 34}
"""PSNR in dB of files of other programs, some of which quantise more than this one."""


def read(path):
    """The picture of a file, as its format says that it stands."""
    return picture(read_saved(path).styles[-1][1])


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("name", ["spz", "splat", "sog", "ksplat"])
def test_files_of_gaussforge_are_read(name, version, tmp_path):
    """It turns no axes: its SPZ files stand on their heads until that is said."""
    gaussforge = pytest.importorskip("gaussforge", reason="the other program is in the group dev")
    gaussians = scene({"splat": 1}.get(name, 16))
    export(gaussians, tmp_path / "scene.ply", "ply")
    theirs = gaussforge.GaussForge().convert((tmp_path / "scene.ply").read_bytes(), "ply", name, spz_version=version)
    (tmp_path / f"theirs.{name}").write_bytes(theirs["data"])
    found = read_saved(tmp_path / f"theirs.{name}", SplatOptions(up="opencv")).styles[-1][1]
    assert found.harmonics.shape == gaussians.harmonics.shape
    assert psnr(picture(found), picture(gaussians)) > QUANTISED[name]


@pytest.mark.skipif(SPLAT_TRANSFORM is None, reason="npm install -g @playcanvas/splat-transform")
@pytest.mark.parametrize(("name", "options"), [("sog", ""), ("spz", ""), ("spz", "--spz-version 3")])
def test_files_of_splat_transform_are_read(name, options, tmp_path):
    gaussians = scene(16)
    export(gaussians, tmp_path / "scene.ply", "ply")
    path = tmp_path / f"theirs.{name}"
    words = [SPLAT_TRANSFORM, "-q", "-g", "cpu", *options.split(), tmp_path / "scene.ply", path]
    subprocess.run(words, check=True, capture_output=True)
    found = read_saved(path, SplatOptions(up="opencv" if name == "spz" else None)).styles[-1][1]
    assert psnr(picture(found), picture(gaussians)) > QUANTISED[name]


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
    other = read_saved(tmp_path / "scene.ply", SplatOptions(up="z" if up != "z" else "y"))
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
    texts = ["--text", "charcoal drawing", "--text", "red dots", "--export", "html"]
    small = ["video.frames=2", "views.short_side=28", "splat.cameras=2", "method.fit_colors=1"]
    stylize.main([str(tmp_path / "scene.spz"), *texts, "--out", str(tmp_path / "out"), *small])
    assert capsys.readouterr().out.strip().endswith("look at " + str(tmp_path / "out" / "scene.html"))
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["reconstruction"]["kind"] == "given" and report["reconstruction"]["num_gaussians"] == 400
    expected = read_saved(tmp_path / "scene.spz").styles[0][1].means
    (scene_file,) = (tmp_path / "out").glob("01-*/scene.ply")
    torch.testing.assert_close(Gaussians.load(scene_file).means, expected, rtol=0, atol=1e-5)
    titles = [title for title, _ in read_saved(tmp_path / "out").styles]
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


@pytest.mark.parametrize("first", ["ply", "spz", "sog"])
@pytest.mark.parametrize("marked", [True, False])
def test_antialiasing_of_the_training_is_carried(tmp_path, caplog, first, marked):
    """A comment in PLY, a bit in SPZ, a key in SOG: each is read into the others, and a line says where it is lost."""
    given = StyledScene((("", scene(1).marked(marked)),), notes=("mine",))
    export_styles(given, tmp_path / f"first.{first}", first)
    read = read_saved(tmp_path / f"first.{first}")
    assert read.antialiased == marked and read.notes == ("mine",)
    for name in ("ply", "spz", "sog", "splat"):
        export_styles(read, tmp_path / f"again.{name}", name)
        assert read_saved(tmp_path / f"again.{name}").antialiased == (marked and name != "splat")
    assert ("again.splat: the format cannot say" in caplog.text) == marked
    assert caplog.text.count("trained with antialiasing") == marked
    assert (gzip.decompress((tmp_path / "again.spz").read_bytes())[14] == 1) == marked
    with zipfile.ZipFile(tmp_path / "again.sog") as archive:
        meta = json.loads(archive.read("meta.json"))
    assert meta["antialias"] == marked == (meta.get("model") == "antialiased")
    assert meta["asset"]["extras"]["notes"] == ["mine"]
    assert read_saved(tmp_path / "again.ply", SplatOptions(antialiased=not marked)).antialiased != marked
    (tmp_path / "config.yml").write_text("pipeline: !!python/object:some.Model\n  rasterize_mode: antialiased\n")
    assert read_saved(tmp_path / "again.splat").antialiased
