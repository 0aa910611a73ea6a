"""The bundled methods: their specs, and what their programs write."""

import json
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from PIL import Image

from anystyle_benchmark.environment import environments
from anystyle_benchmark.run import ask, make_job
from anystyle_benchmark.spec import METHODS, names, read_spec
from anystyle_benchmark.track import Inputs

SIZE = (40, 54)
PAINTINGS = ("starry_night", "wave")


def paint(name: str, folder: Path, named: tuple[str, ...] = PAINTINGS) -> dict[str, np.ndarray]:
    """The images of two views of a real scene in two styles, by ``STYLE/VIEW``."""
    (spec, home), inputs = read_spec(name), Inputs("open")
    scene = inputs.scene("bronze_axe")
    scene = replace(scene, views=scene.views[:2])
    job = make_job(inputs, scene, [inputs.style(style) for style in named], 3, folder / "out")
    ended = ask(replace(job, size=SIZE), spec, home)
    assert not ended.failure, ended.failure
    made = [f"{style}/{view}" for style in named for view in scene.views]
    images = {one: np.asarray(Image.open(folder / "out" / f"{one}.png")) for one in made}
    assert {(image.shape, image.dtype) for image in images.values()} == {((*SIZE, 3), np.dtype(np.uint8))}
    return images


@pytest.mark.parametrize("name", names())
def test_a_spec_reads_and_says_what_it_is(name: str) -> None:
    spec, home = read_spec(name)
    assert spec.name == name and spec.title and spec.about and home == METHODS
    assert spec.preset or spec.command or (spec.not_run and "commit" in spec.code and spec.paper)
    for word in spec.command or ():
        assert "{here}" not in word or Path(word.replace("{here}", str(home))).is_file()


def test_baselines_paint_what_they_are_named_after(tmp_path: Path) -> None:
    images = {}
    for name in ("photographs", "noise", "pasted", "palette_transfer"):
        (tmp_path / name).mkdir()
        images[name] = paint(name, tmp_path / name)
    photographs, noise, pasted, palette = (list(images[name].values()) for name in images)
    assert (photographs[0] == photographs[2]).all() and (photographs[0] != photographs[1]).any()
    assert len({image.tobytes() for image in noise}) == 4 and abs(noise[0].mean() - 127.5) < 3
    assert (pasted[0] == pasted[1]).all() and (pasted[0] != pasted[2]).any()
    painting = Inputs("open").path("example:starry_night")
    target = np.asarray(Image.open(painting).convert("RGB")).reshape(-1, 3)
    # Over the two views together, up to what is clipped.
    moved = np.concatenate([palette[0], palette[1]]).reshape(-1, 3).astype(float)
    assert np.abs(moved.mean(0) - target.mean(0)).max() < 12
    assert np.abs(moved.mean(0) - photographs[0].mean((0, 1))).max() > 60


def test_the_2d_painter_follows_images_and_texts(tmp_path: Path) -> None:
    images = list(paint("two_d", tmp_path, named=("starry_night", "pencil_sketch")).values())
    assert np.abs(images[0].astype(float) - images[2]).mean() > 3
    seconds = json.loads((tmp_path / "out" / "seconds.json").read_text())
    assert set(seconds) == {"scene", "styles"} and len(seconds["styles"]) == 2


@pytest.mark.parametrize("name", ["color_matcher", "pykuwahara"])
def test_a_foreign_package_runs_in_its_own_environment(name: str, tmp_path: Path) -> None:
    requirements = read_spec(name)[0].requirements
    ready = [path.read_text() for path in environments().glob("*/.ready")]
    if "\n".join(sorted(requirements)) not in ready:
        pytest.skip(f"no environment of {name} is here; anystyle benchmark run makes it")
    images = list(paint(name, tmp_path).values())
    assert (images[0] != images[1]).any()
    assert (images[0] == images[2]).all() == (name == "pykuwahara")
