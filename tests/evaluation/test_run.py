"""`anystyle.evaluate`, and the lines that a command prints of its progress."""

import math
import re

import pytest
import torch
from PIL import Image

import anystyle
from anystyle.cli.progress import progress_lines
from anystyle.errors import UserError
from anystyle.evaluation import record
from anystyle.evaluation.run import make_metrics
from anystyle.registry.compose import compose
from anystyle.types import Progress
from tests.support.evaluation_cases import folders


def test_images_in_folders_are_judged_from_python(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    named = dict(zip(("content", "style", "stylized"), folders(tmp_path / "in"), strict=True))
    (named["stylized"] / "one" / "a_1.png").unlink()
    reported: list[Progress] = []
    given = ["metric=[psnr]", "missing=allow"]
    evaluation = anystyle.evaluate(given, **named, on_progress=reported.append)
    # Results are 60 s + 20 t + f, photographs 100 + f, and each style of each scene counts alike.
    expected = sum(20 * math.log10(255 / error) for error in (100, 80, 40, 20)) / 4
    assert evaluation.scores["psnr"] == pytest.approx(expected, rel=1e-5)
    assert evaluation.provenance["protocol"] == "folders" and evaluation.missing() == 1
    assert reported[-1] == Progress("judge 4/4", 1.0)
    read = record.read(tmp_path / "evaluation")
    assert read is not None and read.scores == evaluation.scores
    with pytest.raises(UserError, match="--stylized is missing"):
        anystyle.evaluate(given, content=named["content"], style=named["style"])
    with pytest.raises(UserError, match="there is no run"):
        anystyle.evaluate(trained=tmp_path / "absent")


def test_scores_are_not_lost_nor_judged_by_luck(tmp_path):
    content, style, stylized = folders(tmp_path / "in", scenes=("one",), styles=("a",), frames=9)
    with Image.open(stylized / "one" / "a_2.png") as opaque:
        picture = opaque.convert("RGBA")
    picture.putpixel((0, 0), (0, 0, 0, 0))
    for path in (stylized / "one" / "a_2.png", style / "a.png"):
        picture.save(path)

    def judged(*words):
        return anystyle.evaluate(words, content=content, style=style, stylized=stylized, out=tmp_path / "out")

    found = judged("metric=[psnr,color_match]")
    places = {"stylized": stylized / "one" / "a_2.png", "style": style / "a.png"}
    told = "1 {} images are transparent in places and judged on white, such as {}"
    assert found.provenance["warnings"] == [told.format(*each) for each in places.items()]
    with pytest.raises(UserError, match=r"would be lost; add their metrics, metric=\[color_match,psnr,timing\];"):
        judged("metric=[timing]")
    with pytest.raises(UserError, match="scores of variant=reference, not corrected; choose another --out"):
        judged("metric=[psnr,color_match]", "variant=corrected")
    assert judged("metric=[psnr,color_match,timing]").scores["psnr"] == found.scores["psnr"]
    for number in range(3, 9):
        (stylized / "one" / f"a_{number}.png").unlink()
    with pytest.raises(UserError, match="3 of 9 views of one are numbered 0 to 2: these may be the first"):
        judged("metric=[psnr,color_match,timing]", "missing=allow")
    for path in [*(content / "one").iterdir(), *(stylized / "one").iterdir()]:
        path.rename(path.with_stem(re.sub(r"\d+", lambda number: f"IMG_{int(number[0]) + 1:04d}", path.stem)))
    with pytest.raises(UserError, match="3 of 9 views of one are numbered 1 to 3: these may be the first"):
        judged("metric=[psnr,color_match,timing]", "missing=allow")


@pytest.mark.parametrize(
    ("metric", "chosen", "expected"),
    [
        ("psnr", [], None),
        ("warp_consistency", [], "Raft"),
        ("warp_consistency", ["correspondence=rendered_depth"], "RenderedDepth"),
    ],
)
def test_a_metric_that_follows_pixels_takes_the_default_or_what_is_chosen(metric, chosen, expected):
    config = compose("evaluate", ["subject=images", "protocol=folders", f"metric=[{metric}]", *chosen])
    make_metrics(config, None, torch.device("cpu"))
    correspondence = config.get("correspondence")
    assert (correspondence and correspondence._target_.rpartition(".")[2]) == expected


def test_each_stage_has_a_first_and_a_last_line(capsys):
    report = progress_lines()
    for stage, total in (("render", 3), ("judge", 2), ("judge", 1)):
        for done in range(total + 1):
            report(Progress.count(stage, done, total))
    lines = "render 0/3 …", "render 3/3 …", "judge 0/2 …", "judge 2/2 …", "judge 0/1 …", "judge 1/1 …"
    assert tuple(capsys.readouterr().err.splitlines()) == lines
