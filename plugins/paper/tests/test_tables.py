"""The paper's protocol in one word: a folder that is held against its layout, and methods side by side."""

import shutil
from itertools import product

import pytest

from anystyle.data.style_folder import FolderStyles
from anystyle.errors import UserError
from anystyle.evaluation import record
from anystyle.registry.catalog import catalog
from anystyle.registry.compose import compose
from anystyle.testing.protocol import runtime
from anystyle.testing.toy.style_encoder import ToyStyleEncoder
from anystyle.types import no_progress
from anystyle_paper import published_scores, run_table
from anystyle_paper.paper_folder import NUM_FRAMES, NUM_STYLES, SCENES, PaperFolder
from anystyle_paper.runs import find
from anystyle_paper.tables import Tables
from tests.support.evaluation_cases import Mean
from tests.support.pictures import picture

TEXTS = "".join(f'{{"image": "{style:02d}.png", "text": "style {style}"}}\n' for style in range(NUM_STYLES))

OPTIONS = {"scene_names": ["Train", "Garden"], "num_styles": 2, "frames": 3, "size": 16}


@pytest.fixture
def root(tmp_path):
    """Two scenes, two styles, three frames; one method lays its renders out in folders, the other in names."""
    folder = tmp_path / "root"
    for s, scene in enumerate(("Train", "Garden")):
        for frame in range(4):
            picture(folder / "content" / scene / f"{frame:05d}.png", 40 * s + 10 * frame, (32, 24))
        for style, frame in product(range(2), range(3)):
            nested = folder / "methods" / "Stylos" / scene.lower() / f"style_{style:02d}"
            picture(nested / f"{frame}.png", 200, (16, 16))
            picture(folder / "methods" / "Styl3R" / scene / f"{style:02d}_{frame:03d}.png", 100, (8, 8))
    for style in range(2):
        picture(folder / "styles" / f"{style:02d}.png", 90 + style, (20, 20))
    (folder / "styles" / "captions.jsonl").write_text(TEXTS)
    return folder


def tables(folder, **options):
    parts = {name: part for name, part in runtime().items() if name == "stylizer"} | {"metrics": {"mean": Mean()}}
    parts |= {"metrics": options.pop("metrics")} if "metrics" in options else {}
    return Tables(**parts, **OPTIONS | {"root": str(folder)} | options)


def test_a_model_that_reads_no_texts_has_one_row(root, tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(ToyStyleEncoder, "reads_texts", False)
    found = tables(root, methods=[], photographs=0).run(tmp_path / "out", no_progress)
    assert found.provenance["methods"] == ["model_image"]
    assert caplog.messages[0] == "this model reads no texts: the row model_text is left out"


def test_every_method_is_a_row_beside_the_model_and_the_photographs(root, tmp_path):
    found = tables(root).run(tmp_path / "out", no_progress)
    assert found.provenance["methods"] == ["model_image", "model_text", "Styl3R", "Stylos", "photographs"]
    assert list(found.groups) == found.provenance["methods"][1:]
    assert found.groups["Stylos"]["mean"] == pytest.approx(200 / 255, abs=1e-6)
    assert found.groups["Styl3R"]["mean"] == pytest.approx(100 / 255, abs=1e-6)
    # Photographs 0, 10, 20 and 40, 50, 60: the mean of the scenes.
    assert found.groups["photographs"]["mean"] == pytest.approx(30 / 255, abs=0.01)
    assert found.times["time_s"] > 0
    stored = record.read(tmp_path / "out" / "methods" / "Stylos")
    assert stored.n == 2 * 2 * 3 and set(stored.scenes) == {"Train", "Garden"}


@pytest.mark.parametrize("name", ["{:03d}", "{:05d}", "frame_{:d}"])
def test_images_that_a_method_lacks_are_named_and_others_keep_their_photographs(root, tmp_path, name):
    folder = root / "methods" / "Styl3R" / "Train"
    for path in folder.iterdir():
        path.unlink()
    for style in ("00", "01"):
        for frame in (0, 1, 2, 3):
            picture(folder / f"{style}_{name.format(frame)}.png", 100 + frame, (8, 8))
    (folder / f"00_{name.format(1)}.png").unlink()
    with pytest.raises(UserError, match="methods/Styl3R: 1 scenes lack images: Train in 00 lacks 1 of 3"):
        Tables.check(**OPTIONS, root=str(root), guides=[], methods=None, missing="refuse")
    found = tables(root, guides=[], missing="allow").run(tmp_path / "out", no_progress)
    stored = record.read(tmp_path / "out" / "methods" / "Styl3R")
    assert (stored.n, stored.size, stored.missing("Train"), stored.missing("Garden")) == (11, "11 of 12", 1, 0)
    assert stored.scenes["Train"]["mean"] == pytest.approx((100 + 102 + 100 + 101 + 102) / 5 / 255, abs=1e-6)
    assert found.missing("Styl3R") == found.missing() == 1
    (line,), _ = run_table.lines_of(find(tmp_path / "out" / "methods" / "Styl3R"))
    assert line.title == "Styl3R (1 images missing)"


def test_names_of_a_methods_images_are_read_whole(root):
    for scene in ("Train", "Garden"):
        for style, frame in product(("van_gogh", "wave"), range(3)):
            picture(root / "methods" / "mine" / scene / f"{style}_frame_{frame:05d}.png", 100, (8, 8))
    for style in ("van_gogh", "wave"):
        picture(root / "styles" / f"{style}.png", 90)
    layout = PaperFolder(root, ("Train", "Garden"), 4, 3)
    assert [gap.style for gap in layout.gaps("mine")] == ["00", "01", "00", "01"]
    assert [path.stem for path in layout.renders("mine")["Train", "van_gogh"].values()] == [
        f"van_gogh_frame_{frame:05d}" for frame in range(3)
    ]


def test_the_layout_is_checked_before_anything_is_computed(root):
    (root / "content" / "Train" / "00003.png").unlink()
    (root / "content" / "Train" / "00002.png").unlink()
    shutil.rmtree(root / "methods" / "Stylos" / "garden" / "style_01")
    (root / "styles" / "captions.jsonl").write_text('{"image": "00.png", "text": "waves"}\n')
    with pytest.raises(ValueError, match="content/Train: 2 photographs, fewer than 3") as caught:
        tables(root)
    for said in ("styles: no text for 1 styles, such as 01.png", "methods/Stylos: 1 scenes", "Garden in 01"):
        assert said in str(caught.value)
    with pytest.raises(ValueError, match="methods/ARF: there is no such folder"):
        tables(root, methods=["ARF"])


def test_the_published_descriptions_are_the_texts(root, tmp_path):
    """As AnyStyle's authors lay the archive out: ``style_images`` beside ``style_descriptions.txt``."""
    (root / "styles").rename(root / "style_images")
    (root / "style_images" / "captions.jsonl").unlink()
    with pytest.raises(ValueError, match="no text for 2 styles"):
        tables(root)
    (root / "style_descriptions.txt").write_text("00.png;thick blue; swirling strokes\n01.png; flat ochre\n")
    found = tables(root, methods=[], photographs=0).run(tmp_path / "out", no_progress)
    assert found.provenance["methods"] == ["model_image", "model_text"]
    styles = FolderStyles(root=str(root / "style_images"), size=16)
    assert [styles.read(place).text for place in range(2)] == [("thick blue; swirling strokes",), ("flat ochre",)]


def test_a_complete_folder_passes(tmp_path):
    for scene in SCENES:
        for frame in range(NUM_FRAMES):
            picture(tmp_path / "content" / scene / f"{frame}.png", 50)
    for style in range(NUM_STYLES):
        picture(tmp_path / "styles" / f"{style:02d}.png", 60)
    (tmp_path / "styles" / "captions.jsonl").write_text(TEXTS)
    assert PaperFolder(tmp_path).problems() == []


def test_a_table_takes_the_metrics_of_its_scores(root):
    both = {"art_fid": Mean("art_fid"), "other": Mean("warp_rmse_short")}
    assert list(tables(root, metrics=both, table="table_2").metrics) == ["art_fid"]
    assert list(tables(root, metrics=both, table="table_4").metrics) == ["other"]
    with pytest.raises(ValueError, match="no metric that is chosen has a score of table_5"):
        tables(root, metrics={"other": Mean("warp_rmse_short")}, table="table_5")
    with pytest.raises(ValueError, match="root is not given"):
        tables(root, root=None)


PRINTED = ["Train", "Truck", "M60", "Garden"]
SCENES_OF = {"table_2": PRINTED, "table_3": PRINTED, "table_4": PRINTED, "table_5": PRINTED[:2], "table_6": PRINTED[2:]}


@pytest.mark.parametrize(("name", "scenes"), SCENES_OF.items())
def test_each_table_of_scores_is_a_word(name, scenes):
    config = compose("evaluate", [f"protocol={name.replace('_', '')}", "root=x"])
    assert (config.protocol.table, config.protocol.variant.value) == (name, "reference")
    assert list(config.protocol.scene_names) == scenes
    judges = [catalog().find("metric", metric).load() for metric in config.metric]
    assert {*published_scores.tables()[name]} <= {"time_s"}.union(*(judge.better for judge in judges))
    # No table but the second and the fourth shows photographs, and the third's rows are models.
    assert (config.protocol.photographs > 0) is (name in ("table_2", "table_4"))
    assert (config.protocol.methods == []) is (name == "table_3")
