"""What the commands of pages find in the folder they run in: photographs, styles, results, data sets, a checkpoint."""

import json
import shutil
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from anystyle.types import Gaussians
from anystyle_datasets.re10k import Re10kScenes
from anystyle_study.protocol import read_study
from tests.support.docs_cases import ROOT, blocks
from tests.support.pictures import save
from tests.support.weights_cases import training_checkpoint

_TRANSFORMS = {"w": 64, "h": 48, "fl_x": 60, "fl_y": 60, "cx": 32, "cy": 24}


def make(folder: Path) -> None:
    """Put everything there that a page speaks of."""
    for number in range(3):
        for scene in ("photos", "SCENES/Train", "PHOTOS/Train", "scenes/one", "scenes/two"):
            _picture(folder / scene / f"{number:03d}.jpg", seed=0, shift=number)
    names = ["painting", "a", "b", "sea", "sky", "styles/s0", "styles/s1", "STYLES/s0", "STYLES/s1", "PAINTINGS/s0"]
    for seed, name in enumerate(names, start=1):
        _picture(folder / f"{name}.jpg", seed=seed)
    for number in range(3):
        _mask(folder / "sky_masks" / f"{number:03d}.png")
    for style, seed in (("s0", 20), ("s1", 21)):
        for frame in range(3):
            for name in (f"results/{style}/{frame:03d}", f"RESULTS/Train/{style}_{frame:03d}"):
                _picture(folder / f"{name}.png", seed=seed, shift=frame)
    _splat(folder / "scene.ply")
    captions = [{"image": f"s{n}.jpg", "text": text} for n, text in enumerate(("red waves", "blue dots"))]
    (folder / "STYLES" / "captions.jsonl").write_text("".join(f"{json.dumps(one)}\n" for one in captions))
    _data_sets(folder)
    torch.manual_seed(0)
    torch.save(training_checkpoint("head"), folder / "anystyle_head.ckpt")
    scores = {"method": "another", "source": "us", "table": "Table 1", "scores": {"art_fid": {"Train": 30.0}}}
    rows = {"about": "Ours.", "sources": {"us": "our own table"}, "rows": [scores]}
    (folder / "rows.json").write_text(json.dumps(rows))


def _splat(path: Path) -> None:
    """A ball of Gaussians, as somebody else wrote it."""
    means = torch.nn.functional.normalize(torch.randn(1, 200, 3, generator=torch.Generator().manual_seed(0)), dim=-1)
    rotations = torch.tensor([1.0, 0.0, 0.0, 0.0]).expand(1, 200, 4)
    opacities, harmonics = torch.full((1, 200), 0.9), torch.zeros(1, 200, 4, 3)
    Gaussians(means, rotations, torch.full((1, 200, 3), 0.1), opacities, harmonics).save(path)


def _data_sets(folder: Path, frames_each: int = 4) -> None:
    scene = folder / "DL3DV-10K" / "1K" / "garden"
    frames = []
    for number in range(frames_each):
        _picture(scene / "images_8" / f"frame_{number:05d}.png", seed=30, shift=number % 8)
        pose = np.eye(4)
        pose[0, 3] = 0.1 * number
        frames.append({"file_path": f"images/frame_{number:05d}.png", "transform_matrix": pose.tolist()})
    (scene / "transforms.json").write_text(json.dumps({**_TRANSFORMS, "frames": frames}))
    (folder / "DL3DV-10K" / "train_index.json").write_text(json.dumps(["1K/garden"]))
    for number in range(2):
        _picture(folder / "wikiart" / "Cubism" / f"painter_{number}.jpg", seed=40 + number)


def of_data(folder: Path) -> None:
    """Data sets as their publishers hand them out."""
    _data_sets(folder, frames_each=33)
    (folder / "DL3DV-10K" / "train_index.json").unlink()
    (folder / "RealEstate10K").mkdir()
    Re10kScenes.example(folder / "RealEstate10K")
    (folder / "styl3r" / "test").mkdir(parents=True)
    shutil.copy(folder / "wikiart/Cubism/painter_0.jpg", folder / "styl3r/test/abstract_0.jpg")
    for style in range(50):
        _picture(folder / "stylos/examples/styles" / f"{style:02d}.jpg", seed=100 + style)


def of_study(folder: Path) -> None:
    """Results of two methods, as a study is designed from."""
    shutil.rmtree(folder / "results")
    for seed, method in ((50, "ours"), (60, "styl3r")):
        for place, name in enumerate(("one/s0", "one/s1", "two/s0", "two/s1")):
            for view in range(3):
                _picture(folder / "results" / method / name / f"{view}.png", seed=seed + place, shift=view)


def answer_study(folder: Path) -> None:
    """The files that all participants of the folder's study save at the end."""
    study = read_study(folder / "study")
    (folder / "answers").mkdir()
    for number, person in enumerate(study.participants):
        rows = [
            {"participant": person.id, "item": item, "question": question.name, "side": side, "score": 1 + place % 5}
            for place, item in enumerate(person.order, start=number)
            for question in study.plan.questions
            for side in question.sides
        ]
        saved = {"study": study.id, "participant": person.id, "responses": rows}
        (folder / "answers" / f"answers-{person.id}.json").write_text(json.dumps(saved))


def of_plugins(folder: Path) -> None:
    """The two files that the page on plugins shows."""
    page = ROOT / "docs" / "add_a_plugin.md"
    (code,) = (text for text in blocks(page, "python") if "class Sparse" in text)
    (folder / "sparse").mkdir()
    (folder / "sparse" / "sparse.py").write_text(code)
    (folder / "sparse" / "pyproject.toml").write_text(blocks(page, "toml")[0])


def _mask(path: Path) -> None:
    """White in the upper third of 64 x 48 pixels."""
    pixels = np.zeros((48, 64), dtype=np.uint8)
    pixels[:16] = 255
    save(path, pixels)


def _picture(path: Path, *, seed: int, shift: int = 0) -> None:
    """A soft picture of 64 x 48 pixels, moved aside by some."""
    path.parent.mkdir(parents=True, exist_ok=True)
    coarse = np.random.default_rng(seed).integers(0, 255, (6, 9, 3), dtype=np.uint8)
    Image.fromarray(coarse).resize((72, 48), Image.Resampling.BICUBIC).crop((shift, 0, shift + 64, 48)).save(path)
