"""The site of a benchmark, from judged results to a real browser."""

from pathlib import Path

import msgspec
import pytest

from anystyle.errors import UserError
from anystyle.io.atomic import write_json
from anystyle_benchmark.command_site import main
from anystyle_benchmark.results import (
    FIGURES,
    CellFigures,
    Figures,
    Interval,
    MetricInfo,
    Origin,
    Record,
    SceneFigures,
    TableRow,
    bind,
    cells_of,
)
from anystyle_benchmark.spec import Spec
from tests.support.benchmark_world import write_results, write_track
from tests.support.browser import wait

LONG = "A method of a very long name that goes on and on, for a paper of " + "unbreakable" * 5
HOSTILE = '</script><img src=x onerror=alert(1)> & "pasted"'
BOTH = ("image", "text")
SPECS = {
    spec.name: spec
    for spec in (
        Spec("unstyled", "The photographs", guides=BOTH, baseline=True, preset=("method=unstyled",)),
        Spec(
            *("noise", LONG),
            guides=BOTH,
            seeds=2,
            command=("{python}", "my noise.py"),
            requirements=("numpy==2.1.0",),
        ),
        Spec(
            *("pasted", HOSTILE, HOSTILE, "javascript:alert(1)", "https://example.org/code, commit 1"),
            consistent=False,
            folder="images",
        ),
        Spec("palette", "Palette", preset=("method=palette",)),
        Spec("later", "Later", not_run="needs <CUDA>"),
    )
}
METRICS = {
    "color_match": MetricInfo("color match", "lower", "A reference", metric="color_match"),
    "kid": MetricInfo("kid", "lower", "Another", "a small network", metric="kid"),
    "retrieval": MetricInfo("retrieval", "higher", metric="retrieval"),
    "retrieval_gray": MetricInfo("retrieval gray", "higher", metric="retrieval"),
}
MEANS = {"unstyled": 0.5, "noise": 0.9, "pasted": 0.1, "palette": 0.3}
"""Of ``color_match``; ``retrieval`` is as much less than 1, and infinite for the photographs."""
FAILED = ("palette", 0, "scene1", "image1")
MESSAGE = "RuntimeError: <b>nan</b> after 3 steps"
ORIGIN = Origin(code="0123abc", versions={"python": "3.11"}, machine="A machine")


def write_figures(inputs, root: Path, methods=tuple(SPECS)) -> None:
    """What a judge might have found in the results of these methods."""
    for name in methods:
        write_json(root / name / "method.json", msgspec.to_builtins(SPECS[name]))
    rows, wholes = [], []
    for cell in (cell for name in sorted(methods) for cell in cells_of(root, name)):
        guide = inputs.style(cell.style).guide
        if guide in SPECS[cell.method].guides:
            failed = tuple(cell) == FAILED
            record = Record("failed", MESSAGE) if failed else Record("done", "", 2.0, 6.0, 100.0, ORIGIN)
            write_json(cell.record(root), msgspec.to_builtins(record))
            mean = MEANS[cell.method] + 0.01 * cell.seed
            figures = {"color_match": mean, "retrieval": 1 - mean, "retrieval_gray": None}
            seconds = None if cell.method == "pasted" else 10 * mean
            values = (record.status, record.message, seconds, 0.0, 100.0)
            rows.append(CellFigures(*cell, guide, *values, {} if failed else figures, origin=record.origin.key))
    for method in {row.method for row in rows}:
        wholes += [SceneFigures(method, 0, scene.name, "image", {"kid": 2.0}) for scene in inputs.track.scenes]
    table = []
    for method, guide in dict.fromkeys((row.method, row.guide) for row in rows):
        states = [row.status for row in rows if (row.method, row.guide) == (method, guide)]
        mean = MEANS[method]
        figures = {
            "color_match": Interval(mean, mean - 0.1, mean + 0.1, len(states)),
            "retrieval": Interval("inf", None, None, 9) if method == "unstyled" else Interval(1 - mean, None, None, 9),
        }
        figures |= {"kid": Interval(2.0, None, None, 2)} if guide == "image" and method != "noise" else {}
        table.append(TableRow(method, guide, len(states), len(states) - states.count("done"), figures))
    documents = {name: SPECS[name] for name in methods}
    found = Figures(bind(inputs, root), METRICS, documents, rows, wholes, table, {ORIGIN.key: ORIGIN})
    write_json(root / FIGURES, msgspec.to_builtins(found))


@pytest.fixture(scope="module")
def judged(tmp_path_factory):
    """A track's file, and a folder of judged results."""
    folder = tmp_path_factory.mktemp("world")
    track = write_track(folder / "track", scenes=2, images=2, texts=1, views=4)
    inputs = write_results(track, folder / "results", seeds=2)
    write_figures(inputs, folder / "results")
    return track, folder / "results"


@pytest.fixture(scope="module")
def site(judged, tmp_path_factory):
    """The site of these results."""
    out = tmp_path_factory.mktemp("site")
    main([str(judged[1]), "--out", str(out), "--track", str(judged[0])])
    return out


@pytest.fixture
def index(page, site):
    """Its first page in a browser; nothing was amiss by the end."""
    return _opened(page, site / "index.html")


def _opened(page, path, place=""):
    page.goto(f"{path.as_uri()}{place}")
    return page


def text(page, selector, part="textContent"):
    """Of the first element that a selector finds."""
    return page.evaluate("([selector, part]) => document.querySelector(selector)?.[part]", [selector, part])


def set_value(page, selector, value):
    """Choose a value as a person does."""
    script = """([selector, value]) => {
        const node = document.querySelector(selector);
        node.value = value;
        node.dispatchEvent(new Event('input', {bubbles: true}));
    }"""
    page.evaluate(script, [selector, value])


def names(page, table="image"):
    """The methods of a table that are shown, in order."""
    rows = f"document.querySelectorAll('table[data-guide={table}] tbody tr:not([hidden])')"
    return page.evaluate(f"[...{rows}].map((row) => row.dataset.method)")


def marked(page, rank, column="color_match"):
    rows = f"document.querySelectorAll('table[data-guide=image] td[data-name={column}][data-rank={rank}]')"
    return page.evaluate(f"[...{rows}].map((cell) => cell.parentNode.dataset.method)")


def press(page, name, table="image"):
    page.click(f"table[data-guide={table}] th[data-name={name}] button")


def test_tables_sort_by_any_column(index):
    order = "document.querySelector('table[data-guide=image] th[data-name={}]').ariaSort"
    press(index, "color_match")
    assert names(index) == ["pasted", "palette", "unstyled", "noise"]  # the best first
    assert index.evaluate(order.format("color_match")) == "ascending"
    index.keyboard.press("Enter")  # the button has the focus
    assert names(index) == ["noise", "unstyled", "palette", "pasted"]
    assert index.evaluate(order.format("color_match")) == "descending"
    assert "color match" in text(index, "#status")
    press(index, "retrieval")
    assert names(index)[:2] == ["unstyled", "pasted"]  # infinity is a number
    assert index.evaluate(order.format("color_match")) is None
    for _ in range(2):
        press(index, "kid")
        assert names(index)[-1] == "noise"  # what is not known is last, whichever way
    press(index, "method")
    assert names(index) == ["pasted", "noise", "palette", "unstyled"]
    press(index, "cells")
    assert names(index)[0] == "noise"
    press(index, "seconds", "text")
    assert names(index, "text") == ["unstyled", "noise"]
    assert names(index)[0] == "noise"  # the other table is as it was


def test_tables_filter_and_mark_the_best_of_what_is_shown(index):
    assert (marked(index, "best"), marked(index, "second")) == (["pasted"], ["palette"])
    assert marked(index, "best", "retrieval") == ["pasted"]  # and not the photographs, which are a baseline
    index.click("#filters [name=consistent]")
    assert "pasted" not in names(index)
    assert (marked(index, "best"), marked(index, "second")) == (["palette"], ["noise"])
    assert text(index, "[data-method=palette] .mark") == " best"
    index.click("#filters [name=baselines]")
    assert names(index) == ["noise", "palette"]
    assert names(index, "text") == ["noise"]
    assert text(index, "#status") == "2 of 4 methods; 1 of 2 methods"
    index.click("#filters [name=words]")
    index.keyboard.insert_text("PALETTE")
    assert names(index) == ["palette"]
    hidden = "document.querySelector('table[data-guide=image] th[data-name=retrieval_gray]')"
    assert index.evaluate(hidden) is None  # no method has it
    assert index.evaluate("document.querySelectorAll('th[data-name=kid]').length") == 1  # nothing of it by text
    index.click("#filters summary")
    index.click("#filters [value=kid]")
    assert text(index, "th[data-name=kid]", "hidden")
    assert index.evaluate("[...document.querySelectorAll('td[data-name=kid]')].every((cell) => cell.hidden)")


def test_a_table_says_what_failed_what_stands_in_and_how_sure_it_is(index):
    row = text(index, "table[data-guide=image] [data-method=palette]", "innerText")
    assert "3 of 4" in row and "1 failed" in row
    assert text(index, "th[data-name=kid]", "innerText").endswith("†")
    assert "kid (a small network)" in index.evaluate("document.body.innerText")
    bar = "[...document.querySelectorAll('table[data-guide=image] [data-method=palette] td[data-name=color_match] {}')]"
    path = index.evaluate(bar.format("path") + "[0].getAttribute('d')")
    # Methods reach from 0 (pasted, less a tenth) to 1 (noise, and a tenth): the photographs are a baseline.
    assert path == "M20.0 4H40.0"
    assert index.evaluate(bar.format("circle") + "[0].getAttribute('cx')") == "30.0"
    name = index.evaluate(bar.format("button") + "[0].textContent.trim()")
    assert name.startswith("0.3 (95 % interval 0.2 to 0.4)")


def test_a_number_opens_the_pictures_behind_it(errors, index, site):
    index.click("table[data-guide=image] [data-method=palette] td[data-name=color_match] button")
    wait(index, "document.querySelector('dialog').open")
    assert text(index, "dialog h2") == "Palette: color match"
    tiles = index.evaluate("[...document.querySelectorAll('dialog li')].map((tile) => tile.innerText.split(/\\n+/))")
    assert len(tiles) == 4
    assert tiles[0] == ["0.3", "scene0, image0"]
    assert tiles[-1] == [f"failed: {MESSAGE}", "–", "scene1, image1"]  # what there is no figure of is last
    wait(index, "[...document.querySelectorAll('dialog img')].every((image) => image.complete && image.naturalWidth)")
    index.keyboard.press("Escape")
    wait(index, "!document.querySelector('dialog').open")
    assert index.evaluate("document.activeElement.closest('td').dataset.name") == "color_match"
    index.click("table[data-guide=image] [data-method=palette] td[data-name=kid] button")  # of all styles of a scene
    assert text(index, "dialog li", "innerText").split("\n")[0] == "2 (the scene's)"
    assert text(index, "dialog a", "href") == (site / "cells/palette/scene0/image0.avif").as_uri()
    assert text(index, "dialog .style", "alt") == "image0"
    assert errors == []


def test_cost_against_quality_is_drawn_with_intervals(index):
    wait(index, "!!document.querySelector('#plot svg')")
    assert index.evaluate("document.querySelectorAll('#plot g').length") == 3
    assert HOSTILE in text(index, "#unplotted")  # it has no seconds
    height = "(line) => line.y1.baseVal.value - line.y2.baseVal.value"
    heights = index.evaluate(f"[...document.querySelectorAll('#plot g line')].map({height})")
    assert min(heights) > 20
    assert max(heights) == pytest.approx(min(heights))  # all intervals are two tenths
    labels = "[...document.querySelectorAll('#plot text:not(.tick)')].map((text) => text.textContent)"
    assert "The photographs" in index.evaluate(labels)
    set_value(index, "#axes [name=metric]", "kid")
    assert "kid, lower is better" in index.evaluate(labels)
    set_value(index, "#axes [name=guide]", "text")
    assert "No method has this score" in text(index, "#plot")


def test_methods_have_cards(errors, index):
    for method, said in (
        ("noise", "python} 'my noise.py'"), ("noise", "numpy==2.1.0"), ("later", "not run: needs <CUDA>"),
        ("palette", "anystyle stylize method=palette"), ("palette", "A machine"), ("palette", "100 MiB"),
        ("pasted", "images made elsewhere"),
    ):  # fmt: skip
        assert said in text(index, f"#method-{method}", "innerText")
    assert "--track track.toml" in text(index, "#submit ~ pre:nth-of-type(2)", "innerText")
    links = index.evaluate("[...document.querySelectorAll('#method-pasted a')].map((link) => link.href)")
    assert links == ["https://example.org/code"]  # and no script of somebody's spec
    assert text(index, "#method-pasted h3", "innerText").startswith(HOSTILE)
    assert errors == []


def test_nothing_is_asked_of_the_network(page, errors, site):
    asked = []
    page.on("request", lambda request: asked.append(request.url))
    _opened(page, site / "index.html")
    page.click("table[data-guide=image] [data-method=palette] td[data-name=color_match] button")
    wait(page, "[...document.images].every((image) => image.complete)")
    assert len(asked) > 8
    assert {url.partition(":")[0] for url in asked} <= {"file", "data"}
    assert errors == []


def test_slips_are_one_line(judged, tmp_path):
    track, results = judged
    other, out = track.parent / "other.toml", ["--out", str(tmp_path / "site")]
    other.write_text(track.read_text().replace("version = 1", "version = 2"))
    for args, message in (
        ([tmp_path], r"there is no .*figures.json; run `anystyle benchmark judge"),
        ([results, "--track", other], "another version of track or judge"),
        ([results, "--track", track, "--quality", "0"], "give 1 to 100"),
    ):
        with pytest.raises(UserError, match=message):
            main([*map(str, args), *out])
    assert not (tmp_path / "site").exists()
