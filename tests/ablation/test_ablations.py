"""The rows of the ablation table: what each changes, and sweeps over them as people type them."""

from pathlib import Path

import pytest
import yaml
from safetensors.torch import load_file

from anystyle.cli.launch import launch
from anystyle.commands.train import run
from anystyle.errors import UserError
from anystyle.registry.compose import compose
from anystyle.training.run import objective
from tests.support.training_cases import BACKBONE

ROWS = ("base", "all_geometry", "no_clip_loss", "no_style_loss", "no_text")
PAPER = {"content", "style", "clip_directional", "clip_patch", "depth_consistency"}
SMOOTH = {"edge_aware_smoothness", "checkerboard"}
TERMS = {
    "paper_head": {
        "base": PAPER,
        "no_clip_loss": {"content", "style", "depth_consistency"},
        "no_style_loss": {"content", "clip_directional", "clip_patch", "depth_consistency"},
    },
    "tiny_style": {
        "base": {*PAPER, "teacher", "sliced_wasserstein", *SMOOTH},
        "no_clip_loss": {"teacher", "content", "style", "depth_consistency", "sliced_wasserstein", *SMOOTH},
        "no_style_loss": PAPER - {"style"} | {"teacher"} | SMOOTH,
    },
    "tiny_ablation": {
        "base": {*PAPER, "sliced_wasserstein", *SMOOTH},
        "no_clip_loss": {"content", "style", "depth_consistency", "sliced_wasserstein", *SMOOTH},
        "no_style_loss": PAPER - {"style"} | SMOOTH,
    },
}
TABLE = f"ablation={','.join(ROWS)}"
# The tiny recipe on a still smaller network, from its initialisation.
SMALL = [word for word in BACKBONE if not word.startswith(("backbone=", "renderer="))]
FEW_STEPS = (
    *SMALL, "experiment=tiny_ablation", "trainer.max_steps=2", "scenes.size=28",
    "scenes.num_scenes=2", "styles.num_styles=1", "styles.size=28", "training.pool=2", "training.cache_scenes=2",
    "training.warmup=1", "hydra.sweep.dir=sweep", "loss.content.network=texture", "loss.style.network=texture",
    "loss.content.layers=[relu3_1]", "loss.style.layers=[relu1_1,relu2_1]", "loss.clip_patch.crop_size=14",
)  # fmt: skip
# With this seed both steps are of texts where there are any.
TEXTS = "seed=7"
# Rows that style geometry differ only where style enters before the attributes part.
SITES = ("placement=sites", "placement.patterns=[aggregator/*,head/direct,color]")


@pytest.fixture(autouse=True)
def _here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def multirun(*words: str) -> None:
    launch("train", run, ["-m", *FEW_STEPS, *words])


def weights_of(job: int) -> Path:
    return Path("sweep") / str(job) / "branch.safetensors"


def last(job: int) -> Path:
    return weights_of(job).with_name("last.ckpt")


@pytest.mark.parametrize("experiment", TERMS)
@pytest.mark.parametrize("ablation", ROWS)
def test_objective_of_each_row(experiment, ablation):
    config = compose("train", [f"experiment={experiment}", f"ablation={ablation}", "cache=null", "name=x", "out=x"])
    assert set(objective(config)) == TERMS[experiment].get(ablation, TERMS[experiment]["base"])
    assert (config.training.text_ratio == 0) is (ablation == "no_text")
    assert ablation != "no_text" or not config.training.preview_texts
    styled = ["opacity", "scale", "rotation", "color"] if ablation == "all_geometry" else ["rotation", "color"]
    assert list(config.branch.styled) == styled


def test_distillation_replaces_the_terms_of_the_tiny_recipe():
    config = compose("train", ["experiment=tiny_ablation", "ablation=distillation", "cache=null", "name=x", "out=x"])
    assert set(objective(config)) == {"teacher", "depth_consistency", "checkerboard"}


def test_one_term_is_left_out_by_its_name_alone():
    words = ["experiment=tiny_style", "name=x", "out=x"]
    left = [set(objective(compose("train", [*words, word]))) for word in ("without=[]", "without=clip_directional")]
    assert left[0] - left[1] == {"clip_directional"}
    config = compose("train", [*words, "without=clip_directoinal"])
    with pytest.raises(UserError, match=r"no loss is named 'clip_directoinal'\. Did you mean"):
        objective(config)


@pytest.mark.slow
def test_the_table_trains_in_one_command_and_again_does_only_what_is_missing(capfd):
    multirun(TABLE, *SITES, TEXTS)
    assert capfd.readouterr().out.count("2 steps done; branch.safetensors in ") == len(ROWS)
    branches = [load_file(weights_of(job)) for job in range(len(ROWS))]
    base, geometry, no_clip, no_style, no_text = branches
    assert all(base.keys() == other.keys() for other in branches)
    for other in (geometry, no_clip, no_style, no_text):
        assert any(not base[key].equal(other[key]) for key in base)
    for job, row in enumerate(ROWS):
        assert f"ablation={row}" in yaml.safe_load((weights_of(job).parent / ".hydra" / "overrides.yaml").read_text())
    for file in (last(1), weights_of(1), weights_of(3)):
        file.unlink()
    before = [checkpoint.stat().st_mtime_ns if checkpoint.is_file() else 0 for checkpoint in map(last, range(5))]
    multirun(TABLE, *SITES, TEXTS)
    # Job 1 has lost its checkpoint and is trained again; job 3 has its checkpoint and only writes its weights.
    again = [last(job).stat().st_mtime_ns != before[job] for job in range(len(ROWS))]
    assert again == [False, True, False, False, False]
    for job, branch in enumerate(branches):
        now = load_file(weights_of(job))
        assert all(now[key].equal(branch[key]) for key in branch)


@pytest.mark.slow
def test_a_job_that_fails_leaves_the_others_and_the_sweep_says_so():
    with pytest.raises(ValueError, match=r"training\.text_ratio=7\.0: expected 0 <= float <= 1"):
        multirun("training.text_ratio=0.5,7,0")
    assert [weights_of(job).is_file() for job in range(3)] == [True, False, True]


@pytest.mark.slow
def test_placements_are_swept_by_name():
    multirun("placement=head,aggregator,full", "trainer.max_steps=1")
    parts = [{key.split(".")[0] for key in load_file(weights_of(job))} for job in range(3)]
    assert parts == [{"gaussian_head", "injectors"}] + 2 * [{"aggregator", "gaussian_head", "injectors"}]
    sites = [
        {key.split(".")[1].split("/")[0] for key in load_file(weights_of(job)) if key[0] == "i"} for job in range(3)
    ]
    assert sites == [{"head"}, {"aggregator"}, {"aggregator", "head"}]


@pytest.mark.slow
def test_low_rank_updates_alone_learn_where_the_copies_do_not():
    multirun("injector=lora,film", *SITES, "training.learn_copies=false", "export.half=false")
    lora, film = (load_file(weights_of(job)) for job in range(2))
    copies = [key for key in lora if key.startswith("gaussian_head.")]
    assert copies
    assert all(lora[key].equal(film[key]) for key in copies)
    assert any(lora[key].any() for key in lora if key.endswith(".up.weight"))


@pytest.mark.parametrize(
    ("word", "told"),
    [
        ("training.learning_rat=0.1,0.2", "Did you mean: 'learning_rate'"),
        ("ablation=base,no_clip", "Could not find 'ablation/no_clip'"),
        ("loss.stlye.weight=1,2", "stlye"),
    ],
)
def test_a_sweep_over_what_does_not_exist_trains_nothing(word, told):
    with pytest.raises(UserError) as caught:
        multirun(word)
    message = str(caught.value)
    assert told in message or told.replace(": ", " ") in message, message
    assert "\n" not in message
    assert not list(Path().rglob("*.safetensors"))
