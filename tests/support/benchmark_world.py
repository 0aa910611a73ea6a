"""A track of small scenes and styles, and results of methods that show what a metric should see, for the tests."""

import json
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
import torch
from PIL import Image
from scipy.ndimage import gaussian_filter

from anystyle.evaluation.comparisons import write_cameras
from anystyle.io.atomic import write_json
from anystyle.types import Cameras
from anystyle_benchmark.results import Cell, Record, bind
from anystyle_benchmark.spec import Spec
from anystyle_benchmark.track import Inputs, SceneEntry, StyleEntry
from tests.support.pictures import save

HEIGHT, WIDTH = 48, 64
STEP, DEPTH, FOCAL = 4, 4.0, 60.0
"""Pixels by which a view is beside the one before; depth of the plane that scenes are, and focal length in pixels."""
METRICS = {
    "image": ("color_match", "style_retrieval", "kid", "warp_consistency"),
    "text": ("warp_consistency", "clip_style"),
}
TEXTS = ("thick strokes in deep blue", "red chalk")
METHODS = ("unstyled", "noise", "pasted", "palette")
"""The photographs themselves, noise, the style pasted over every view, and the photographs in the style's colours."""


def write_track(
    root: Path, *, scenes: int = 3, views: int = 4, images: int = 4, texts: int = 2, metrics: dict | None = None
) -> Path:
    """A track's file with its inputs beside it; all scenes but the last have geometry, views differ by a shift."""
    lines = ['name = "small"', "version = 1", 'about = "Planes in flat light."', f"short_side = {HEIGHT}"]
    for number in range(scenes):
        name, folder = f"scene{number}", root / "scenes" / f"scene{number}"
        plane = _texture((2 * HEIGHT, 2 * (WIDTH + STEP * views)), seed=number)
        stems = [f"{view:03d}" for view in range(views)]
        for view, stem in enumerate(stems):
            save(folder / f"{stem}.png", plane[:, 2 * STEP * view : 2 * (STEP * view + WIDTH)])
        lines += ["[[scenes]]", f'name = "{name}"', f'photographs = "scenes/{name}"', f"views = {json.dumps(stems)}"]
        if number < scenes - 1 or scenes == 1:
            _write_geometry(root / "geometry" / name, stems)
            lines.append(f'geometry = "geometry/{name}"')
    for number in range(images):
        save(root / "styles" / f"image{number}.png", _texture((60, 50), seed=100 + number, sigma=1 + number))
        lines += ["[[styles]]", f'name = "image{number}"', f'image = "styles/image{number}.png"']
    for number in range(texts):
        lines += ["[[styles]]", f'name = "text{number}"', f"text = {json.dumps(TEXTS[number])}"]
    lines += ["[metrics]", *(f"{guide} = {json.dumps(names)}" for guide, names in (metrics or METRICS).items())]
    path = root / "track.toml"
    path.write_text("\n".join(lines) + "\n")
    return path


def write_results(track: Path, root: Path, methods: Sequence[str] = METHODS, *, seeds: int = 1) -> Inputs:
    """Results of these methods in all styles; only ``noise`` has more than one seed."""
    inputs = Inputs(str(track))
    bind(inputs, root)
    for method in methods:
        count = seeds if method == "noise" else 1
        spec = Spec(method, title=method.title(), guides=("image", "text"), baseline=True, seeds=count, preset=("x=y",))
        write_json(root / method / "method.json", msgspec.to_builtins(spec))
        for seed in range(count):
            for scene in inputs.track.scenes:
                for style in inputs.track.styles:
                    write_cell(inputs, root, Cell(method, seed, scene.name, style.name))
    return inputs


def write_cell(inputs: Inputs, root: Path, cell: Cell) -> None:
    """The images and the record of one cell."""
    scene, style = inputs.scene(cell.scene), inputs.style(cell.style)
    random = np.random.default_rng([cell.seed, *cell.scene.encode(), *cell.style.encode()])
    for view in scene.views:
        save(cell.images(root) / f"{view}.png", _painted(inputs, cell.method, scene, style, view, random))
    write_json(cell.record(root), msgspec.to_builtins(Record("done", seconds=2.0, scene_seconds=6.0, memory=100.0)))


def _painted(
    inputs: Inputs, method: str, scene: SceneEntry, style: StyleEntry, view: str, random: np.random.Generator
) -> np.ndarray:
    if method == "noise":
        return random.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    photograph = _resized(inputs.photographs(scene)[view])
    painting = (
        _texture((HEIGHT, WIDTH), seed=sum(style.name.encode()))
        if style.image is None
        else _resized(inputs.path(style.image))
    )
    if method == "pasted":
        return painting
    if method == "palette":
        standard = (photograph - photograph.mean((0, 1))) / photograph.std((0, 1))
        return np.clip(standard * painting.std((0, 1)) + painting.mean((0, 1)), 0, 255).astype(np.uint8)
    return photograph


def _texture(shape: tuple[int, int], seed: int, sigma: float = 3.0) -> np.ndarray:
    """A smooth random picture, 8-bit RGB, of its seed's colours."""
    random = np.random.default_rng(seed)
    waves = gaussian_filter(random.normal(size=(*shape, 3)), (sigma, sigma, 0))
    mixing, mean = random.normal(0, 0.13, (3, 3)), random.uniform(0.25, 0.75, 3)
    return (255 * np.clip(waves / waves.std() @ mixing + mean, 0, 1)).astype(np.uint8)


def _write_geometry(folder: Path, stems: Sequence[str]) -> None:
    folder.mkdir(parents=True)
    depth = np.full((HEIGHT, WIDTH), DEPTH, np.float32)
    np.savez_compressed(folder / "depth.npz", allow_pickle=False, **dict.fromkeys(stems, depth))
    poses = torch.eye(4).repeat(1, len(stems), 1, 1)
    poses[0, :, 0, 3] = torch.arange(len(stems)) * STEP * DEPTH / FOCAL
    camera = torch.tensor([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    cameras = Cameras(poses, camera.repeat(1, len(stems), 1, 1), (HEIGHT, WIDTH))
    write_cameras(folder / "cameras.npz", stems, cameras)


def _resized(path: Path) -> np.ndarray:
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB").resize((WIDTH, HEIGHT), Image.Resampling.LANCZOS))
