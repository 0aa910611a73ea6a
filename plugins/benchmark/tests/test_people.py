"""Scores order methods as people do, or not, with intervals for other people, scenes and styles."""

import csv
import json
import math
import re
import shutil
from itertools import combinations
from xml.etree import ElementTree

import msgspec
import numpy as np
import pytest
from scipy import stats

from anystyle.errors import UserError
from anystyle.io.atomic import write_json
from anystyle_benchmark import command_compare
from anystyle_benchmark.command_people import main
from anystyle_benchmark.people import Choice, correlation, majority
from anystyle_benchmark.results import Cell, Figures, MetricInfo
from anystyle_benchmark.spec import read_spec
from anystyle_study.protocol import read_study
from anystyle_study.statistics import holm
from tests.benchmarks.people import bundled
from tests.support.people_cases import crossing, simulated, write_answers


def choices_between(opinions, methods="abcdefg"):
    """One person's answers to every two methods of one cell."""
    return [
        Choice("P1", f"{i}-{j}", (Cell(methods[i], 0, "s", "t"), Cell(methods[j], 0, "s", "t")), vote)
        for i, j in combinations(range(len(opinions)), 2)
        for vote in [float(np.sign(opinions[i] - opinions[j]))]
    ]


@pytest.mark.parametrize("seed", range(5))
def test_in_one_cell_it_is_somers_d_and_without_ties_kendalls_tau(seed):
    random = np.random.default_rng(seed)
    for levels in (3, 1000):
        opinions, figure = random.integers(0, levels, 7), random.integers(0, levels, 7)
        order = np.array([np.sign(figure[i] - figure[j]) for i, j in combinations(range(7), 2)], dtype=float)
        found = correlation("style", "x", choices_between(opinions), order)
        assert found.d == pytest.approx(stats.somersd(opinions, figure).statistic, abs=1e-7)
        assert found.agrees == pytest.approx((1 + found.d) / 2, abs=1e-6)
        assert found.pairs + found.undecided == 21
        if levels == 1000:
            assert found.d == pytest.approx(stats.kendalltau(opinions, figure).statistic, abs=1e-7)
        left = [stats.somersd(*(np.delete(of, k) for of in (opinions, figure))).statistic for k in range(7)]
        assert found.without == pytest.approx((min(left), max(left)), abs=1e-7)


def test_two_methods_have_none_to_leave_out_and_one_answer_no_interval():
    found = correlation("style", "x", choices_between([1, 0]), np.array([1.0]))
    assert (found.d, found.low, found.pvalue, found.without) == (1.0, None, None, (None, None))


def test_the_bundled_design_is_balanced_and_its_methods_are_there():
    design = bundled(24, 4)
    methods = [read_spec(name)[0] for name in command_compare.STUDIED]
    assert len(methods) == 6 and not any(method.baseline for method in methods)
    assert design.shape == (24, 40, 4)
    _, per_scene = np.unique(design[..., 0], return_counts=True)
    assert set(per_scene.tolist()) == {240}
    _, per_set = np.unique(design.reshape(-1, 4), axis=0, return_counts=True)
    assert per_set.tolist() == [4] * 240
    pairs, per_pair = np.unique(design[..., 2:].reshape(-1, 2), axis=0, return_counts=True)
    assert len(pairs) == 15 and set(per_pair.tolist()) == {64}
    # Who comes last in a round through the pool is left with what the others did not take.
    assert np.mean([len(np.unique(sets[:, :2], axis=0)) == 40 for sets in design]) >= 5 / 6


def test_a_noisy_truth_has_greiners_correlation():
    """Signs of normal differences that correlate by rho agree by 2 asin(rho) / pi."""
    people, order, rho = simulated(crossing(participants=40, scenes=12, styles=20), noise=1.0, seed=0)
    found = correlation("style", "x", people, order)
    assert found.d == pytest.approx(2 / math.pi * math.asin(rho), abs=0.04)
    assert found.low < 2 / math.pi * math.asin(rho) < found.high
    assert found.pvalue < 1e-6
    assert found.generalizes_to == ("participants", "scenes", "styles")
    assert correlation("style", "x", people, -order).d == -found.d


def test_intervals_of_a_score_that_people_do_not_follow_hold_zero_as_often_as_they_say():
    """Scenes in which a score is right and others in which it is wrong: answers alone would find it good or bad."""
    held, naive = [], []
    design = crossing(participants=12, scenes=6, styles=6)
    for seed in range(150):
        people, order, _ = simulated(design, noise=math.inf, seed=seed, shared=1.0)
        found = correlation("style", "x", people, order)
        held.append(found.low <= 0 <= found.high)
        naive.append(abs(found.d) <= 1.96 / math.sqrt(found.pairs))
    assert np.mean(held) >= 0.93
    assert np.mean(naive) < 0.75


def test_the_others_do_not_count_oneself():
    cells = Cell("a", 0, "s", "t"), Cell("b", 0, "s", "t")
    votes = {"1": [1, 1, -1], "2": [1, -1], "3": [1], "4": [0, -1, 1]}
    choices = [Choice(f"P{p}", item, cells, vote) for item, given in votes.items() for p, vote in enumerate(given)]
    assert majority(choices).tolist() == pytest.approx([0, 0, 1, -1, 1, math.nan, 0, 1, -1], nan_ok=True)


@pytest.fixture(scope="module")
def asked(world, tmp_path_factory):
    """Results with scores that people follow, and a study of every two of its three methods with simulated answers."""
    track, judged = world
    root = tmp_path_factory.mktemp("people")
    shutil.copytree(judged, root / "results")
    figures = msgspec.json.decode((judged / "figures.json").read_bytes(), type=Figures)
    random = np.random.default_rng(0)
    truth = {cell.cell: random.normal() for cell in figures.cells}
    for cell in figures.cells:
        value = truth[cell.cell]
        cell.figures.update(good=value, error=-value, wrong=-value, same=1.0, noise=random.normal())
    infos = {name: MetricInfo(name, "higher") for name in ("good", "wrong", "same", "noise")}
    infos |= {"error": MetricInfo("error", "lower", stand_in="texture")}
    figures = msgspec.structs.replace(figures, metrics=figures.metrics | infos)
    write_json(root / "results" / "figures.json", msgspec.to_builtins(figures))
    words = ["noise", "pasted", "unstyled", "--with-people", str(root / "study"), "--track", str(track)]
    plan = ["participants=8", "sets=12", "pool=36", "views=2", "image_size=64"]
    command_compare.main([str(root / "results"), *words, *plan])
    study = read_study(root / "study")
    follows = {(cell.method, cell.scene, cell.style): 3 * value for cell, value in truth.items() if cell.seed == 0}
    write_answers(study, root / "study" / "answers", {question.name: follows for question in study.plan.questions})
    return root, study, truth


def test_every_pair_is_shown_equally_often(asked):
    root, study, _ = asked
    pairs = [study.methods(item) for item in study.items]
    assert {pair: pairs.count(pair) for pair in pairs} == dict.fromkeys(
        combinations(("noise", "pasted", "unstyled"), 2), 12
    )
    assert len({(item.scene, item.style, *study.methods(item)) for item in study.items}) == 36
    for person in study.participants:
        shown = [study.shown[name] for name in person.order if name in {item.id for item in study.items}]
        assert len({(item.scene, item.style) for item in shown}) == 12
        counts = [sum(study.methods(item) == pair for item in shown) for pair in set(pairs)]
        assert (min(counts), max(counts)) == (4, 4)
    # Once each: pictures by three methods in 12 cells and 2 views, photographs, styles, and those of checks.
    assert len(list((root / "study" / "pictures").iterdir())) <= 3 * 12 * 2 + 3 * 2 + 3 + 2 * 2 * 2
    assert "sets per pair of methods" in (root / "study" / "balance.md").read_text()


def test_a_study_and_results_give_a_table_a_picture_and_files(asked, capsys):
    root, study, truth = asked
    main([str(root / "results"), str(root / "study")])
    shown = capsys.readouterr().out
    document = json.loads((root / "study" / "people.json").read_text())
    by_name = {(one["question"], one["figure"]): one for one in document["figures"]}
    questions = [question.name for question in study.plan.questions]
    for question in questions:
        good, error, wrong = (by_name[question, name] for name in ("good", "error", "wrong"))
        assert good["d"] == error["d"] == -wrong["d"] > 0.5
        assert good["low"] > 0 > wrong["high"]
        assert good["pvalue"] < 0.05
        assert (good["participants"], good["scenes"], good["styles"]) == (8, 3, 4)
    rows = [one for one in document["figures"] if one["question"] == "views"]
    adjusted = holm([math.nan if one["pvalue"] is None else one["pvalue"] for one in rows])
    assert [one["holm"] for one in rows] == [None if math.isnan(p) else p for p in adjusted]
    # From the files alone: agreement less disagreement of those who prefer one side.
    agree = []
    for file in (root / "study" / "answers").iterdir():
        given = json.loads(file.read_text())
        ours_is_a = study.participant(given["participant"]).ours_is_a
        for row in given["responses"]:
            if row["question"] == "views" and row["item"] in {item.id for item in study.items} and row["score"] != 3:
                item = study.item(row["item"])
                first, second = (truth[method, 0, item.scene, item.style] for method in study.methods(item))
                agree.append(np.sign(first - second) * (1 if (row["score"] < 3) == (row["item"] in ours_is_a) else -1))
    assert by_name["views", "good"]["d"] == pytest.approx(np.mean(agree), abs=1e-6)
    assert by_name["views", "good"]["pairs"] == len(agree)
    assert by_name["style", "kid"]["scenes"] == 3  # a figure of a scene
    assert by_name["style", "kid"]["styles"] == 3  # of images alone
    assert "same" not in {name for _, name in by_name}
    assert "error ↓†" in shown
    assert re.search(r"Left out, without figures or the same for all methods: .*\bsame\b", shown)
    assert "orders its methods alike in each: kid" in shown
    assert (root / "study" / "people.md").read_text().strip() in shown
    rows = list(csv.DictReader((root / "study" / "people.csv").read_text().splitlines()))
    assert {row["score"] for row in rows} >= {"other participants", "good ↑", "error ↓†"}
    drawn = ElementTree.parse(root / "study" / "people.svg").getroot()
    dots = [one for one in drawn.iter() if one.tag.endswith("circle")]
    assert len(dots) == len(document["figures"])
    assert len({dot.get("fill") for dot in dots}) == 3


def test_what_is_not_known_is_a_line(asked, tmp_path, capsys):
    root, _, _ = asked
    folder = shutil.copytree(root / "study", tmp_path / "study")
    hashes = json.loads((folder / "images.json").read_text())
    (folder / "images.json").write_text(
        json.dumps({name: "0" if "noise/" in name else hashes[name] for name in hashes})
    )
    main([str(root / "results"), str(folder)])
    told = capsys.readouterr().out
    assert "answers are left out: people saw other images of noise than those judged." in told
    assert "pasted, unstyled" in told
    (folder / "images.json").unlink()
    for file in sorted((folder / "answers").iterdir())[1:]:
        file.unlink()
    main([str(root / "results"), str(folder)])
    told = capsys.readouterr().out
    assert "There is no images.json: whether the images that people saw are those judged is not known." in told
    assert "There is no conclusion: one participant is left" in told
    assert {one["holm"] for one in json.loads((folder / "people.json").read_text())["figures"]} == {None}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["RESULTS", "EMPTY"], "holds no study.json"),
        (["EMPTY", "STUDY"], r"there is no .*figures\.json; run `anystyle benchmark judge"),
        (["RESULTS", "UNANSWERED"], "has no answers beside it"),
        (["OTHERS", "STUDY"], "no answer of .* is about images of these results: the results have no method"),
    ],
)
def test_slips_are_one_line(asked, tmp_path, words, message):
    root, _, _ = asked
    places = {"RESULTS": root / "results", "STUDY": root / "study"}
    places |= {name: tmp_path / name.lower() for name in ("EMPTY", "UNANSWERED", "OTHERS")}
    for name in ("EMPTY", "UNANSWERED", "OTHERS"):
        places[name].mkdir()
    shutil.copy(root / "study" / "study.json", places["UNANSWERED"])
    figures = json.loads((root / "results" / "figures.json").read_text())
    write_json(places["OTHERS"] / "figures.json", figures | {"methods": {}, "cells": []})
    with pytest.raises(UserError, match=message) as error:
        main([*(str(places[word]) for word in words), "--out", str(tmp_path / "out")])
    assert "\n" not in str(error.value)
    assert not (tmp_path / "out").exists()
