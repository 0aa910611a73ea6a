"""Small works of every command that takes long, and what of their results must not depend on what befell them."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors.torch import load_file

from anystyle.data.images import open_image
from anystyle.io.arrays import read_tensors
from anystyle.io.sheet import to_pil
from anystyle.types import Gaussians
from anystyle_tiny.procedural.scenes import ProceduralScenes
from fuzz.seeds import picture
from training_cases import RECONSTRUCTION, STYLIZATION

SMALL = (
    "model=tiny", "views.short_side=28", "video.frames=2", "video.scale=0.2", "seed=3",
)  # fmt: skip
STEPS = ("checkpoint.every_steps=1", "average=0.9", "export.half=false")


@dataclass(frozen=True)
class Job:
    """A command that works for seconds.

    Args:
        words: After ``anystyle``.
        prepare: Writes its inputs into a folder.
        inputs: What it reads there, as patterns; empty where it makes its own scenes.
        out: Where its results are, below the folder.
    """

    words: tuple[str, ...]
    prepare: Callable[[Path], object] = lambda folder: None
    inputs: str = ""
    out: str = "out"


def _judged(folder: Path) -> None:
    for scene in range(6):
        for frame in range(2):
            picture(folder / "content" / f"s{scene}" / f"{frame}.png", scene, (320, 240))
            for style in range(3):
                picture(folder / "stylized" / f"s{scene}" / f"t{style}_{frame}.png", 9 + scene + style, (320, 240))
    for style in range(3):
        picture(folder / "style" / f"t{style}.png", style)


def _capture(folder: Path) -> None:
    """Renders of a procedural scene as photographs, with their cameras."""
    views = ProceduralScenes(split="heldout", size=56).read(0, range(4))
    assert views.cameras is not None
    frames = []
    for number, image in enumerate(views.images[0]):
        path = folder / "garden" / "images" / f"{number}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        to_pil(image).save(path)
        pose = views.cameras.world_from_camera[0, number].double() @ torch.diag(torch.tensor([1.0, -1, -1, 1]).double())
        frames.append({"file_path": f"images/{number}.png", "transform_matrix": pose.tolist()})
    lens = views.cameras.intrinsics[0, 0]
    names = {"fl_x": (0, 0), "fl_y": (1, 1), "cx": (0, 2), "cy": (1, 2)}
    content = {name: float(lens[at]) for name, at in names.items()} | {"w": 56, "h": 56, "frames": frames}
    (folder / "garden" / "transforms.json").write_text(json.dumps(content))


def _answers(folder: Path) -> None:
    rows = ["participant,item,question,score,ours_is"]
    rows += [f"P{p},S{i},style,{1 + (p * i) % 5},{'AB'[(p + i) % 2]}" for p in range(8) for i in range(6)]
    (folder / "answers.csv").write_text("\n".join(rows) + "\n")


def _runs(folder: Path) -> None:
    for number in range(3):
        (folder / "runs" / str(number)).mkdir(parents=True)
        (folder / "runs" / str(number) / "metrics.json").write_text(json.dumps({"val/psnr": 12.0 + number}))


JOBS = {
    "train": Job(
        ("train", *(word for word in RECONSTRUCTION if "max_steps" not in word), *STEPS, "trainer.max_steps=20"),
        out="runs/test",
    ),
    "train a branch": Job(
        ("train", *(word for word in STYLIZATION if "max_steps" not in word), *STEPS, "trainer.max_steps=12"),
        out="runs/test",
    ),
    "evaluate": Job(
        ("evaluate", "--content", "content", "--style", "style", "--stylized", "stylized", "--out", "out",
         "metric=[psnr,ssim,color_match]"),
        _judged, "s*/*.png",
    ),
    "stylize": Job(
        ("stylize", "garden", *SMALL, "poses=predicted", "reconstruction=feedforward",
         "--text", "ink", "--text", "gold leaf", "--export", "glb,html", "--out", "out"),
        _capture, "garden/images/*.png",
    ),
    "fit": Job(
        ("stylize", "garden", *SMALL, "poses=known", "reconstruction=fit", "reconstruction.quality=draft",
         "reconstruction.num_gaussians=150", "reconstruction.num_steps=60", "reconstruction.state=fit.pt",
         "--text", "ink", "--out", "out"),
        _capture, "garden/images/*.png",
    ),
}  # fmt: skip
"""What is killed."""

QUICK = {
    "report": Job(("report", "runs/0", "runs/1", "runs/2", "--out", "out"), _runs, "runs/*/metrics.json"),
    "analyze": Job(
        ("study", "analyze", "answers.csv", "--test", "wilcoxon", "--out", "out"),
        _answers, "answers.csv",
    ),
}  # fmt: skip
"""What is told to stop, and meets full and read-only disks, beside those."""


def whole(path: Path) -> str:
    """What is wrong with a file under its final name; empty where it can be read."""
    try:
        match path.suffix:
            case ".json":
                json.loads(path.read_bytes())
            case ".png" | ".jpg" | ".webp":
                open_image(path)
            case ".safetensors":
                load_file(path)
            case ".ckpt" | ".pt":
                read_tensors(path)
            case ".ply":
                Gaussians.load(path)
            case ".html":
                assert path.read_text().rstrip().endswith("</html>")
            case ".glb":
                assert int.from_bytes(path.read_bytes()[8:12], "little") == path.stat().st_size
            case ".md" | ".yaml" | ".mp4" | ".svg" | ".tex":
                assert path.stat().st_size
    except Exception as error:
        return f"{path.name}: {type(error).__name__} {error}"[:200]
    return ""


def result(out: Path) -> dict[str, str]:
    """What a finished work comes to: weights, figures, scenes and pictures by name, hashed; records of time aside."""
    contents: dict[str, str] = {}
    for path in sorted(out.rglob("*")):
        name = str(path.relative_to(out))
        if path.name == "metrics.json":
            figures = json.loads(path.read_text())
            for volatile in ("provenance", "train/seconds"):
                figures.pop(volatile, None)
            contents[name] = json.dumps(figures, sort_keys=True)
        elif path.suffix == ".safetensors":
            tensors = load_file(path)
            contents[name] = _hash(b"".join(key.encode() + _bytes(tensors[key]) for key in sorted(tensors)))
        elif "log" in path.parts or path.name == "spread.png":
            continue
        elif path.suffix in (".ply", ".glb", ".png", ".csv") or path.name == "results.md":
            contents[name] = _hash(path.read_bytes())
    return contents


def _bytes(tensor: torch.Tensor) -> bytes:
    return tensor.contiguous().flatten().view(torch.uint8).numpy().tobytes()


def _hash(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]
