"""Valid inputs of every kind, and for each file of them the commands that read it."""

import csv
import io
import json
import logging
import shutil
import sqlite3
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import msgspec
import numpy as np
import torch
from omegaconf import OmegaConf
from PIL import Image
from plyfile import PlyData, PlyElement
from study_cases import small_plan, write_results

from anystyle.commands._study_options import read_plan
from anystyle.data.re10k import Re10kScenes
from anystyle.data.scene_folder import FolderScenes
from anystyle.data.wikiart import WikiArtStyles
from anystyle.evaluation import folders
from anystyle.io import colmap
from anystyle.io.video import write_video
from anystyle.paths import SHARED
from anystyle.study.design import design
from anystyle.training.run import train
from anystyle.types import Cameras, Gaussians
from training_cases import RECONSTRUCTION, configuration

SMALL = ("views.short_side=28", "views.take=2", "video.frames=1", "video.scale=0.2", "reconstruction=feedforward")
_ANALYZE = ("--out", "out", "--resamples", "99", "--no-report", "--test", "wilcoxon")
TINY = ("model=tiny", "poses=predicted", *SMALL)


@dataclass(frozen=True)
class Case:
    """A folder of valid files, one of which is damaged at a time.

    Args:
        files: Those that may be damaged, below the case's folder.
        words: The command that reads them, run in that folder.
        weight: How often the case is drawn.
        environment: Variables that the command is given.
    """

    files: tuple[str, ...]
    words: tuple[str, ...]
    weight: int = 4
    environment: tuple[tuple[str, str], ...] = ()


def picture(path: Path, seed: int = 0, size: tuple[int, int] = (48, 36), **options: object) -> None:
    """A small picture of noise."""
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = np.random.default_rng(seed).integers(0, 255, (size[1], size[0], 3), np.uint8)
    Image.fromarray(pixels).save(path, **options)  # type: ignore[arg-type]


def write(root: Path) -> dict[str, Case]:
    """Write every case into a folder of its name."""
    cases: dict[str, Case] = {}
    for make in (
        _captures,
        _styles,
        _judged,
        _runs,
        _studies,
        _weights,
        _plugins,
        _configurations,
        _plans,
        _splats,
        _states,
    ):
        cases |= make(root)
    return cases


def _captures(root: Path) -> dict[str, Case]:
    cases = {}
    FolderScenes.example(_new(root / "transforms"))
    cases["transforms"] = Case(("garden/transforms.json", "garden/images/1.png"), ("data", "check", "."))
    _llff(root / "llff" / "garden")
    cases["llff"] = Case(("garden/poses_bounds.npy", "garden/images/0.png"), ("data", "check", "."))
    for kind, binary in (("colmap_binary", True), ("colmap_text", False)):
        folder = root / kind / "garden"
        names = _photographs(folder / "images")
        lenses = np.tile(np.array([[40.0, 0, 24], [0, 40, 18], [0, 0, 1]]), (3, 1, 1))
        poses = np.tile(np.eye(4), (3, 1, 1))
        poses[:, 0, 3] = [0, 0.1, 0.2]
        colors = np.zeros((4, 3), np.uint8)
        model = colmap.pinhole_model(names, [(36, 48)] * 3, lenses, poses, np.ones((4, 3)), colors)
        colmap.write(model, folder / "sparse" / "0", binary=binary)
        suffix = "bin" if binary else "txt"
        files = tuple(f"garden/sparse/0/{name}.{suffix}" for name in ("cameras", "images"))
        cases[kind] = Case(files, ("data", "check", "."))
    Re10kScenes.example(_new(root / "re10k"))
    cases["re10k"] = Case(("train/index.json", "train/0.torch"), ("data", "check", "."))
    FolderScenes.example(_new(root / "index"))
    (root / "index" / "train_index.json").write_text('["garden"]')
    cases["index"] = Case(("train_index.json",), ("data", "check", "."))
    _photographs(root / "photographs")
    picture(root / "photographs" / "style.jpg", 9)
    write_video([torch.rand(3, 32, 48) for _ in range(4)], root / "photographs" / "clip.mp4", fps=4)
    for name, words in {
        "photographs": ("0.png", "1.png", "2.png", "--image", "style.jpg"),
        "video": ("clip.mp4", "--image", "style.jpg"),
    }.items():
        _copy(root / "photographs", root / name)
        file = "1.png" if name == "photographs" else "clip.mp4"
        cases[name] = Case((file, "style.jpg"), ("stylize", *words, "--out", "out", *TINY), 1)
    return cases


def _styles(root: Path) -> dict[str, Case]:
    for name in ("captions", "pictures"):
        folder = _new(root / name)
        for number, suffix in enumerate(("png", "jpg", "webp", "tif", "bmp", "gif")):
            picture(folder / f"{number}.{suffix}", number)
        (folder / "captions.jsonl").write_text('{"image": "0.png", "text": "ink"}\n{"image": "1.jpg", "text": "oil"}\n')
    WikiArtStyles.example(_new(root / "wikiart"))
    (root / "wikiart" / "wikiarts_test_files.txt").write_text("Op_Art/b.jpg\n")
    return {
        "captions": Case(("captions.jsonl",), ("data", "check", ".")),
        "pictures": Case(
            tuple(f"{number}.{suffix}" for number, suffix in enumerate(("png", "jpg", "webp", "tif", "bmp", "gif"))),
            ("data", "check", "."), 6,
        ),
        "wikiart": Case(("wikiarts_descriptions.txt", "wikiarts_test_files.txt"), ("data", "check", ".")),
    }  # fmt: skip


def _judged(root: Path) -> dict[str, Case]:
    folder = _new(root / "judged")
    for frame in range(2):
        picture(folder / "content" / "one" / f"{frame}.png", frame)
        picture(folder / "stylized" / "one" / f"ink_{frame}.png", 5 + frame)
        _new(folder / "depth" / "one")
        np.save(folder / "depth" / "one" / f"{frame}.npy", np.full((36, 48), 2.0, np.float32))
    picture(folder / "style" / "ink.png", 8)
    cameras = Cameras(torch.eye(4).expand(1, 2, 4, 4), torch.eye(3).expand(1, 2, 3, 3) * 30, (36, 48))
    folders.write_cameras(folder / "depth" / "one" / "cameras.npz", ["0", "1"], cameras)
    words = (
        "evaluate", "--content", "content", "--style", "style", "--stylized", "stylized", "--depth", "depth",
        "metric=[psnr,color_match]", "--out", "out",
    )  # fmt: skip
    return {
        "judged": Case(
            ("depth/one/cameras.npz", "depth/one/0.npy", "content/one/1.png", "style/ink.png", "out/bound.json"),
            words,
            2,
        )
    }


def _runs(root: Path) -> dict[str, Case]:
    figures = {
        "psnr": 20.5, "scene one": {"psnr": 20.5},
        "provenance": {"n": 2, "better": {"psnr": "higher"}, "stand_ins": {}, "protocol": "folders", "seconds": 1.0,
                       "scenes": ["one"], "warnings": [], "machine": "a machine", "variant": "reference"},
    }  # fmt: skip
    folder = _new(root / "runs")
    for number in range(2):
        job = _new(folder / "sweep" / str(number))
        (job / "metrics.json").write_text(json.dumps(figures))
        _new(job / ".hydra")
        (job / ".hydra" / "overrides.yaml").write_text(f"- seed={number}\n- placement=head\n")
    (folder / "sweep" / "multirun.yaml").write_text("hydra:\n  overrides:\n    task:\n    - seed=0,1\n")
    _new(folder / "trained")
    (folder / "trained" / "metrics.json").write_text('{"train/loss": 0.5, "val/psnr": 12.0}')
    rows = {"sources": {"a": "a paper"}, "rows": [
        {"method": "m", "source": "a", "table": "1", "figures": {"psnr": {"one": "20.5"}}}]}  # fmt: skip
    (folder / "rows.json").write_text(json.dumps(rows))
    for name in ("report", "published"):
        _copy(folder, root / name)
    return {
        "report": Case(
            ("sweep/0/metrics.json", "sweep/1/.hydra/overrides.yaml", "sweep/multirun.yaml", "trained/metrics.json"),
            ("report", "sweep", "trained", "--out", "out"), 5,
        ),
        "published": Case(("rows.json",), ("report", "trained", "--published", "rows.json", "--out", "out")),
    }  # fmt: skip


def _studies(root: Path) -> dict[str, Case]:
    folder = _new(root / "study")
    study = design(write_results(_new(root / "results"), scenes=2, styles=2), small_plan(), folder / "study")
    rows = [
        {"study": study.id, "participant": person.id, "item": item, "question": question.name, "side": side,
         "score": 1 + index % 3, "seconds": 2.5, "comment": "=1+1"}
        for person in study.participants
        for index, item in enumerate(person.order)
        for question in study.plan.questions
        for side in question.sides
    ]  # fmt: skip
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]))
    writer.writeheader()
    writer.writerows(rows)
    (folder / "answers.csv").write_text(text.getvalue())
    (folder / "answers.json").write_text(json.dumps({"responses": rows}))
    with sqlite3.connect(folder / "answers.sqlite") as database:
        database.execute(f"CREATE TABLE responses ({', '.join(rows[0])})")
        database.executemany(f"INSERT INTO responses VALUES (:{', :'.join(rows[0])})", rows)
    analyze = ("--study", "study", "--out", "out", "--no-report", "--test", "wilcoxon")
    cases = {
        f"answers_{suffix}": Case((f"answers.{suffix}",), ("study", "analyze", f"answers.{suffix}", *analyze), 3)
        for suffix in ("csv", "json", "sqlite")
    }
    cases["study"] = Case(("study/study.json",), ("study", "analyze", "answers.csv", *analyze))
    for name in cases:
        _copy(folder, root / name)
    return cases


def _weights(root: Path) -> dict[str, Case]:
    bundled = SHARED / "plugins" / "tiny" / "anystyle_tiny" / "assets"
    folder = _new(root / "weights")
    for name in ("tiny_style_encoder", "tiny_branch", "tiny_backbone"):
        (folder / f"{name}_copy.safetensors").write_bytes((bundled / f"{name}.safetensors").read_bytes())
    torch.save({"features.0.weight": torch.zeros(64, 3, 11, 11)}, folder / "net.pt")
    return {
        f"weights_{name}": Case((name,), ("weights", "verify", name), 3)
        for name in ("tiny_style_encoder_copy.safetensors", "tiny_branch_copy.safetensors", "net.pt")
        if _copy(folder, root / f"weights_{name}")
    }


def _plugins(root: Path) -> dict[str, Case]:
    folder = _new(root / "plugins")
    (folder / "pyproject.toml").write_text(
        '[project]\nname = "mine"\n[project.entry-points."anystyle.loss"]\nmine = "mine:Mine"\n'
    )
    _new(folder / "mine")
    (folder / "mine" / "__init__.py").write_text("class Mine: pass\n")
    row = {"file": "a.pt", "purpose": "nothing", "license": "MIT", "source": "nowhere"}
    (folder / "mine" / "weights.toml").write_text("[mine_a]\n" + "".join(f'{k} = "{v}"\n' for k, v in row.items()))
    return {
        "plugins": Case(("pyproject.toml", "mine/weights.toml"), ("weights", "list"), 4, (("ANYSTYLE_PLUGINS", "."),)),
        "plugin_list": Case(("pyproject.toml",), ("plugins", "loss"), 2, (("ANYSTYLE_PLUGINS", "."),))
        if _copy(folder, root / "plugin_list") else Case((), ()),
    }  # fmt: skip


def _configurations(root: Path) -> dict[str, Case]:
    folder = _new(root / "configuration")
    _new(folder / "conf" / "model")
    (folder / "conf" / "model" / "mine.yaml").write_text(
        "# @package _global_\nseed: 3\nviews:\n  take: 2\nhydra:\n  job:\n    chdir: false\n"
    )
    words = ("stylize", "nothing", "--text", "a", "--out", "out", "-cd", "conf", "model=mine", "--cfg", "job")
    return {"configuration": Case(("conf/model/mine.yaml",), words, 4)}


def _plans(root: Path) -> dict[str, Case]:
    folder = _new(root / "plan")
    plan = read_plan(["study=paper", "participants=4"])
    (folder / "mine.yaml").write_text(OmegaConf.to_yaml(OmegaConf.create(msgspec.to_builtins(plan))))
    return {"plan": Case(("mine.yaml",), ("study", "design", "--show", "study=mine.yaml"), 3)}


def _splats(root: Path) -> dict[str, Case]:
    """Binary, in text, and compressed."""
    generator = torch.Generator().manual_seed(0)
    draw = partial(torch.rand, generator=generator)
    scene = Gaussians(draw(1, 20, 3), draw(1, 20, 4), draw(1, 20, 3), draw(1, 20), draw(1, 20, 4, 3))
    folder = _new(root / "splats")
    scene.save(folder / "binary.ply")
    data = PlyData.read(folder / "binary.ply")
    PlyData(data.elements, text=True).write(folder / "text.ply")
    names = [f"{bound}_{part}" for part in ("x", "y", "z", "scale_x", "scale_y", "scale_z") for bound in ("min", "max")]
    chunk = np.array([(0.0, 1.0) * 6], [(name, "f4") for name in names])
    packed = [f"packed_{part}" for part in ("position", "rotation", "scale", "color")]
    words = np.random.default_rng(0).integers(0, 1 << 32, (20, 4), np.uint32)
    vertex = words.view([(name, "u4") for name in packed])[:, 0]
    elements = [PlyElement.describe(chunk, "chunk"), PlyElement.describe(vertex, "vertex")]
    PlyData(elements).write(folder / "compressed.ply")
    cases = {}
    for kind in ("binary", "text", "compressed"):
        _copy(folder, root / f"splat_{kind}")
        cases[f"splat_{kind}"] = Case((f"{kind}.ply",), ("export", f"{kind}.ply", "--out", "out.glb"), 3)
    return cases


def _states(root: Path) -> dict[str, Case]:
    """A training that came to its end but for its figures, and goes on from its last state."""
    words = [word for word in RECONSTRUCTION if "max_steps" not in word]
    words += ["trainer.max_steps=4", "checkpoint.every_steps=2", "scenes.num_scenes=1", "trainer.precision=32-true"]
    out = root / "state" / "runs" / "test"
    logging.getLogger("lightning.pytorch").setLevel(logging.ERROR)
    train(configuration(words, out), out)
    (out / "metrics.json").unlink()
    for path in (*out.glob("log*"), *out.glob(".hydra")):
        shutil.rmtree(path, ignore_errors=True)
    files = tuple(f"runs/test/{name}" for name in ("last.ckpt", "bound.json"))
    _copy(root / "state", root / "states")
    (root / "states" / "runs" / "test" / "last.ckpt").write_bytes(b"torn")
    return {
        "state": Case(files, ("train", *words), 2),
        "states": Case(("runs/test/previous.ckpt",), ("train", *words), 1),
    }


def _photographs(folder: Path) -> list[str]:
    for number in range(3):
        picture(folder / f"{number}.png", number)
    return [f"{number}.png" for number in range(3)]


def _llff(folder: Path) -> None:
    _photographs(folder / "images")
    row = np.concatenate([np.eye(3)[:, [1, 0, 2]] * [1, 1, -1], np.zeros((3, 1)), [[36], [48], [40]]], axis=1)
    np.save(folder / "poses_bounds.npy", np.stack([np.concatenate([row.ravel(), [1.0, 9.0]])] * 3))


def _new(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _copy(source: Path, target: Path) -> bool:
    if source != target:
        shutil.copytree(source, target, dirs_exist_ok=True)
    return True
