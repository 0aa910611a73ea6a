"""Streamed SOG: levels keep moments, styles share geometry, and the page shows a picture after at most a megabyte."""

import json
import subprocess
import threading
import zipfile
from dataclasses import replace
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest
import torch
from PIL import Image

from anystyle.errors import UserError
from anystyle.pipeline.export import export
from anystyle.pipeline.saved import read_saved
from anystyle.types import Gaussians, StyledScene
from anystyle_formats import levels
from anystyle_formats.html import Html
from anystyle_formats.levels import (
    Level,
    area,
    coarser,
    columns_with,
    covariances,
    levels_of,
    merged,
    moments_of,
)
from anystyle_formats.lod import Lod, index_of
from anystyle_formats.packing import columns_of, cuts, kd_order
from anystyle_formats.sog import Sog
from tests.support.browser import errors_of, new_page, wait
from tests.support.export_readers import SPLAT_TRANSFORM
from tests.support.export_scene import camera, picture, psnr, scene


def styled(count=400, coefficients=4):
    plain = scene(coefficients, count)
    return StyledScene(
        (("unstyled", plain), ("blue", replace(plain, harmonics=plain.harmonics.flip(-1)))), camera(), ("front",)
    )


def faint(count=500):
    """So faint that no opacity of merged Gaussians exceeds 1."""
    columns = columns_of(styled(count).splats())
    return columns._replace(opacities=columns.opacities / 1000)


def moments(columns):
    """Mass, mean, second moments and mean colour, of all Gaussians together."""
    spread = covariances(columns)
    weights = columns.opacities * area(spread)
    second = spread + columns.means[:, :, None] * columns.means[:, None]
    return [
        np.tensordot(weights, each, 1) for each in (np.ones(len(weights)), columns.means, second, columns.harmonics)
    ]


def test_two_gaussians_become_one_with_their_moments():
    both = faint(2)
    each = moments_of(both)
    one = columns_with(merged(each.rows(np.array([0])), each.rows(np.array([1]))))
    for found, expected in zip(moments(one), moments(both), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-15)
    first, second = covariances(both)
    share = 1 / (1 + both.opacities[1] * area(second) / both.opacities[0] / area(first))
    away = both.means[0] - both.means[1]
    spread = share * first + (1 - share) * second + share * (1 - share) * np.outer(away, away)
    np.testing.assert_allclose(covariances(one)[0], spread, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(one.rotations, axis=1), 1)


def test_the_area_of_a_disc_and_of_a_ball():
    np.testing.assert_allclose(area(np.stack([np.diag([4.0, 9, 0]), np.eye(3)])), [6, np.sqrt(3)])


def test_coarser_levels_keep_all_moments_and_leaves(monkeypatch):
    monkeypatch.setattr(levels, "CHUNK", 128)
    monkeypatch.setattr(levels, "COARSEST", 40)
    columns = faint()
    made = levels_of(columns)
    assert [len(level.leaf) for level in made] == [500, 141, 40]
    for level in made:
        assert set(level.leaf) == {0, 1, 2, 3} and bool((np.diff(level.leaf) >= 0).all())
        for found, expected in zip(moments(level.columns), moments(columns), strict=True):
            np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)
    opaque = coarser(Level(columns._replace(opacities=np.ones(500)), np.zeros(500, np.int64)), 20)
    assert len(opaque.leaf) == 20 and float(opaque.columns.opacities.max()) == 1
    apart = coarser(Level(columns, np.arange(500)), 20)
    assert len(apart.leaf) == 500


def test_cells_of_a_tree_do_not_overlap():
    points = np.random.default_rng(0).standard_normal((77, 3))
    order = kd_order(points, 1)
    axis = np.ptp(points, axis=0).argmax()
    lower, upper = np.split(points[order, axis], cuts(77, 2)[1:-1])
    assert sorted(order) == list(range(77)) and lower.max() <= upper.min() and len(lower) == 38


def leaves_of(node):
    return [leaf for child in node["children"] for leaf in leaves_of(child)] if "children" in node else [node]


def test_ranges_of_leaves_fill_every_chunk(monkeypatch):
    monkeypatch.setattr(levels, "CHUNK", 64)
    monkeypatch.setattr(levels, "COARSEST", 40)
    made = levels_of(faint(700))
    index = index_of(made)
    leaves = leaves_of(index["tree"])
    assert index["counts"] == [700, 167, 40] and index["count"] == 907 and index["lodLevels"] == 3
    assert len(leaves) == 16 and len(index["filenames"]) == 16 + 4 + 1
    for number, level in enumerate(made):
        rows = 0
        for file in dict.fromkeys(leaf["lods"][str(number)]["file"] for leaf in leaves):
            end = 0
            for leaf in (leaf for leaf in leaves if leaf["lods"][str(number)]["file"] == file):
                place, bound = leaf["lods"][str(number)], leaf["bound"]
                assert place["offset"] == end
                means = level.columns.means[rows + end : rows + end + place["count"]]
                assert bool(((means > bound["min"]) & (means < bound["max"])).all())
                end += place["count"]
            assert index["filenames"][file].startswith(f"{number}_") and end <= 80
            rows += end
        assert rows == index["counts"][number]
    union = np.array([leaf["bound"]["min"] for leaf in leaves]).min(0)
    np.testing.assert_array_equal(index["tree"]["bound"]["min"], union)


def read_chunk(folder, name):
    """A chunk, as a SOG archive of the images that it names."""
    path, meta = folder / f"{name}.sog", json.loads((folder / name / "meta.json").read_text())
    with zipfile.ZipFile(path, "w") as archive:
        for part in (part for part in meta.values() if isinstance(part, dict) and "files" in part):
            for file in part["files"]:
                archive.write(folder / name / file, file.rpartition("/")[2])
            part["files"] = [file.rpartition("/")[2] for file in part["files"]]
        archive.writestr("meta.json", json.dumps(meta))
    return Sog().read(path).styles[0][1]


def test_a_single_level_is_what_sog_has_in_every_style(tmp_path):
    styles = styled()
    Lod().write(styles, tmp_path / "scene.lod")
    Lod().write(styles, tmp_path / "scene.lod")  # what was written before is replaced
    for index, inside in enumerate(("styles/1-unstyled", "")):
        Sog().write(replace(styles, styles=styles.styles[: index + 1]), tmp_path / "scene.sog")
        expected = Sog().read(tmp_path / "scene.sog").styles[0][1]
        found = read_chunk(tmp_path / "scene.lod" / inside, "0_0")
        for name in ("means", "rotations", "scales", "opacities", "harmonics"):
            torch.testing.assert_close(getattr(found, name), getattr(expected, name))


def test_styles_share_the_images_of_their_geometry(tmp_path, monkeypatch):
    monkeypatch.setattr(levels, "CHUNK", 128)
    monkeypatch.setattr(levels, "COARSEST", 100)
    styles, folder = styled(), tmp_path / "scene.lod"
    Lod().write(styles, folder)
    written = {file.relative_to(folder).as_posix() for file in folder.rglob("*.webp")}
    assert {name for name in written if "means" in name} == {
        f"{chunk}/means_{part}.webp" for chunk in ("0_0", "0_1", "0_2", "0_3", "1_0") for part in "lu"
    }
    index = json.loads((folder / "lod-meta.json").read_text())
    other = json.loads((folder / "styles/1-unstyled/lod-meta.json").read_text())
    assert other | {"asset": None} == index | {"asset": None}
    assert [each["asset"]["title"] for each in (other, index)] == ["unstyled", "blue"]
    for inside, (_, given) in zip(("styles/1-unstyled", ""), styles.styles, strict=True):
        chunks = [read_chunk(folder / inside, name.partition("/")[0]) for name in index["filenames"]]
        finest = Gaussians(**{name: torch.cat([vars(each)[name] for each in chunks[:4]], 1) for name in vars(given)})
        assert finest.means.shape == given.means.shape
        assert psnr(picture(finest), picture(given)) > 34
        assert psnr(picture(chunks[4]), picture(given)) > 20
    coarse = [read_chunk(folder / inside, "1_0") for inside in ("styles/1-unstyled", "")]
    assert torch.equal(coarse[0].means, coarse[1].means) and torch.equal(coarse[0].opacities, coarse[1].opacities)
    torch.testing.assert_close(coarse[0].harmonics.flip(-1), coarse[1].harmonics, atol=0.03, rtol=0)


def test_a_folder_is_read_in_its_finest_level_and_all_styles(tmp_path, monkeypatch):
    monkeypatch.setattr(levels, "CHUNK", 128)
    monkeypatch.setattr(levels, "COARSEST", 100)
    styles = replace(styled(), notes=("of a street",))
    Lod().write(styles, tmp_path / "web")
    read = read_saved(tmp_path / "web")
    assert read.notes[0] == "of a street"
    for (title, found), (name, given) in zip(read.styles, styles.styles, strict=True):
        assert title == name and found.means.shape == given.means.shape
        assert psnr(picture(found), picture(given)) > 34
    one = read_saved(tmp_path / "web" / "styles" / "1-unstyled").styles
    assert [title for title, _ in one] == ["unstyled"] and torch.equal(one[0][1].means, read.styles[0][1].means)


def test_a_leaf_is_read_in_the_finest_level_that_it_has_and_what_is_always_shown_with_it(tmp_path):
    """As the format allows: leaves that lack levels, a chunk for several leaves, an environment without harmonics."""
    styles = styled()
    Lod().write(styles, tmp_path / "web")
    Lod().write(StyledScene((("sky", scene(1, 20)),)), tmp_path / "web" / "env")
    place = {"file": 0, "count": 100}
    leaves = [{"lods": {"1": {**place, "offset": 300}, "2": place}}, {"lods": {"0": {**place, "offset": 0}}}]
    index = {"filenames": ["0_0/meta.json"], "environment": "env/0_0/meta.json", "tree": {"children": leaves}}
    whole = read_chunk(tmp_path / "web", "0_0")
    (tmp_path / "web" / "lod-meta.json").write_text(json.dumps(index))
    title, found = read_saved(tmp_path / "web").styles[-1]
    assert title == "web" and found.means.shape[1] == 220
    torch.testing.assert_close(found.means[0, :200], torch.cat([whole.means[0, 300:], whole.means[0, :100]]))
    assert not found.harmonics[0, 200:, 1:].any() and bool(found.harmonics[0, :200, 1:].any())


@pytest.mark.parametrize(
    "change",
    [
        lambda index: index.pop("tree"),
        lambda index: index.update(filenames=["../elsewhere/meta.json"]),
        lambda index: index["tree"]["lods"]["0"].update(offset=7),
        lambda index: index["tree"]["lods"]["0"].update(count=10**9),
        lambda index: index["tree"].update(lods={}),
    ],
)
def test_a_damaged_index_ends_in_one_line(change, tmp_path):
    Lod().write(styled(), tmp_path / "web")
    file = tmp_path / "web" / "lod-meta.json"
    index = json.loads(file.read_text())
    change(index)
    file.write_text(json.dumps(index))
    with pytest.raises(UserError) as caught:
        read_saved(tmp_path / "web")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("count", [1, 2])
def test_a_folder_of_splat_transform_is_read(count, tmp_path):
    if SPLAT_TRANSFORM is None:
        pytest.skip("splat-transform is not installed (npm install -g @playcanvas/splat-transform)")
    given = scene(4)
    export(given, tmp_path / "0.ply", "ply")
    export(given.map(lambda tensor: tensor[:, ::2]), tmp_path / "1.ply", "ply")
    tagged = [word for level in range(count) for word in (f"{tmp_path}/{level}.ply", "--tag-lod", str(level))]
    (tmp_path / "web").mkdir()
    subprocess.run(
        [SPLAT_TRANSFORM, "-w", "-g", "cpu", *tagged, f"{tmp_path}/web/lod-meta.json"], check=True, capture_output=True
    )
    ((_, found),) = read_saved(tmp_path / "web").styles
    assert found.means.shape == given.means.shape and psnr(picture(found), picture(given)) > 34


def test_a_folder_of_others_is_refused_and_stays(tmp_path):
    (tmp_path / "index.html").write_text("mine")
    with pytest.raises(UserError, match=r"index\.html is there already"):
        Lod().write(styled(), tmp_path)
    assert [path.read_text() for path in tmp_path.rglob("*")] == ["mine"]


class Counting(SimpleHTTPRequestHandler):
    """Notes the length of what it sends, and holds back the finest level until it is let go."""

    def copyfile(self, source, outputfile):
        if "/0_" in self.path:
            self.server.finest.wait()
        data = source.read()
        self.server.sent.append((self.path, len(data)))
        outputfile.write(data)

    def log_message(self, *words):
        pass


@pytest.fixture
def server(tmp_path):
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Counting, directory=str(tmp_path / "scene.lod")))
    server.finest, server.sent = threading.Event(), []
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield server
    server.finest.set()
    server.shutdown()
    server.server_close()
    thread.join()


def shot(page, path):
    page.evaluate("document.body.classList.add('bare')")
    page.screenshot(path=path)
    return torch.from_numpy(np.asarray(Image.open(path).convert("RGB")) / 255)


@pytest.mark.slow
def test_what_is_large_on_the_screen_is_refined_first(browser, server, tmp_path, monkeypatch):
    """Of two rooms the near one, level by level, and then the far one."""
    monkeypatch.setattr(levels, "CHUNK", 1000)
    monkeypatch.setattr(levels, "COARSEST", 300)
    plain, far = scene(1, 4000), (torch.arange(4000) % 2)[:, None] * torch.tensor([0.0, 0.0, 40.0])
    styles = StyledScene((("rooms", replace(plain, means=plain.means + far)),), camera(), ("front",))
    Lod().write(styles, tmp_path / "scene.lod")
    Html().write(styles, tmp_path / "scene.html")
    index = json.loads((tmp_path / "scene.lod" / "lod-meta.json").read_text())
    assert index["counts"] == [4000, 1095, 300]
    near = [leaf for leaf in leaves_of(index["tree"]) if leaf["bound"]["max"][2] < 20]
    expected = [{leaf["lods"][level]["file"] for leaf in near} for level in "10"]
    options = {"viewport": {"width": 200, "height": 150}, "color_scheme": "light"}
    with new_page(browser, **options) as page, new_page(browser, **options) as single:
        errors = errors_of(page)
        server.finest.set()
        page.goto(f"http://127.0.0.1:{server.server_port}/")
        wait(page, "document.body.dataset.complete")
        asked = [path[1:] for path, _ in server.sent if path.endswith("/meta.json")]
        chunks = [index["filenames"].index(path) for path in asked]
        first, between, finest = chunks[:1], chunks[1 : 1 + len(expected[0])], chunks[1 + len(expected[0]) :]
        assert index["filenames"][first[0]] == "2_0/meta.json" and sorted(chunks) == list(
            range(len(index["filenames"]))
        )
        assert set(between) == expected[0] and set(finest[: len(expected[1])]) == expected[1]
        single.goto((tmp_path / "scene.html").as_uri())
        wait(single, "document.body.dataset.ready")
        assert psnr(shot(page, tmp_path / "refined.png"), shot(single, tmp_path / "whole.png")) > 38
        assert errors == []


@pytest.mark.slow
def test_the_page_shows_a_coarse_picture_of_a_megabyte_and_refines_it(browser, server, tmp_path):
    styles = styled(70_000, 1)
    styles = replace(
        styles, styles=tuple((title, replace(each, scales=each.scales / 4)) for title, each in styles.styles)
    )
    Lod().write(styles, tmp_path / "scene.lod")
    Html().write(styles, tmp_path / "scene.html")
    options = {"viewport": {"width": 200, "height": 150}, "color_scheme": "light"}
    with new_page(browser, **options) as page, new_page(browser, **options) as single:
        errors = errors_of(page)
        page.goto(f"http://127.0.0.1:{server.server_port}/")
        wait(page, "document.body.dataset.ready")
        first, begun = shot(page, tmp_path / "first.png"), dict(server.sent)
        assert {"/", "/lod-meta.json", "/1_0/meta.json", "/1_0/sh0.webp"} <= begun.keys() and len(begun) == 8
        assert 500_000 < sum(begun.values()) <= 1_000_000
        server.finest.set()
        wait(page, "document.body.dataset.complete")
        refined, complete = shot(page, tmp_path / "refined.png"), len(server.sent)
        assert [path for path, _ in server.sent if path.startswith("/styles")] == []
        single.goto((tmp_path / "scene.html").as_uri())
        wait(single, "document.body.dataset.ready")
        whole = shot(single, tmp_path / "whole.png")
        assert psnr(refined, whole) > 38 and 20 < psnr(first, whole) < psnr(refined, whole) - 3
        page.evaluate("anystyle.choose(0)")
        single.evaluate("anystyle.choose(0)")
        assert psnr(shot(page, tmp_path / "other.png"), shot(single, tmp_path / "single.png")) > 38
        kinds = {path.rpartition("/")[2] for path, _ in server.sent[complete:]}
        assert kinds == {"meta.json", "sh0.webp"} and len(server.sent) == complete + 6
        assert len({path for path, _ in server.sent}) == len(server.sent), "something was sent twice"
        assert errors == []
        page.goto((tmp_path / "scene.lod" / "index.html").as_uri())
        wait(page, "document.body.dataset.ready == 'failed'")
        assert "python -m http.server" in page.inner_text("#status")
