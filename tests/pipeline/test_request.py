"""One value for what is asked for: from the command line and back, through a report and a second run."""

import json
import shutil
from pathlib import Path

import pytest
import torch

import anystyle
from anystyle import Controls, ExportOptions, Mixture, PoseOptions, Request, ViewOptions
from anystyle.errors import UserError
from anystyle.io.checkpoint import read_header
from anystyle.pipeline.load import weights_file
from anystyle.pipeline.request import InMemory, Photographs, SavedScene, inputs_of
from anystyle.pipeline.words import args_of, recorded, request
from anystyle.types import Views

ARGS = [
    ["photos/", "--text", "blue ink", "views.take=3"],
    ["a.jpg", "b.jpg", "--image", "x.png", "--text", "then words", "--image", "y.png"],
    ["photos/", "--text=--dashes", "--strength", "0.0,0.5", "--scale", "2.0", "seed=3"],
    ["photos/", "--image", "x.png", "--text", "ink", "--mix", "0.25,1.0"],
    ["photos/", "--text", "ink", "--mask", "sphere:0,0,1.5,0.25,soft=0.1", "--mask", "box:-1,-1,0,1,1,2"],
    ["scenes=procedural", "scene=2", "--text", "ink", "--export", "html,spz"],
    ["./-photos", "./a=b", "--text", "ink"],
    ["photos/", "--image", "45.jpg", "--name", "Blue horses", "--text", "ink", "--image", "b.png", "--name", "夜"],
]


@pytest.mark.parametrize("args", ARGS)
def test_arguments_are_a_request_and_back(args):
    asked = request(args)
    assert request(args_of(asked)) == asked and json.loads(json.dumps(args_of(asked))) == args_of(asked)


def test_styles_have_the_order_in_which_they_are_typed():
    assert request(ARGS[1]).styles == (Path("x.png"), "then words", Path("y.png"))
    assert request(ARGS[3]).styles[0] == Mixture(Path("x.png"), "ink", 0.25)


def test_values_of_python_are_the_request_of_the_command_line():
    made = Request.of(
        "photos/", ["ink"], [Controls(strength=0.5)], model="tiny", views=ViewOptions(take=3, short_side=56),
        poses=PoseOptions("known", "cameras/"), export=ExportOptions(formats=["html"]), video={"frames": 2}, seed=None,
    )  # fmt: skip
    words = "views.short_side=56 views.take=3 poses=known poses_from=cameras/ export.formats=[html] video.frames=2"
    typed = request(["photos/", "--text", "ink", "--strength", "0.5", "model=tiny", *words.split()])
    assert request(args_of(made)).config == typed.config and made.inputs == Photographs((Path("photos"),))
    assert made.views == typed.views and made.poses == typed.poses == PoseOptions("known", "cameras/")
    assert made.export.formats == ["html"] and made.config.video.frames == 2 and made.seed == 0


@pytest.mark.parametrize(
    "asked",
    [
        Request(styles=(torch.zeros(3, 8, 8),)),
        Request(styles=(Mixture("a", "b", 0.5), Mixture("a", "c", 0.5))),
        Request(styles=("a",), controls=(Controls(0.5), Controls(1.0, preserve_color=1.0))),
    ],
)
def test_what_has_no_command_line_is_told(asked):
    with pytest.raises(UserError, match="have no command line"):
        args_of(asked)


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["photos/", "--text", "ink", "--export", "html", "export.formats=[spz]"], "formats are named twice"),
        (["--text", "ink", "-m"], "-m is a flag of Hydra"),
        (["--again", "missing.json"], "missing.json"),
        (["--text", "  "], "--text is empty"),
        (["--name", "Sea", "--text", "a"], "--name Sea follows the --text or --image"),
        (["--text", "a", "--name", "Sea", "--name", "Sky"], "--name Sky follows"),
        (["--text", "x" * 10000], "has 10000 characters"),
        (["--text", "a", "--mix", "0.5"], "exactly two styles"),
        (["--text", "a", "--text", "b", "--mix", "1.5"], "between 0 and 1, not 1.5"),
        (["--text", "a", "--text", "b", "--mix", "half"], "not 'half'"),
    ],
)
def test_arguments_that_make_no_sense_are_a_line(args, message):
    with pytest.raises(UserError, match=message):
        request(args)


def test_a_recorded_request_names_files_without_their_folders_and_leaves_texts(tmp_path):
    (tmp_path / "masks").mkdir()
    args = [f"{tmp_path}/photos/", "--text", "/imagine a castle/tower", "--image", "/x/a.jpg"]
    words = ["--mask", f"{tmp_path}/masks", "--photo-masks", f"{tmp_path}/masks", "poses_from=/p/q"]
    flags = ["--image", "a.jpg", "--mask", "masks,soft=0.01"]
    named = recorded(request([*args, *words]))
    assert named == ["photos", *args[1:3], *flags, "views.masks='masks'", "poses_from=q"]


def test_what_the_inputs_are_is_decided_once(tmp_path):
    (tmp_path / "scene.ply").touch()
    (tmp_path / "results").mkdir()
    for name in ("report.json", "unstyled.safetensors"):
        (tmp_path / "results" / name).touch()
    for name in ("scene.ply", "results"):
        assert inputs_of(tmp_path / name) == SavedScene(tmp_path / name) == inputs_of([str(tmp_path / name)])
    two = [tmp_path / "scene.ply", tmp_path / "a.jpg"]
    assert inputs_of(two) == Photographs(tuple(two)) and inputs_of([]) is None
    views = Views(torch.zeros(1, 1, 3, 8, 8))
    assert inputs_of(views) == InMemory(views)


def test_a_result_of_something_in_memory_has_no_request(photographs, tmp_path):
    (result,) = anystyle.stylize(photographs, "dots", model=anystyle.load(), views=ViewOptions(56, take=2))
    assert result.report["request"] is None


def test_a_training_is_named_by_its_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for job in ("sweep/0", "sweep/1"):
        Path(job).mkdir(parents=True)
        shutil.copy(weights_file("tiny_branch"), Path(job) / "branch.safetensors")
        Path(job, "bound.json").write_text(json.dumps({"weights.backbone": "other", "seed": 0}))
    Path("a.png").touch()
    asked = request(["a.png", "--text", "ink", "--run", "sweep/1", "views.take=2"])
    header = read_header(weights_file("tiny_branch")).config
    assert asked.config.weights == {"backbone": "other", "branch": "sweep/1/branch.safetensors"}
    assert asked.config.backbone == header["backbone"] and asked.config.injector == header["injector"]
    assert request(args_of(asked)) == asked
    with pytest.raises(UserError, match="sweep holds 2 trainings; name one of them, such as sweep/0"):
        _ = request(["a.png", "--text", "ink", "run=sweep"]).config
    with pytest.raises(UserError, match="there is no run absent"):
        _ = request(["a.png", "--text", "ink", "--run=absent"]).config
