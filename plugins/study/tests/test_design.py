"""Designs are balanced, blind, and refuse what cannot be."""

import json
import re
from collections import Counter
from itertools import pairwise

import av
import numpy as np
import pytest
from PIL import Image
from study_cases import QUESTIONS, small_plan, small_study, write_results

from anystyle_study.balance import balanced_positions, balanced_subsets, draw_pairs, latin_orders
from anystyle_study.commands import read_plan
from anystyle_study.design import Sources, balance, design
from anystyle_study.protocol import Rules, read_study
from anystyle_study.server import sequence
from anystyle_study.store import Store


def opened(path):
    with Image.open(path) as image:
        image.load()
        return image


def test_the_papers_design(tmp_path):
    """Appendix C: 40 people, 20 sets of three views, a comparison and two ratings; nothing that it does not name."""
    plan = read_plan(["study=paper", "image_size=64"])
    assert plan == read_plan(["image_size=64"])
    assert [(one.kind, one.scale.levels, one.sides) for one in plan.questions] == [
        ("comparison", (1, 2, 3, 4, 5), ("",)),
        ("rating", (1, 2, 3, 4, 5), ("A", "B")),
    ]
    style, content = plan.questions
    assert [style.labels[index] for index in (0, 2, 4)] == ["A is much better", "Comparable", "B is much better"]
    assert (content.labels[0], content.labels[-1]) == ("Very difficult", "Very easy")
    assert (plan.consent, plan.demographics, plan.id_parameters) == ("", (), ())
    assert plan.rules == Rules(failed_checks=None, missing_share=1, min_seconds=0, fast_share=1)
    study = design(write_results(tmp_path, scenes=5, styles=6, frames=3), plan, tmp_path / "s")
    assert (len(study.participants), len(study.items), len(study.checks)) == (40, 20, 0)
    assert all(len(views) == 3 for item in study.items for views in (item.ours, item.theirs, item.content))
    answers = 20 * sum(len(question.sides) for question in plan.questions)
    assert (answers, 40 * answers) == (60, 2400)
    report = balance(study)
    assert report == {
        "sets per scene": (4, 4),
        "sets per style": (3, 4),
        "sets per baseline": (20, 20),
        "participants per set": (40, 40),
        "ours is A per participant": (10, 10),
        "ours is A per set": (20, 20),
        "a scene per participant": (4, 4),
        "a style per participant": (3, 4),
        "times a set has a rank": (2, 2),
        "times a set follows another": (2, 2),
    }
    assert all(len(set(one.order)) == 20 for one in study.participants)
    assert re.search(r"ours is A per set +\| 20 +\| 20 ", (tmp_path / "s" / "balance.md").read_text())


@pytest.mark.parametrize(("pool", "count", "rounds"), [(12, 4, 7), (30, 20, 5), (8, 8, 3)])
def test_subsets_take_every_set_equally_often(pool, count, rounds):
    pairs = np.argwhere(np.ones((6, 5), dtype=bool))[:pool]
    subsets = balanced_subsets(pairs, count, rounds, np.random.default_rng(0))
    assert all(len(set(subset)) == count for subset in subsets.tolist())
    for first in range(1, rounds + 1):
        times = np.bincount(subsets[:first].ravel(), minlength=pool)
        assert times.max() - times.min() <= 1


def test_checks_look_like_sets_and_their_answers_are_known(tmp_path):
    study = design(write_results(tmp_path), small_plan(participants=20, degraded=2, repeats=1), tmp_path / "s")
    by_kind = {kind: [check for check in study.checks if check.kind == kind] for kind in ("degraded", "repeat")}
    assert len(by_kind["degraded"]) == 2
    for check in by_kind["degraded"]:
        item = study.shown[check.of]
        intact, spoilt = (
            np.asarray(opened(tmp_path / "s" / "pictures" / side[0])) for side in (check.ours, check.theirs)
        )
        assert check.ours in (item.ours, item.theirs)
        assert intact.shape == spoilt.shape
        assert spoilt.std() < intact.std() / 2  # the detail is gone
        assert np.ptp(spoilt, axis=2).max() <= 2  # and the colour
    assert 0 < sum(by_kind["degraded"][0].id in one.ours_is_a for one in study.participants) < 20
    for one in study.participants:
        (repeat,) = [study.shown[name] for name in one.order if study.shown[name] in by_kind["repeat"]]
        assert (repeat.id in one.ours_is_a) != (repeat.of in one.ours_is_a)
        assert one.order.index(repeat.id) - one.order.index(repeat.of) >= 3
        assert one.order[0] not in {check.id for check in study.checks}
        shown = [entry for entry in sequence(study, one) if entry["id"] in (repeat.id, repeat.of)]
        assert (shown[0]["A"], shown[0]["B"]) == (shown[1]["B"], shown[1]["A"])
    assert len({len(name) for name in study.shown}) == 1


def test_videos_play_every_view(tmp_path):
    sources = write_results(tmp_path, scenes=2, styles=1, frames=5)
    plan = small_plan(sets=2, show="video", views=4, degraded=1, frames_per_second=8)
    study = design(sources, plan, tmp_path / "s")
    for name in (*study.items[0].ours, *study.items[0].content, *study.checks[0].theirs):
        file = tmp_path / "s" / "pictures" / name
        with av.open(str(file)) as container:
            (stream,) = container.streams
            assert (stream.codec_context.name, stream.average_rate, stream.pix_fmt) == ("h264", 8, "yuv420p")
            assert sum(1 for _ in container.decode(stream)) == 4
            assert (stream.width, stream.height) == (64, 48)
        assert opened(file.with_suffix(".jpg")).size == (64, 48)
    assert len(study.items[0].reference.removesuffix(".jpg")) == 12


@pytest.mark.parametrize(("people", "sets"), [(2, 2), (6, 4), (40, 20), (10, 8)])
def test_positions_are_even_both_ways(people, sets):
    positions = balanced_positions(people, sets, np.random.default_rng(0))
    assert (positions.sum(1) == sets / 2).all()
    for first in range(2, people + 1, 2):  # participants answer in order, and the last ones may never take part
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
        files = [tmp_path / "study" / "pictures" / names[0] for names in (item.ours, item.theirs, item.content)]
        assert {opened(file).size for file in files} == {(64, 48)}
        assert max(opened(files[0]).size) == max(opened(files[0].with_name(item.reference)).size)
        for file in files:
            assert not opened(file).getexif()
            assert b"method" not in file.read_bytes()
            assert len(file.stem) == 12
    notes = [line for line in (tmp_path / "study" / "balance.md").read_text().splitlines() if line.startswith("- ")]
    assert len(notes) == 4
    assert "other proportions than ours" in notes[0]


def test_several_methods_and_styles_in_words(tmp_path):
    sources = write_results(tmp_path, methods=("ours", "one", "two"))
    (tmp_path / "styles" / "style0.png").unlink()
    (tmp_path / "styles" / "style0.txt").write_text("thick swirling strokes\n")
    study = design(sources, small_plan(sets=6), tmp_path / "study")
    assert Counter(item.baseline for item in study.items) == {"one": 3, "two": 3}
    words = [item for item in study.items if item.style == "style0"]
    assert words
    assert all((item.text, item.reference) == ("thick swirling strokes", "") for item in words)


@pytest.mark.parametrize(("views", "numbers"), [(1, [2]), (2, [1, 3])])
def test_frames_of_a_result_are_matched_by_name(tmp_path, views, numbers):
    sources = write_results(tmp_path, scenes=2, styles=1, frames=1)
    methods = [tmp_path / name / f"scene{scene}" / "style0" for name in ("ours", "other") for scene in (0, 1)]
    for folder, first in [*((path / "renders", 0) for path in methods), (tmp_path / "contents" / "scene0", 1)]:
        folder.mkdir(exist_ok=True)
        for frame in range(first, 5):
            Image.new("RGB", (48, 36), (40 * frame, 0, 0)).save(folder / f"{frame:03d}.png")
    (tmp_path / "contents" / "scene0" / "000.png").unlink()
    study = design(sources, small_plan(sets=2, degraded=0, views=views), tmp_path / "study")
    item = next(item for item in study.items if item.scene == "scene0")
    shown = range(1, 5) if views == 1 else range(5)
    assert set(numbers) <= set(shown)
    for names in (item.ours, item.theirs, item.content):
        reds = [opened(tmp_path / "study" / "pictures" / name).getpixel((5, 5))[0] for name in names]
        assert reds == sorted(reds)
        assert len(reds) == views
    middle = [opened(tmp_path / "study" / "pictures" / name).getpixel((5, 5))[0] for name in item.ours]
    assert middle == pytest.approx([40 * number for number in numbers], abs=3)


def test_results_with_too_few_views_are_told(tmp_path):
    with pytest.raises(ValueError, match=r"style\d has 2 view\(s\) where 3 are planned"):
        design(write_results(tmp_path, frames=2), small_plan(views=3), tmp_path / "study")


def test_a_study_with_answers_is_not_replaced(tmp_path):
    study, folder = small_study(tmp_path)
    Store(study=study, path=folder / "answers.sqlite").close()
    with pytest.raises(ValueError, match=r"answers.sqlite holds answers to the study that is there"):
        design(write_results(tmp_path), small_plan(seed=5), folder)
    assert read_study(folder) == study


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"participants": 41}, "participants=41 .* such as 40 or 42"),
        ({"sets": 5}, "sets=5 .* such as 4 or 6"),
        ({"pool": 2}, "pool=2 has fewer sets than the 4"),
        ({"questions": []}, "at least one"),
        ({"questions": [QUESTIONS[0]] * 2}, "different names"),
        ({"questions": [{**QUESTIONS[0], "name": "a b"}]}, "letters, digits"),
        ({"questions": [{"name": "a"}]}, "required field 'text'"),
        ({"questions": [{**QUESTIONS[0], "kind": "ranking"}]}, "'ranking'"),
        ({"questions": [{**QUESTIONS[0], "labels": ["only one"]}]}, "at least two labels"),
        ({"degraded": 3}, "degraded=3; expected 0 to 2"),
        ({"views": 7}, "too many for a grid"),
        ({"rules": {"fast_share": 2.0}}, "shares from 0 to 1"),
        ({"completion_url": "javascript:alert(1)"}, "begins with https"),
        ({"participants": "many"}, "Expected 'int', got 'str' - at 'participants'"),
        ({"participant": 40}, "Did you mean 'participants'"),
    ],
)
def test_plans_that_cannot_be_are_refused(options, told):
    with pytest.raises(ValueError, match=told) as error:
        small_plan(**options)
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
        {"checks": [{"id": "c", "kind": "repeat", "of": "x", "ours": [], "theirs": []}]},
    ):
        (folder / "study.json").write_text(json.dumps({**content, **change}))
        with pytest.raises(ValueError, match=r"is no study; design it again [^\n]*$"):
            read_study(folder)
    (folder / "study.json").write_text("[" * 100_000)
    with pytest.raises(ValueError, match="nested deeper than 48 levels"):
        read_study(folder)
    content["items"][0]["ours"] = ["../../etc/passwd"]
    (folder / "study.json").write_text(json.dumps(content))
    with pytest.raises(ValueError, match="no file's"):
        read_study(folder)


def test_configurations_are_named(tmp_path):
    assert read_plan(["study=pilot", "participants=8"]).participants == 8
    online = read_plan(["study=online", "rules.min_seconds=4"])
    assert (online.rules.min_seconds, online.pool, online.id_parameters[0]) == (4, 60, "PROLIFIC_PID")
    with pytest.raises(ValueError, match=r"no study configuration is named 'papper'\. Did you mean 'paper'"):
        read_plan(["study=papper"])
