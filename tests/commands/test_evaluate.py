"""`anystyle evaluate`: any method's folders, a model on a protocol, and what it says when it cannot."""

import csv
import json
import math
import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from omegaconf import OmegaConf
from PIL import Image

from anystyle.commands import evaluate as command
from anystyle.commands import plugins_new
from anystyle.evaluation.tables import STAND_IN
from anystyle.registry.compose import compose
from tests.support.evaluation_cases import folders
from tests.support.pictures import picture
from tests.support.program import failing

TOY = ["metric=[plain_change]"]


@pytest.fixture(scope="module")
def plugins(tmp_path_factory) -> Path:
    """A folder with a metric that needs no network."""
    into = tmp_path_factory.mktemp("plugins")
    assert plugins_new.main(["metric", "plain_change", "--into", str(into)]) == 0
    return into


@pytest.fixture(autouse=True)
def _listed(plugins, monkeypatch, tmp_path):
    monkeypatch.setenv("ANYSTYLE_PLUGINS", f"{Path(__file__).parents[2] / 'plugins'}:{plugins}")
    monkeypatch.chdir(tmp_path)


def run(*words):
    command.main([str(word) for word in words])


def flags(content, style, stylized):
    return ["--content", content, "--style", style, "--stylized", stylized]


fails = partial(failing, command.main)


def metrics(out):
    return json.loads((Path(out) / "metrics.json").read_text())


def test_folders_of_any_method(tmp_path, capsys):
    run(*flags(*folders(tmp_path / "in")), *TOY, "--out", "out")
    found = metrics("out")
    # Results are 60 s + 20 t + f, photographs 100 + f: the change is known.
    assert found["scene one"]["change"] == pytest.approx((100 + 80) / 2 / 255, rel=1e-5)
    assert found["scene two"]["change"] == pytest.approx((40 + 20) / 2 / 255, rel=1e-5)
    assert found["change"] == pytest.approx(60 / 255, rel=1e-5)
    known = found["provenance"]
    assert (known["protocol"], known["variant"], known["n"]) == ("folders", "reference", 12)
    assert known["seconds"] > 0 and known["machine"] and known["versions"]["anystyle"]
    rows = list(csv.DictReader(Path("out/metrics.csv").read_text().splitlines()))
    assert [(row["scene"], row["style"]) for row in rows] == [("one", "a"), ("one", "b"), ("two", "a"), ("two", "b")]
    assert float(rows[3]["change"]) == pytest.approx(20 / 255, rel=1e-5)
    for name in ("table.md", "table.tex", "examples.png", "spread.png"):
        assert (Path("out") / name).is_file(), name
    assert "| change ↓ |" in capsys.readouterr().out
    with Image.open("out/examples.png") as sheet:
        assert sheet.width > 4 * 160


def test_missing_images_are_refused_or_said_in_every_table(tmp_path, capsys):
    content, style, stylized = folders(tmp_path / "in")
    picture(style / "c.png", 0)
    (stylized / "one" / "a_1.png").unlink()
    given = [*flags(content, style, stylized), *TOY, "--out", "out"]
    told = "7 of 18 stylized images are missing: style c (all 6), one/a (1 of 3: 001)"
    assert f"{told}; add them, or missing=allow to judge what is there" in fails(capsys, *given)
    run(*given, "missing=allow")
    shown = capsys.readouterr()
    assert told in shown.out
    assert all(f"\n| {name} missing) |" in shown.out for name in ("all (7", "one (4", "two (3"))
    assert "n = 11 of 18" in shown.out
    assert metrics("out")["provenance"]["missing"][0] == {"scene": "one", "style": "a", "n": 2, "missing": 1}
    rows = list(csv.DictReader(Path("out/metrics.csv").read_text().splitlines()))
    assert [f"{row['n']} and {row['missing']}" for row in rows[:3]] == ["2 and 1", "3 and 0", "0 and 3"]
    assert rows[2]["change"] == ""
    (style / "c.png").unlink()
    picture(stylized / "one" / "a_1.png", 1)
    run(*given)  # in the same folder
    assert metrics("out")["provenance"]["n"] == 12


def test_inputs_that_do_not_exist_are_told_before_networks_are_built(tmp_path, capsys, monkeypatch):
    def built(*_):
        pytest.fail("a network is built")

    monkeypatch.setattr("anystyle.evaluation.run.make_parts", built)
    content, style, stylized = folders(tmp_path / "in")
    (stylized / "one" / "a_1.png").unlink()
    cases = {
        "there is no stylized folder": flags(content, style, tmp_path / "absent"),
        "1 of 12 stylized images are missing": flags(content, style, stylized),
        "absent: content/Train: 0 photographs": ["protocol=table2", f"root={tmp_path}/absent"],
        "root is not given": ["protocol=table2"],
        "there is no such folder": ["protocol=paper_image", "scenes=folder", f"scenes.root={tmp_path}/absent"],
        "absent: there is no such": ["scenes=procedural", "styles=folder", f"styles.root={tmp_path}/absent"],
        "this needs styles": ["scenes=procedural"],
        "scene_names: there is no scene 'x'": ["scenes=procedural", "protocol.scene_names=[x]"],
        "there is no run": ["--run", tmp_path / "absent"],
    }
    for told, words in cases.items():
        assert told in fails(capsys, *words, *TOY, "--out", "out"), told


def test_a_model_on_a_protocol_resumes_and_is_bound_to_its_configuration(tmp_path, capsys):
    words = [
        "protocol=paper_image", "protocol.num_styles=2", "protocol.num_scenes=1", "protocol.frames=2",
        "scenes=procedural", "scenes.size=112", "scenes.num_scenes=2", "scenes.views=2",
        "styles=procedural", "styles.size=48", "styles.split=heldout", *TOY,
    ]  # fmt: skip
    state = torch.random.get_rng_state()
    run(*words, "--out", "out")
    found = metrics("out")
    assert torch.equal(torch.random.get_rng_state(), state)  # the caller's random numbers go on
    assert math.isfinite(found["change"]) and found["provenance"]["n"] == 4
    assert set(found["provenance"]["weights"]) >= {"backbone", "style_encoder", "style_encoder/magenta_text", "branch"}
    assert all(len(row["sha256"]) == 64 for row in found["provenance"]["weights"].values())
    (scene,) = Path("out/images/stylized").iterdir()
    kept = sorted(path for path in scene.iterdir() if path.suffix == ".jpg")
    assert [path.stem for path in kept] == ["00_000", "00_001", "01_000", "01_001"]
    (Path("out/images/depth") / scene.name / "000.npy").unlink()
    kept[2].unlink()
    run(*words, "--out", "out")
    assert metrics("out")["provenance"]["n"] == 4 and kept[2].is_file()
    times = [path.stat().st_mtime_ns for path in kept]
    run(*words, "--out", "out")
    assert [path.stat().st_mtime_ns for path in kept] == times
    shutil.copy("out/images/style/00.jpg", "out/images/style/01.jpg")
    assert "style 01 is no longer that of the renders, out/images" in fails(capsys, *words, "--out", "out")
    told = fails(capsys, *words, "variant=corrected", "--out", "out")
    assert "out holds an evaluation of another configuration (protocol.variant reference -> corrected" in told
    assert "choose another --out, or delete that folder" in told


def test_scores_of_stand_in_networks_say_so_in_every_table(tmp_path, capsys):
    given = flags(*folders(tmp_path / "in", scenes=("one",), styles=("a",), frames=2))
    for path in sorted((tmp_path / "in").rglob("*.png")):
        noise = np.random.default_rng(len(path.name)).integers(0, 255, (48, 48, 3), dtype=np.uint8)
        Image.fromarray(noise).save(path)
    run(*given, "metric=[lpips]", "metric.lpips.size=null", "metric.lpips.weights=stand_in", "--out", "out")
    assert metrics("out")["provenance"]["stand_ins"].keys() == {"lpips"} and STAND_IN in capsys.readouterr().out
    for name in ("table.md", "table.tex", "metrics.csv"):
        assert STAND_IN in (Path("out") / name).read_text(), name


def test_a_trained_run_is_judged_with_its_own_weights(tmp_path, caplog):
    from anystyle.pipeline.load import weights_file

    for number in range(2):
        folder = tmp_path / "sweep" / str(number)
        folder.mkdir(parents=True)
        shutil.copy(weights_file("tiny_branch"), folder / "branch.safetensors")
        (folder / "bound.json").write_text(json.dumps({"weights.backbone": "tiny_backbone", "seed": 0}))
    words = ["protocol.num_styles=1", "protocol.num_scenes=1", "protocol.frames=1", *TOY]
    words += ["scenes=procedural", "scenes.size=112", "scenes.views=2", "styles=procedural", "styles.size=48"]
    (tmp_path / "sweep" / "2" / ".hydra").mkdir(parents=True)  # of a job that has not ended
    run("--run", tmp_path / "sweep", *words)
    assert f"jobs of {tmp_path / 'sweep'} without branch.safetensors are left out: 2" in caplog.messages
    one, other = (metrics(tmp_path / "sweep" / str(number) / "evaluation") for number in range(2))
    assert one["change"] == other["change"] and one["provenance"]["weights"]["branch"]["file"] == "branch.safetensors"


def test_variants_compose_and_set_every_metric():
    for variant in ("reference", "corrected"):
        config = OmegaConf.to_container(compose("evaluate", [f"variant={variant}"]), resolve=True, enum_to_str=True)
        assert config["variant"] == config["protocol"]["variant"] == variant
        chosen = {name: node for name, node in config["metric"].items() if "_target_" in node}
        assert {"art_fid", "warp_consistency"} <= set(chosen)
        assert all(node.get("variant", variant) == variant for node in chosen.values())
    mine = compose("evaluate", ["metric=[psnr]"])
    assert [name for name, node in mine.metric.items() if "_target_" in node] == ["psnr"]


def test_what_cannot_be_judged_is_one_line_and_leaves_nothing(tmp_path, capsys):
    content, style, stylized = folders(tmp_path / "in")
    given = flags(content, style, stylized)
    (tmp_path / "empty").mkdir()
    cases = {
        "--style, --stylized are missing": ["--content", content],
        "there is no style folder": flags(content, tmp_path / "absent", stylized),
        "the stylized folder": flags(content, style, tmp_path / "empty"),
        "Could not find 'metric/plain_chagne'. Did you mean 'plain_change'?": [*given, "metric=[plain_chagne]"],
        "--run judges a model, and --stylized judges images": [*given, "--run", tmp_path],
        "holds no finished training": ["--run", tmp_path / "empty"],
        "this needs scenes; add scenes=NAME": [*TOY],
        "unrecognized arguments: --contnet": ["--contnet", content],
    }
    for told, words in cases.items():
        extra = [] if any("metric" in str(word) for word in words) else TOY
        line = fails(capsys, *words, *extra, "--out", "out")
        assert told in line, line
        assert not Path("out").exists() or not any(Path("out").glob("metrics.*")), told
    picture(stylized / "one" / "c_0.png", 0)
    line = fails(capsys, *given, *TOY, "--out", "out")
    assert "1 of 13 stylized images have no partner: one/c_0 (no style c)" in line


def test_two_evaluations_do_not_share_a_folder(tmp_path, capsys):
    from anystyle.io.atomic import folder_lock

    given = flags(*folders(tmp_path / "in"))
    Path("out").mkdir()
    with folder_lock(Path("out"), "taken"):
        assert "another evaluation is at work in out" in fails(capsys, *given, *TOY, "--out", "out")


def test_folders_compose_no_model_and_a_style_encoder_where_one_is_named(tmp_path, capsys):
    given = flags(*folders(tmp_path / "in", scenes=("one",), styles=("a",), frames=1))
    run(*given, *TOY, "--out", "out")
    assert not {"backbone", "model", "placement", "style_encoder"} & metrics("out")["provenance"]["config"].keys()
    line = fails(capsys, *given, "metric=[clip_style]", "--out", "other")
    assert "metric=clip_style needs a style encoder; add style_encoder=NAME" in line
    words = ["metric=[clip_style]", "style_encoder=tiny", "weights.style_encoder=tiny_style_encoder"]
    run(*given, *words, "--out", "style")
    assert -1 <= metrics("style")["clip_style"] <= 1
