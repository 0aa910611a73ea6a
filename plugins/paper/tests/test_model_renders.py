"""The published protocol: what is written, in which variant, and that nothing is made twice."""

from unittest.mock import patch

import numpy as np
import pytest
import torch
from PIL import Image

from anystyle.contracts import StyleSource
from anystyle.errors import UserError
from anystyle.testing.inputs import images
from anystyle.testing.protocol import runtime
from anystyle.testing.toy.scenes import ToyScenes
from anystyle.types import Style, no_progress
from anystyle.vision.preprocess import middle_square
from anystyle_paper.model_renders import ModelRenders as Paper
from tests.support.evaluation_cases import Mean


@pytest.fixture
def parts():
    parts = runtime()
    return parts | {"metrics": {"mean": Mean()}, "scenes": ToyScenes(num_scenes=2, views=4, size=(32, 40))}


def stems(folder):
    return sorted(path.name for path in folder.iterdir() if not path.name.startswith("."))


def test_what_is_written_and_judged(parts, tmp_path):
    found = Paper(**parts, num_styles=3, frames=2).run(tmp_path, no_progress)
    kept = tmp_path / "images"
    assert stems(kept / "stylized") == ["wall_0000", "wall_0001"]
    assert stems(kept / "stylized" / "wall_0001") == [
        f"{style}_{f}.jpg" for style in ("00", "01", "02") for f in ("000", "001")
    ]
    assert stems(kept / "content" / "wall_0000") == ["000.jpg", "001.jpg"]
    assert stems(kept / "style") == ["00.jpg", "01.jpg", "02.jpg"]
    assert stems(kept / "depth" / "wall_0000") == ["000.npy", "001.npy", "cameras.npz"]
    assert (found.n, found.provenance["variant"]) == (12, "reference") and "input images" in found.provenance["time_s"]
    assert [(row.scene, row.style) for row in found.rows][:2] == [("wall_0000", "00"), ("wall_0000", "01")]
    # The reference shows the model all four views, of which two are judged.
    assert found.times["time_s"] == pytest.approx(found.provenance["seconds_a_style"] / 4)
    assert found.rows[0].pictures["result"] == kept / "stylized" / "wall_0000" / "00_001.jpg"
    (kept / "content" / "wall_0001" / "001.jpg").write_bytes((kept / "style" / "00.jpg").read_bytes())
    with pytest.raises(UserError, match="photograph 001 of wall_0001 is no longer that of the renders"):
        Paper(**parts, num_styles=3, frames=2).run(tmp_path, no_progress)


def test_scenes_whose_names_differ_in_a_slash_stay_apart(parts):
    with patch.object(ToyScenes, "name", lambda self, scene: ("a/b", "a-b")[scene]):
        assert Paper(**parts).planned_scenes == {"a-b": 0, "a-b_2": 1}


def test_the_reference_truncates_into_jpeg_and_the_corrected_rounds_into_png(parts, tmp_path):
    for variant in ("reference", "corrected"):
        Paper(**parts, num_styles=1, num_scenes=1, frames=1, variant=variant).run(tmp_path / variant, no_progress)
    photograph = middle_square(parts["scenes"].read(0, [0]).images)[0, 0]
    exact = np.asarray(Image.open(tmp_path / "corrected" / "images" / "content" / "wall_0000" / "000.png"))
    assert (exact == (photograph * 255).round().byte().permute(1, 2, 0).numpy()).all()
    written = tmp_path / "reference" / "images" / "content" / "wall_0000" / "000.jpg"
    truncated = Image.fromarray((photograph * 255).byte().permute(1, 2, 0).contiguous().numpy())
    truncated.save(tmp_path / "expected.jpg", quality=75)  # Pillow's own default is 4:2:0
    assert written.read_bytes() == (tmp_path / "expected.jpg").read_bytes()
    with Image.open(written) as image:
        # Table K.1 of the JPEG standard at quality 75.
        assert image.quantization[0][:4] == [8, 6, 5, 8]


@pytest.mark.slow
def test_nothing_is_rendered_twice(parts, tmp_path):
    with (
        patch.object(parts["stylizer"], "restyle", wraps=parts["stylizer"].restyle) as restyle,
        patch.object(parts["stylizer"], "encode", wraps=parts["stylizer"].encode) as encode,
    ):
        first, again = (Paper(**parts, num_styles=3, frames=2).run(tmp_path, no_progress) for _ in range(2))
    assert (restyle.call_count, encode.call_count) == (6, 2)
    assert again == first


@pytest.mark.slow
def test_an_interrupted_run_goes_on_where_it_was(parts, tmp_path):
    def stop(progress):
        if progress.line.startswith("render 4/"):
            raise KeyboardInterrupt

    with patch.object(parts["stylizer"], "restyle", wraps=parts["stylizer"].restyle) as restyle:
        with pytest.raises(KeyboardInterrupt):
            Paper(**parts, num_styles=3, frames=2).run(tmp_path, stop)
        assert restyle.call_count == 4
        (tmp_path / "images" / "stylized" / "wall_0000" / ".02").unlink()  # stopped between images and their mark
        found = Paper(**parts, num_styles=3, frames=2).run(tmp_path, no_progress)
    assert restyle.call_count == 4 + 3
    fresh = Paper(**parts, num_styles=3, frames=2).run(tmp_path / "fresh", no_progress)
    assert found.scores == fresh.scores and [row.scores for row in found.rows] == [row.scores for row in fresh.rows]


def test_styles_that_lack_what_is_needed(parts, tmp_path):
    class Bare(StyleSource):
        def __init__(self, style):
            self.style = style

        def __len__(self):
            return 1

        def read(self, style):
            return self.style

    imageless = Paper(**parts | {"styles": Bare(Style(text=("words",)))}, num_scenes=1, frames=1)
    with pytest.raises(ValueError, match="style 0 has no image, which the scores compare with"):
        imageless.run(tmp_path / "a", no_progress)
    wordless = Bare(Style(image=images(1, (8, 8)), text=(" ",)))
    with pytest.raises(ValueError, match="style 0 has no text; give captions"):
        Paper(**parts | {"styles": wordless}, guide="text", num_scenes=1, frames=1).run(tmp_path / "b", no_progress)


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"scenes": None}, "needs scenes; add scenes=NAME"),
        ({"styles": None}, "needs styles; add styles=NAME"),
        ({"scene_names": ["Train"]}, "there is no scene 'Train' in this source, which has wall_0000, wall_0001"),
    ],
)
def test_what_cannot_be_judged(parts, changed, told):
    with pytest.raises(ValueError, match=told):
        Paper(**parts | changed)


def test_sides_that_the_model_cannot_take(parts, tmp_path):
    odd = parts | {"scenes": ToyScenes(num_scenes=1, views=2, size=(30, 30))}
    with pytest.raises(ValueError, match=r"wall_0000 are 30x30 pixels; this model needs .* multiples of 8"):
        Paper(**odd).run(tmp_path, no_progress)


def test_a_model_that_gives_no_numbers_is_found_out(parts, tmp_path, monkeypatch):
    original = parts["stylizer"].restyle
    monkeypatch.setattr(
        parts["stylizer"], "restyle", lambda *given: original(*given).map(lambda each: each * torch.nan)
    )
    with pytest.raises(ValueError, match="render of wall_0000 in style 00 holds NaN"):
        Paper(**parts, num_styles=1, num_scenes=1, frames=1).run(tmp_path, no_progress)
    assert not (tmp_path / "images" / "stylized").exists()
