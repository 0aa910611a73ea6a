"""Valid inputs of the commands that read files, and ways to damage one."""

import json
import os
import random
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml
from PIL import Image
from plyfile import PlyData

from anystyle.data.scene_folder import FolderScenes
from anystyle.evaluation import comparisons
from anystyle.io import colmap
from anystyle.io.video import write_video
from anystyle.paths import SHARED
from anystyle.pipeline.export import export
from anystyle.types import Cameras, Gaussians
from anystyle_datasets.re10k import Re10kScenes
from anystyle_datasets.wikiart import WikiArtStyles
from tests.support.training_cases import RECONSTRUCTION

CHECK = ("data", "check", ".")
TINY = (
    "model=tiny", "poses=predicted", "views.short_side=28", "views.take=2", "video.frames=1", "video.scale=0.2",
    "reconstruction=feedforward", "--out", "out",
)  # fmt: skip


@dataclass(frozen=True)
class Case:
    """A folder of valid files.

    Args:
        files: Those that may be damaged, below the case's folder.
        words: The command that reads them, run in that folder.
        environment: Variables that the command is given.
    """

    files: tuple[str, ...]
    words: tuple[str, ...]
    environment: tuple[tuple[str, str], ...] = ()


def picture(path: Path, seed: int = 0, size: tuple[int, int] = (48, 36)) -> None:
    """A small image of noise."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.random.default_rng(seed).integers(0, 255, (size[1], size[0], 3), np.uint8)).save(path)


def write(root: Path) -> dict[str, Case]:
    """Write every case into a folder of its name."""

    def new(name: str) -> Path:
        (root / name).mkdir(parents=True, exist_ok=True)
        return root / name

    cases: dict[str, Case] = {}
    FolderScenes.example(new("transforms"))
    (root / "transforms" / "train_index.json").write_text('["garden"]')
    cases["transforms"] = Case(("garden/transforms.json", "garden/images/1.png", "train_index.json"), CHECK)
    row = np.concatenate([np.eye(3)[:, [1, 0, 2]] * [1, 1, -1], np.zeros((3, 1)), [[36], [48], [40]]], axis=1)
    for number in range(3):
        picture(new("llff") / "garden" / "images" / f"{number}.png", number)
    np.save(root / "llff" / "garden" / "poses_bounds.npy", np.stack([np.concatenate([row.ravel(), [1.0, 9.0]])] * 3))
    cases["llff"] = Case(("garden/poses_bounds.npy", "garden/images/0.png"), CHECK)
    poses = np.tile(np.eye(4), (3, 1, 1))
    lenses = np.tile(np.array([[40.0, 0, 24], [0, 40, 18], [0, 0, 1]]), (3, 1, 1))
    colors = np.zeros((4, 3), np.uint8)
    model = colmap.pinhole_model([f"{n}.png" for n in range(3)], [(36, 48)] * 3, lenses, poses, np.ones((4, 3)), colors)
    for suffix in ("bin", "txt"):
        shutil.copytree(root / "llff" / "garden" / "images", new(f"colmap_{suffix}") / "garden" / "images")
        colmap.write(model, root / f"colmap_{suffix}" / "garden" / "sparse" / "0", binary=suffix == "bin")
        files = tuple(f"garden/sparse/0/{name}.{suffix}" for name in ("cameras", "images"))
        cases[f"colmap_{suffix}"] = Case(files, CHECK)
    Re10kScenes.example(new("re10k"))
    cases["re10k"] = Case(("train/index.json", "train/0.torch"), CHECK)
    images = tuple(f"{number}.{suffix}" for number, suffix in enumerate(("png", "jpg", "webp", "tif", "bmp", "gif")))
    for number, name in enumerate(images):
        picture(new("styles") / name, number)
    (root / "styles" / "captions.jsonl").write_text('{"image": "0.png", "text": "ink"}\n')
    cases["styles"] = Case((*images, "captions.jsonl"), CHECK)
    WikiArtStyles.example(new("wikiart"))
    (root / "wikiart" / "wikiarts_test_files.txt").write_text("Op_Art/b.jpg\n")
    cases["wikiart"] = Case(("wikiarts_descriptions.txt", "wikiarts_test_files.txt"), CHECK)
    write_video([torch.rand(3, 32, 48) for _ in range(4)], new("video") / "clip.mp4", fps=4)
    picture(root / "video" / "style.jpg", 9)
    words = ("stylize", "clip.mp4", "--image", "style.jpg", *TINY)
    cases["video"] = Case(("clip.mp4", "style.jpg"), words)
    judged = new("judged")
    for frame in range(2):
        picture(judged / "content" / "one" / f"{frame}.png", frame)
        picture(judged / "stylized" / "one" / f"ink_{frame}.png", 5 + frame)
        (judged / "depth" / "one").mkdir(parents=True, exist_ok=True)
        np.save(judged / "depth" / "one" / f"{frame}.npy", np.full((36, 48), 2.0, np.float32))
    picture(judged / "style" / "ink.png", 8)
    cameras = Cameras(torch.eye(4).expand(1, 2, 4, 4), torch.eye(3).expand(1, 2, 3, 3) * 30, (36, 48))
    comparisons.write_cameras(judged / "depth" / "one" / "cameras.npz", ["0", "1"], cameras)
    words = (
        "evaluate", "--content", "content", "--style", "style", "--stylized", "stylized", "--depth", "depth",
        "--out", "out", "metric=[psnr,color_match]",
    )  # fmt: skip
    files = ("depth/one/cameras.npz", "depth/one/0.npy", "content/one/1.png", "style/ink.png")
    cases["judged"] = Case(files, words)
    figures = {
        "psnr": 20.5,
        "provenance": {"n": 2, "better": {"psnr": "higher"}, "stand_ins": {}, "protocol": "folders", "seconds": 1.0},
    }
    for number in range(2):
        job = root / "report" / "sweep" / str(number)
        (job / ".hydra").mkdir(parents=True)
        (job / "metrics.json").write_text(json.dumps(figures))
        (job / ".hydra" / "overrides.yaml").write_text(f"- seed={number}\n- placement=head\n")
    (root / "report" / "sweep" / "multirun.yaml").write_text("hydra:\n  overrides:\n    task:\n    - seed=0,1\n")
    files = ("sweep/0/metrics.json", "sweep/1/.hydra/overrides.yaml", "sweep/multirun.yaml")
    cases["report"] = Case(files, ("report", "sweep", "--out", "out"))
    bundled = SHARED / "plugins" / "tiny" / "anystyle_tiny" / "assets" / "tiny_branch.safetensors"
    shutil.copyfile(bundled, new("branch") / "copy.safetensors")
    cases["branch"] = Case(("copy.safetensors",), ("weights", "verify", "copy.safetensors"))
    torch.save({"features.0.weight": torch.zeros(64, 3, 11, 11)}, new("pickle") / "net.pt")
    cases["pickle"] = Case(("net.pt",), ("weights", "verify", "net.pt"))
    plugin = new("plugin")
    entry = '[project]\nname = "mine"\n[project.entry-points."anystyle.loss"]\nmine = "mine:Mine"\n'
    (plugin / "pyproject.toml").write_text(entry)
    (plugin / "mine").mkdir()
    (plugin / "mine" / "__init__.py").write_text("class Mine: pass\n")
    table = '[mine_a]\nfile = "a.pt"\npurpose = "nothing"\nlicense = "MIT"\nsource = "nowhere"\n'
    (plugin / "mine" / "weights.toml").write_text(table)
    files = ("pyproject.toml", "mine/weights.toml")
    cases["plugin"] = Case(files, ("weights", "list"), (("ANYSTYLE_PLUGINS", "."),))
    new("train")
    cases["train"] = Case(
        (), ("train", *(word for word in RECONSTRUCTION if "max_steps" not in word), "trainer.max_steps=1")
    )
    draw = torch.Generator().manual_seed(0)
    parts = [torch.rand(1, 20, *shape, generator=draw) for shape in ((3,), (4,), (3,), (), (4, 3))]
    Gaussians(*parts).save(new("splat") / "binary.ply")
    PlyData(PlyData.read(root / "splat" / "binary.ply").elements, text=True).write(new("splat_text") / "text.ply")
    cases["splat"] = Case(("binary.ply",), ("export", "binary.ply", "--out", "out.glb"))
    for name in ("glb", "sog", "spz", "usda", "usdc"):
        export(Gaussians(*parts), new(name) / f"scene.{name}", name)
        cases[name] = Case((f"scene.{name}",), ("export", f"scene.{name}", "--out", "out.ply"))
    cases["splat_text"] = Case(("text.ply",), ("export", "text.ply", "--out", "out.glb"))
    return cases


# Damage

DEEP = b"[" * 10_000
BOMB = b"a: &a [x, x]\n" + b"".join(b"%c: &%c [*%c, *%c]\n" % (i + 1, i + 1, i, i) for i in range(97, 119))
VAST = b"\x93NUMPY\x01\x00v\x00{'descr': '<f8', 'fortran_order': False, 'shape': (9999999999, 17)}"
FOREIGN = (
    b"", b"\0" * 64, b"null", b"[]", b"{}", b"3", b'"text"', b"\xff\xfe\xfa", b"%!PS-Adobe-3.0 EPSF-3.0\n", DEEP, BOMB,
    VAST, b'{"a":' * 10_000, b"PK\x03\x04", b"\x80\x04N.", b"a: !!python/object/apply:os.system [x]", b"- " * 10_000,
    b"a = " + DEEP, b"1e999", b"NaN", b"<svg/>", b"\xef\xbb\xbf{}",
)  # fmt: skip
VALUES: tuple[Any, ...] = (
    None, True, 0, -1, 1 << 70, 10**400, 1e308, "", "a", "../../../x", "\ud7ff", "${oc.env:HOME}", "=1+1", [], {},
    [[]], [None], {"a": None}, {"_target_": "os.system"}, float("nan"), float("inf"),
)  # fmt: skip
WORDS = ("nan", "inf", "-1", "1e999", "9" * 400, "", "../../x", "null", "[", '"', "\0", "é" * 9000, "0x1", "- ")


def cut(draw: random.Random, data: bytes, suffix: str) -> bytes:
    """The file ends early."""
    return data[: draw.randrange(len(data) + 1)]


def flip(draw: random.Random, data: bytes, suffix: str) -> bytes:
    """Some bytes differ."""
    changed = bytearray(data)
    for _ in range(draw.choice((1, 2, 8, 64))):
        if changed:
            changed[draw.randrange(len(changed))] = draw.choice((0, 255, draw.randrange(256)))
    return bytes(changed)


def splice(draw: random.Random, data: bytes, suffix: str) -> bytes:
    """A part is repeated or missing."""
    start, end = sorted(draw.randrange(len(data) + 1) for _ in range(2))
    return data[:end] + data[start:] if draw.random() < 0.5 else data[:start] + data[end:]


def foreign(draw: random.Random, data: bytes, suffix: str) -> bytes:
    """The content of another kind of file."""
    return draw.choice(FOREIGN)


def value(draw: random.Random, data: bytes, suffix: str) -> bytes:
    """A value of a document is of another type, infinite, huge or missing."""
    if suffix not in (".json", ".yaml", ".jsonl"):
        return flip(draw, data, suffix)
    document = [yaml.safe_load(data)]
    nodes = list(_nodes(document))
    node, key = draw.choice(nodes)
    if draw.random() < 0.2 and node is not document:
        del node[key]
    else:
        node[key] = draw.choice(VALUES)
    return json.dumps(document[0]).encode("utf-8", "surrogatepass")


def _nodes(node: Any) -> list[tuple[Any, Any]]:
    items = list(node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ())
    return [(node, key) for key, _ in items] + [place for _, part in items for place in _nodes(part)]


def word(draw: random.Random, data: bytes, suffix: str) -> bytes:
    """A word or a number of a text, or of a PLY file's header, is another."""
    if suffix not in (".txt", ".csv", ".toml", ".yaml", ".json", ".jsonl", ".ply"):
        return splice(draw, data, suffix)
    head, end, rest = data.partition(b"end_header\n")
    mark = draw.choice([mark for mark in b" ,;=\"\n:[]{}'" if mark in head] or [32])
    parts = head.split(bytes([mark]))
    parts[draw.randrange(len(parts))] = draw.choice(WORDS).encode()
    return bytes([mark]).join(parts) + end + rest


def array(draw: random.Random, data: bytes, suffix: str) -> bytes:
    """An array of another shape, type or value."""
    if suffix != ".npy":
        return foreign(draw, data, suffix)
    values = np.load(BytesIO(data))
    options: list[Any] = [
        values[:0], values[..., :1], values.ravel(), values[None], values * np.nan, values + np.inf, -values,
        values.astype(np.complex64), values.astype("U8"), values.astype(bool), values.astype("M8[s]"),
        values.astype([("a", "f8")]), values.astype(np.float16),
        values.astype(">f8"), np.array([None, 1], object), np.zeros((0, 0)), np.float64(3),
    ]  # fmt: skip
    buffer = BytesIO()
    np.save(buffer, draw.choice(options), allow_pickle=True)
    return buffer.getvalue()


def tensors(draw: random.Random, data: bytes, suffix: str) -> bytes:
    """A tensor of another layout, type, size or value."""
    if suffix not in (".pt", ".torch"):
        return array(draw, data, suffix)
    content = torch.load(BytesIO(data), weights_only=True)
    holders = [holder for holder, key in _nodes([content]) if isinstance(holder[key], torch.Tensor)]
    holder = draw.choice(holders)
    key = draw.choice(list(holder if isinstance(holder, dict) else range(len(holder))))
    tensor = holder[key] if isinstance(holder[key], torch.Tensor) else torch.zeros(3, 18)
    options: list[Callable[[], Any]] = [
        tensor.to_sparse, lambda: tensor.to("meta"), lambda: tensor + 1j, lambda: tensor.bool(), lambda: tensor * 0,
        lambda: tensor.half() / 0, lambda: torch.zeros(1).expand(1 << 40), lambda: tensor.ravel(), lambda: tensor[:0],
        lambda: torch.quantize_per_tensor(tensor.float(), 0.1, 0, torch.qint8), lambda: -tensor.float(),
        lambda: tensor.to(torch.float8_e4m3fn), lambda: tensor.double(), lambda: None, lambda: "a",
    ]  # fmt: skip
    holder[key] = draw.choice(options)()
    buffer = BytesIO()
    torch.save(content, buffer)
    return buffer.getvalue()


NAMES = (
    b"photo\xb2", "photo²".encode(), "²".encode(), "1²".encode(), "①".encode(), "٣".encode(), b"\xff\xfe", b"a\xe9b",
    "é".encode(), b" ", b"-", b"a=b", b"9" * 200, b"<b>", b"'\"", b"\n", b"${x}", b"~x",
)  # fmt: skip
"""What files may be called, in bytes."""


def rename(draw: random.Random, path: Path) -> None:
    """A file of another name beside the file, a link in a circle, a folder, a pipe or nothing in its place."""
    kind = draw.choice(("name", "name", "name", "loop", "folder", "gone", "locked"))
    if kind == "name":
        shutil.copyfile(path, path.with_name(os.fsdecode(draw.choice(NAMES)) + path.suffix))
    elif kind == "locked":
        path.chmod(0)
    else:
        path.unlink()
    if kind == "loop":
        path.symlink_to(path.name)
    elif kind == "folder":
        path.mkdir()


OPTIONS = (
    "training.batch_size", "workers", "trainer.max_steps", "trainer.val_check_interval", "training.context_views",
    "training.target_views", "training.warmup", "training.render_every", "training.learning_rate", "scenes.num_scenes",
    "scenes.samples", "scenes.size", "validation_steps", "checkpoint.every_steps", "checkpoint.every_minutes",
    "average", "explosion", "seed", "backbone", "loss", "hydra.launcher._target_", "hydra.run.dir", "hydra",
    "training.heights",
)  # fmt: skip
WRITTEN = (
    "0", "-1", "nan", "inf", "-inf", "1e999", "99999", "9" * 30, "null", "", "[]", "[1", "{a:1}", "'", "${nope}", "${",
    "a", "true", "os.system", "[[1]]", "[0,0]", "[-1,2]", "[nan,1]", "0.5", "\udcff", "range(1,2,0)", "???", "²", "~",
)  # fmt: skip


def option(draw: random.Random, words: tuple[str, ...]) -> tuple[str, ...]:
    """The command with one option more, of any value."""
    return (*words, draw.choice(("", "", "", "+", "++", "~")) + f"{draw.choice(OPTIONS)}={draw.choice(WRITTEN)}")


MUTATORS: tuple[Callable[[random.Random, bytes, str], bytes], ...] = (
    cut,
    flip,
    splice,
    foreign,
    value,
    word,
    array,
    tensors,
)

REGRESSIONS: tuple[tuple[str, str, bytes], ...] = (
    ("transforms", "garden/transforms.json", DEEP),
    ("transforms", "garden/transforms.json", b'{"w": 48, "h": 36, "fl_x": 0, "frames": []}'),
    ("transforms", "garden/images/1.png", b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n(x) = {} loop\n"),
    ("transforms", "garden/images/1.png", b"P6\n9999999 9999999\n255\n"),
    ("llff", "garden/poses_bounds.npy", VAST),
    ("colmap_bin", "garden/sparse/0/cameras.bin", b"\xff" * 64),
    ("colmap_txt", "garden/sparse/0/images.txt", b"1 nan 0 0 0 0 0 0 1 a.png\n\n"),
    ("re10k", "train/index.json", b'{"clip": "../../0.torch"}'),
    ("re10k", "train/0.torch", b"\x80\x02cos\nsystem\nX\x01\x00\x00\x00x\x85R."),
    ("report", "sweep/0/metrics.json", b'{"psnr": 1e400, "n": [' + b"9" * 400 + b"]}"),
    ("report", "sweep/1/.hydra/overrides.yaml", BOMB),
    ("branch", "copy.safetensors", b"\xff" * 64),
    ("plugin", "pyproject.toml", b"a = " + DEEP),
    ("splat", "binary.ply", b"ply\nformat ascii 1.0\nelement vertex 99999999999\nproperty float x\nend_header\n"),
)
"""A case, a file of it, and a content of which reading once ended badly."""
