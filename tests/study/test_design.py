"""Designs are balanced, blind, and refuse what cannot be."""

import json
from collections import Counter
from itertools import pairwise

import numpy as np
import pytest
from PIL import Image
from study_cases import small_plan, small_study, write_results

from anystyle.commands._study_options import read_plan
from anystyle.study.balance import balanced_positions, draw_pairs, latin_orders
from anystyle.study.design import Sources, balance, design
from anystyle.study.naming import checksum, is_ours
from anystyle.study.plan import Plan, plan_from
from anystyle.study.protocol import read_study


def opened(path):
    with Image.open(path) as image:
        image.load()
        return image


def test_the_papers_design(tmp_path):
    study = design(write_results(tmp_path, scenes=5, styles=6), read_plan("paper", ["image_size=64"]), tmp_path / "s")
    assert (len(study.participants), len(study.items), len(study.plan.questions)) == (40, 20, 3)
    assert study.plan.scale.levels == (1, 2, 3, 4, 5)
    report = balance(study)
    even = {name: span for name, span in report.items() if isinstance(span, dict) and set(span) == {"least", "most"}}
    assert even == {
        "ours_is_a_per_participant": {"least": 10, "most": 10},
        "ours_is_a_per_set": {"least": 20, "most": 20},
        "times_a_set_stands_in_a_place": {"least": 2, "most": 2},
        "times_a_set_follows_another": {"least": 2, "most": 2},
    }
    assert set(report["per_scene"].values()) == {4}
    assert set(report["per_style"].values()) <= {3, 4}
    assert all(len(set(one.order)) == 22 for one in study.participants)
    assert all(not one.order[0].startswith("check") for one in study.participants)
    assert json.loads((tmp_path / "s" / "balance.json").read_text()) == {**report, "left_out": []}
    assert "| ours is a per set | 20 | 20 |" in (tmp_path / "s" / "balance.md").read_text()


@pytest.mark.parametrize(("people", "sets"), [(2, 2), (6, 4), (40, 20), (10, 8)])
def test_positions_are_even_both_ways(people, sets):
    positions = balanced_positions(people, sets, np.random.default_rng(0))
    assert (positions.sum(1) == sets / 2).all()
    for first in range(2, people + 1, 2):  # whoever comes later may stay away
        assert (positions[:first].sum(0) == first / 2).all()


@pytest.mark.parametrize("sets", [2, 4, 7, 20])
def test_orders_are_latin_squares_balanced_for_what_comes_before(sets):
    rows = sets if sets % 2 == 0 else 2 * sets
    orders = latin_orders(rows, sets, np.random.default_rng(1))
    assert all((np.bincount(column, minlength=sets) == rows // sets).all() for column in orders.T)
    following = Counter((a, b) for order in orders.tolist() for a, b in pairwise(order))
    assert set(following.values()) == {rows // sets}
    assert len(following) == sets * (sets - 1)


def test_pairs_are_as_even_as_the_results_allow():
    generator = np.random.default_rng(0)
    available = np.ones((7, 5), dtype=bool)
    for count in (4, 20, 34):
        pairs = draw_pairs(available, count, generator)
        assert len(set(pairs)) == count
        for axis, size in ((0, 7), (1, 5)):
            counts = np.bincount([pair[axis] for pair in pairs], minlength=size)
            assert counts.max() - counts.min() <= 1
    available[:, 1:] = False  # one style only: as even as it gets
    assert sorted(pair[0] for pair in draw_pairs(available, 6, generator))[0] <= 1
    with pytest.raises(ValueError, match=r"20 sets are asked for and 7 pairs .* plan at most 6"):
        draw_pairs(available, 20, generator)


def test_the_seed_decides_everything(tmp_path):
    sources = write_results(tmp_path)
    first, again = (design(sources, small_plan(), tmp_path / name) for name in ("a", "b"))
    assert first == again == read_study(tmp_path / "b")
    for file in sorted((tmp_path / "a").rglob("*.*")):
        assert file.read_bytes() == (tmp_path / "b" / file.relative_to(tmp_path / "a")).read_bytes()
    assert design(sources, small_plan(seed=1), tmp_path / "c").items != first.items


def test_pictures_have_one_size_and_tell_nothing(tmp_path):
    sources = write_results(tmp_path, sizes={"other": (96, 60)})
    exif = Image.Exif()
    exif[0x0131] = "the other method"
    for file in (tmp_path / "other").rglob("*.png"):
        opened(file).save(file, exif=exif)
    study = design(sources, small_plan(), tmp_path / "study")
    for item in study.items:
        files = [tmp_path / "study" / "pictures" / f"{name}.jpg" for name in (item.ours, item.theirs, item.content)]
        assert {opened(file).size for file in files} == {(64, 48)}
        assert max(opened(files[0]).size) == max(opened(files[0].with_stem(item.reference)).size)
        for file in files:
            assert not opened(file).getexif()
            assert b"method" not in file.read_bytes()
            assert len(file.stem) == 12
    left_out = json.loads((tmp_path / "study" / "balance.json").read_text())["left_out"]
    assert len(left_out) == 4
    assert "other proportions than ours" in left_out[0]


def test_names_of_pictures_carry_one_hidden_bit(tmp_path):
    study, _ = small_study(tmp_path)
    assert checksum("foobar") == 0xBF9CF968  # FNV-1a's published test value
    for item in study.items:
        assert is_ours(item.ours, study.id)
        assert not is_ours(item.theirs, study.id)


def test_several_methods_and_styles_in_words(tmp_path):
    sources = write_results(tmp_path, methods=("ours", "one", "two"))
    (tmp_path / "styles" / "style0.png").unlink()
    (tmp_path / "styles" / "style0.txt").write_text("thick swirling strokes\n")
    study = design(sources, small_plan(sets=6), tmp_path / "study")
    assert Counter(item.baseline for item in study.items) == {"one": 3, "two": 3}
    words = [item for item in study.items if item.style == "style0"]
    assert words
    assert all((item.text, item.reference) == ("thick swirling strokes", "") for item in words)


def test_frames_of_a_result_are_matched_by_name(tmp_path):
    sources = write_results(tmp_path, scenes=2, styles=1)
    for place in (*(tmp_path / "ours").glob("*/*.png"), *(tmp_path / "other").glob("*/*.png")):
        folder = place.with_suffix("") / "renders"
        folder.mkdir(parents=True)
        for frame in range(5):
            Image.new("RGB", (48, 36), (40 * frame, 0, 0)).save(folder / f"{frame:03d}.png")
        place.unlink()
    for photo in (tmp_path / "contents").glob("*.png"):
        photo.with_suffix("").mkdir()
        for frame in range(1, 4):
            Image.new("RGB", (48, 36), (40 * frame, 0, 0)).save(photo.with_suffix("") / f"{frame:03d}.png")
        photo.unlink()
    study = design(sources, small_plan(sets=2, attention_checks=0), tmp_path / "study")
    for item in study.items:
        colors = [
            opened(tmp_path / "study" / "pictures" / f"{name}.jpg").getpixel((5, 5))[0]
            for name in (item.ours, item.theirs, item.content)
        ]
        assert colors == pytest.approx([80, 80, 80], abs=3)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"participants": 41}, "41 participants .* such as 40 or 42"),
        ({"participants": 0}, "such as 2 or 4"),
        ({"sets": 5}, "with 5 sets .* such as 4 or 6"),
        ({"questions": []}, "questions are named"),
        ({"questions": [{"name": "a b", "text": "?"}]}, "letters, digits"),
        ({"questions": [{"name": "a"}]}, "a name and a text"),
        ({"questions": "style"}, "expected a list"),
        ({"labels": ["only one"]}, "at least two answers"),
        ({"attention_checks": 11}, "0 to 10"),
        ({"participants": "many"}, "a whole number"),
        ({"title": 3}, "expected text"),
        ({"participant": 40}, "Did you mean 'participants'"),
        ({"image_size": 10}, "64 to 4096"),
    ],
)
def test_plans_that_cannot_be_are_refused(options, told):
    with pytest.raises(ValueError, match=told) as error:
        plan_from(options)
    assert "\n" not in str(error.value)


def test_folders_that_lack_something_are_told(tmp_path):
    sources = write_results(tmp_path, scenes=2, styles=2)
    methods = dict(sources.methods)
    with pytest.raises(ValueError, match="a comparison needs two"):
        Sources(methods={"ours": methods["ours"]}, ours="ours", styles=sources.styles, contents=sources.contents)
    with pytest.raises(ValueError, match="'mine', which is none of the methods ours, other"):
        Sources(methods=methods, ours="mine", styles=sources.styles, contents=sources.contents)
    for changed, told in (
        ({"styles": tmp_path / "nowhere"}, "styles .* is no folder"),
        ({"methods": {**methods, "other": tmp_path / "styles"}}, "method other: .* holds no results"),
        ({"styles": tmp_path / "contents"}, "names must match, and found were scene0 / style0: not among the styles"),
    ):
        with pytest.raises(ValueError, match=told):
            design(Sources(**{**vars(sources), **changed}), small_plan(), tmp_path / "out")
    with pytest.raises(ValueError, match="plan at most 4 sets"):
        design(sources, small_plan(sets=6), tmp_path / "out")
    for broken in (tmp_path / "ours" / "scene0").glob("*.png"):
        broken.write_bytes(b"\x89PNG\r\n\x1a\n and no more")
    with pytest.raises(ValueError, match="no image that can be read"):
        design(sources, small_plan(), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_damaged_study_is_refused(tmp_path):
    _, folder = small_study(tmp_path)
    with pytest.raises(ValueError, match="holds no study"):
        read_study(tmp_path)
    content = json.loads((folder / "study.json").read_text())
    for change in (
        {"items": 3},
        {"plan": {"sets": 3}},
        {"participants": [{"id": "P", "order": ["x"], "ours_is_a": []}]},
    ):
        (folder / "study.json").write_text(json.dumps({**content, **change}))
        with pytest.raises(ValueError, match="is no study"):
            read_study(folder)
    content["items"][0]["ours"] = "../../etc/passwd"
    (folder / "study.json").write_text(json.dumps(content))
    with pytest.raises(ValueError, match="no file's"):
        read_study(folder)


def test_the_paper_configuration_is_the_default_plan():
    assert read_plan("paper", []) == Plan()
    assert read_plan("pilot", ["participants=8"]).participants == 8
    with pytest.raises(ValueError, match=r"no study configuration is named 'papper'\. Did you mean 'paper'"):
        read_plan("papper", [])
