"""The program: quick where it lists, brief where it fails, and the same program in every process it starts."""

import argparse
import os
import re
import subprocess
import sys
from itertools import product
from pathlib import Path
from typing import get_args

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from hypothesis import given, settings
from hypothesis import strategies as st
from omegaconf import OmegaConf

from anystyle import __main__ as program
from anystyle.cli import launch
from anystyle.cli.arguments import split
from anystyle.cli.run import message, run
from anystyle.contracts import Placement
from anystyle.errors import MissingExtra, UserError
from anystyle.registry.build import build
from anystyle.registry.compose import ELSEWHERE, check_choices, compose, override

ROOT = """
defaults: [{placement: head}, _self_, {override hydra/job_logging: none}, {override hydra/hydra_logging: none}]
seed: 0
hydra: {searchpath: ['anystyle://'], run: {dir: .}, sweep: {dir: .}, output_subdir: null}
"""


def flags() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="anystyle job", allow_abbrev=False)
    parser.add_argument("inputs", nargs="*")
    parser.add_argument("--text", action="append", default=[])
    parser.add_argument("--style", nargs="+", default=[])
    parser.add_argument("--demo", action="store_true")
    parser.add_argument("--fail")
    return parser


def job(config, arguments) -> None:
    placement = build(Placement, config.placement)
    if arguments.fail is not None:
        errors = {"user": UserError("two\nlines"), "bug": RuntimeError("a bug"), "interrupt": KeyboardInterrupt}
        raise errors[arguments.fail]
    sys.stdout.write(f"JOB {type(placement).__name__} {config.seed} {arguments.text} {arguments.inputs}\n")


@pytest.fixture
def command(tmp_path, monkeypatch, capsys):
    """A command in this process, whose configuration root is in a folder of its own: status, output, errors."""
    conf = tmp_path / "conf"
    conf.mkdir()
    (conf / "config.yaml").write_text(ROOT)
    monkeypatch.setattr(launch.paths, "CONF", conf)
    monkeypatch.chdir(tmp_path)

    def work(words: tuple[str, ...]) -> None:
        parser = flags()
        launch.describe(parser)
        arguments, rest = split(parser, words)
        launch.launch("config", lambda config: job(config, arguments), rest)

    def go(*words: str) -> tuple[int, str, str]:
        status = 0
        try:
            run(lambda: work(words))
        except SystemExit as left:
            status = int(left.code or 0)
        captured = capsys.readouterr()
        return status, captured.out, captured.err

    return go


def call(*words: str, cwd: Path | None = None, **environment: str):
    """Run the program as a user does."""
    command, env = [sys.executable, "-m", "anystyle", *words], os.environ | {"OMP_NUM_THREADS": "1"} | environment
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, env=env)


@pytest.mark.parametrize("words", [["--help"], ["plugins"], ["plugins", "loss"], ["plugins", "backbone"]])
def test_listing_imports_neither_torch_nor_a_plugin(words):
    code = (
        "import sys, anystyle; from anystyle.__main__ import main\n"
        f"sys.argv = ['anystyle', *{words!r}]\n"
        "try: main()\n"
        "finally: print('IMPORTED', [n for n in sys.modules if n.split('.')[0] in "
        "('torch', 'hydra', 'omegaconf', 'numpy', 'rich', 'anystyle_backbones') or n.startswith('anystyle.losses.')])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "IMPORTED []"


MISTYPED = {
    "training.lrr=1": "'training.lrr': Key 'lrr' is no option of training. There are: ",
    "trainer.max_stepss=3": "'trainer.max_stepss': Key 'max_stepss' is no option of trainer. Did you mean 'max_steps'?",
    "loss.style.weigt=1": "'loss.style.weigt': Key 'weigt' is no option of loss. Did you mean 'weight'?",
    "vews.take=3": "'vews.take': Key 'vews' is unknown. Did you mean 'views'?",
    "foo=3": "'foo': Key 'foo' is unknown. --cfg job shows all there are",
    "lerning_rate=3": "'lerning_rate': Key 'lerning_rate' is unknown. --cfg job shows all there are",
    "+learn_copies=true": "'+learn_copies': Key 'learn_copies' is unknown",
    "++trainer.max_stepss=3": "'++trainer.max_stepss': Key 'max_stepss' is no option of trainer. Did you mean",
    "losses=foo": "'losses': Key 'losses' is unknown. Did you mean 'loss'?",
    "seed=abc": "seed=abc: expected a number",
    "trainer.max_steps=ten": "trainer.max_steps=ten: expected a number",
    "injector=lora injector.rank=four": "injector.rank=four: expected a number",
    "loss.style.weight=much": "loss.style.weight=much: expected a number",
    "precision=fp17": "precision=fp17: choose one of auto, fp32, bf16, reference",
    "trainer.precision=fp16": "trainer.precision=fp16: choose one of 32-true, 64-true, 16-true, ",
    "resume=alwys": "resume=alwys: choose one of auto, never, changed",
    "reconstruction.quality=foo": "reconstruction.quality=foo: choose one of draft, good, best, full",
    "-cd own styles=foldr": "'styles/foldr'. Did you mean 'folder'?",
    "hydra.searchpath=[file://own] styles=minee": "'styles/minee'. Did you mean 'mine'?",
}


def test_mistyped_words_are_answered_before_torch_is_imported(tmp_path):
    (tmp_path / "own" / "styles").mkdir(parents=True)
    (tmp_path / "own" / "styles" / "mine.yaml").write_text("defaults: [folder]\n")
    code = (
        "import sys; from anystyle.cli.launch import main\nfrom anystyle.errors import UserError\n"
        f"for words in {[*MISTYPED]!r}:\n    sys.argv = ['', 'experiment=tiny_style', *words.split()]\n"
        "    try: main('train', print)\n    except SystemExit: pass\n"
        "print('torch' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    assert done.stdout == "False\n"
    for line, told in zip(done.stderr.splitlines(), MISTYPED.values(), strict=True):
        assert told in line


def test_choices_that_are_known_before_torch_are_those_of_their_options():
    from lightning.fabric.plugins.precision.precision import _PRECISION_INPUT

    from anystyle.pipeline.load import PRECISIONS
    from anystyle.training.trainer import RANGES

    known = dict(ELSEWHERE["choices"])
    lightnings = {str(word) for each in get_args(_PRECISION_INPUT) for word in get_args(each)}
    assert lightnings == {*known["trainer.precision"]}
    assert known["precision"] == [*PRECISIONS]
    for key in ("resume", "checkpoint.mode"):
        assert known[key] == [*get_args(RANGES[key])]


@pytest.mark.parametrize(
    "words",
    ["precision=bf16", "trainer.precision=16-Mixed", "resume=auto,never", "precision=null", "+trainer.profiler=simple"],
)
def test_words_that_may_be_right_are_left_to_hydra(words, tmp_path):
    check_choices([words])
    (tmp_path / "root.yaml").write_text("scenes: null\n")
    check_choices(["scenes=street"], tmp_path)  # the root's own key, which is no group there


def test_stylize_answers_a_mistyped_word_before_torch_is_imported():
    code = (
        "import sys; from anystyle.commands.stylize import main\n"
        "try: main(['photos/', '--text', 'seed=1', 'seed=abc'])\nfinally: print('torch' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout == "False\n" and "seed=abc: expected a number" in done.stderr


def test_help_lists_every_command_that_exists():
    done = call("--help")
    assert done.returncode == 0
    for name in program.COMMANDS:
        there = (Path(program.__file__).parent / "commands" / f"{name}.py").is_file()
        assert (f"\n  {name} " in done.stdout) == there
    assert all(line.strip() for line in program.available().values())
    assert call("--version").stdout.startswith("anystyle ")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["plugin"], "no command is named 'plugin'. Did you mean 'plugins'? Commands: "),
        (["--halp"], "no flag is named '--halp'."),
        (["_run"], "no command is named '_run'."),
        (["plugins_check"], "no command is named 'plugins_check'. Did you mean 'plugins'?"),
        (["../train"], "no command is named '../train'."),
        (["plugins", "los"], "no kind of plugin is named 'los'. Did you mean 'loss'?"),
        (["plugins", "loss", "styel"], "no loss is named 'styel'. Did you mean 'style'?"),
        (["plugins", "loss", "style", "more"], "unrecognized arguments: more. See: anystyle plugins --help"),
    ],
)
def test_mistakes_are_one_line(words, told):
    done = call(*words)
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.startswith(f"anystyle: error: {told}") and done.stderr.count("\n") == 1


def test_a_process_that_starts_itself_again_finds_its_command():
    """A training on several devices runs ``python -m <name of __main__> <arguments>`` once more for each."""
    code = (
        "import sys, anystyle.registry.catalog as module\n"
        "def spy():\n"
        "    import __main__\n"
        "    print(__main__.__spec__.name, sys.argv[1:])\n"
        "    raise module.UserError('seen')\n"
        "module.catalog = spy\n"
        "sys.argv = ['anystyle', 'plugins', 'loss']\n"
        "from anystyle.__main__ import main\n"
        "main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout == "anystyle.commands.plugins ['loss']\n"
    assert (done.returncode, done.stderr) == (2, "anystyle: error: seen\n")


def test_a_closed_pipe_is_no_error():
    done = subprocess.run(
        f"{sys.executable} -m anystyle plugins loss | head -n 1", shell=True, capture_output=True, text=True
    )
    assert done.stderr == ""


def test_shell_completion():
    def completed(line: str) -> set[str]:
        done = call("-sc", "query=bash", COMP_LINE=line)
        assert done.returncode == 0, done.stderr
        return set(done.stdout.split())

    assert completed("anystyle plu") == {"plugins"}
    assert {"placement=head", "placement=full"} <= completed("anystyle stylize placement=")
    assert completed("anystyle nothing placement=") == set() and "complete" in call("-sc", "install=bash").stdout


def test_a_command_runs_with_flags_and_overrides(command):
    text = "a=b, 'c' \"d\" ${e} [f]\nnext"
    status, out, err = command("photos/", "--text", text, "placement=full", "./x=1.jpg", "seed=3")
    assert (status, err) == (0, "") and out == f"JOB Full 3 {[text]} ['photos/', './x=1.jpg']\n"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["placement=haed"], "Could not find 'placement/haed'. Did you mean 'head'? Available in 'placement': aggr"),
        (["placment=head"], "Could not override 'placment': Key 'placment' is unknown. Did you mean 'placement'?"),
        (
            ["reconstruction.qualty=best"],
            "Could not override 'reconstruction.qualty': Key 'reconstruction' is unknown; "
            "choose one first: reconstruction=f",
        ),
        (
            ["placement=full", "placement.every=1"],
            "Could not override 'placement.every': Key 'every' is no option of placement",
        ),
        (["placement=full", "placement.every_layer=x"], "Error merging override placement.every_layer=x: Value 'x'"),
        (["seed=[1"], "cannot read the override 'seed=[1': "),
        (["seed=1,2"], "Ambiguous value for argument 'seed=1,2'"),
        (["-m", "placement=head,haed"], "Could not find 'placement/haed'. Did you mean 'head'?"),
        (["placement._target_=os.system"], "_target_ 'os.system' is not a plugin; a config may build only what"),
        (["--txet", "x"], "unrecognized arguments: --txet. Did you mean '--text'? See: anystyle job --help"),
        (["--text"], "argument --text: expected one argument. See: anystyle job --help"),
        (["--cfg"], "--cfg takes one of job, hydra, all"),
        (["--cfg", "jbo"], "--cfg takes one of job, hydra, all"),
        (["--cfg=jbo"], "--cfg takes one of job, hydra, all"),
        (["-m", "--cfg", "job"], "give only one of --run, --multirun, --cfg"),
        (["--fail", "user"], "two lines\n"),
    ],
)
def test_a_command_fails_in_one_line(command, words, told):
    status, _, err = command(*words)
    assert status == 2 and err.startswith(f"anystyle: error: {told}") and err.count("\n") == 1


def test_a_bug_is_raised_as_it_is(command):
    with pytest.raises(RuntimeError, match="a bug"):
        command("--fail", "bug")


@pytest.mark.parametrize("variable", ["ANYSTYLE_TRACEBACK", "HYDRA_FULL_ERROR"])
def test_tracebacks_on_demand(command, monkeypatch, variable):
    monkeypatch.setenv(variable, "1")
    with pytest.raises(ValueError, match="two"):
        command("--fail", "user")
    assert os.environ[variable] == "1"


def test_interruption(command):
    assert command("--fail", "interrupt") == (130, "", "anystyle: interrupted\n")


def test_help_and_configuration(command):
    status, out, _ = command("--help")
    assert status == 0 and "--text" in out and "--multirun" in out and "placement: aggregator, color, full, head" in out
    for words in (["--cfg", "job", "placement=full"], ["placement=full", "--cfg", "job", "seed=3"]):
        status, out, _ = command(*words)
        assert status == 0 and OmegaConf.create(out).placement._target_ == "anystyle.placements.Full"


def test_multirun_runs_every_combination(command):
    status, out, err = command("in", "-m", "placement=head,full", "seed=1,2", "--text", "a, b")
    assert status == 0
    jobs = [*product(("head", "full"), (1, 2))]
    assert err.splitlines() == [f"job {n} of 4: placement={name} seed={seed}" for n, (name, seed) in enumerate(jobs, 1)]
    assert out.splitlines() == [f"JOB {name.title()} {seed} ['a, b'] ['in']" for name, seed in jobs]


def test_each_failing_job_of_a_multirun_is_named(command):
    status, _, err = command("-m", "seed=1,2", "--fail", "user")
    assert status == 2
    jobs = "".join(f"job {n} of 2: seed={n}\njob {n} of 2: seed={n} failed: two lines\n" for n in (1, 2))
    assert err == f"{jobs}Error executing job with overrides: ['seed=1']\nanystyle: error: two lines\n"
    with pytest.raises(RuntimeError, match="a bug"):
        command("-m", "seed=1,2", "--fail", "bug")


def test_a_folder_of_configurations_is_read(command, tmp_path):
    (tmp_path / "more" / "placement").mkdir(parents=True)
    (tmp_path / "more" / "placement" / "mine.yaml").write_text("defaults: [full]\nevery_layer: true\n")
    for flag in ("-cd", "--config-dir"):
        assert command(flag, "more", "placement=mine", "seed=4") == (0, "JOB Full 4 [] []\n", "")
    status, _, err = command("-cd", "absent", "placement=mine")
    assert status == 2 and err.startswith("anystyle: error: ") and "absent" in err and err.count("\n") == 1


def test_a_file_that_changes_the_folder_is_refused(command, tmp_path):
    (tmp_path / "more" / "extra").mkdir(parents=True)
    (tmp_path / "more" / "extra" / "here.yaml").write_text("# @package _global_\nhydra: {job: {chdir: true}}\n")
    status, out, err = command("-cd", "more", "+extra=here", "-m", "seed=1,2")
    assert (status, out) == (2, "") and "hydra.job.chdir: true: relative paths" in err


def test_a_callback_in_a_folder_of_configurations_does_not_run(command, tmp_path):
    (tmp_path / "more" / "extra").mkdir(parents=True)
    (tmp_path / "more" / "extra" / "evil.yaml").write_text(
        "# @package _global_\nhydra: {callbacks: {evil: {_target_: os.system, command: touch ran}}}\n"
    )
    status, out, err = command("-cd", "more", "+extra=evil")
    assert (status, out) == (2, "") and not (tmp_path / "ran").exists()
    assert re.match(r"anystyle: error: Target 'os\.system' is bl[a-z]+listed", err)  # Hydra 1.4 has another word
    assert err.count("\n") == 1


def test_workers_know_the_plugins_of_a_folder(tmp_path):
    """Other processes compose again: the source and the folder, named relatively, travel there."""
    pytest.importorskip("hydra_plugins.hydra_joblib_launcher.joblib_launcher")
    (tmp_path / "config.yaml").write_text(ROOT)
    (tmp_path / "mine").mkdir()
    (tmp_path / "jobs").mkdir()
    (tmp_path / "mine" / "pyproject.toml").write_text(
        '[project.entry-points."anystyle.study_test"]\nmine = "mine_of_a_test:Mine"'
    )
    (tmp_path / "mine" / "mine_of_a_test.py").write_text(
        "from anystyle_study.contract import StudyTest\n"
        "class Mine(StudyTest):\n    def __init__(self, *, depth: int = 1) -> None:\n        self.depth = depth\n"
        "    def __call__(self, *given, **named):\n        raise NotImplementedError\n"
    )
    (tmp_path / "job.py").write_text(
        "import os\nfrom anystyle.cli.launch import main\n"
        "def job(config):\n    open(os.path.join(os.environ['JOBS'], str(config.study_test.mine.depth)), 'w')\n"
        "if __name__ == '__main__':\n    main('config', job)\n"
    )
    (tmp_path / "config.yaml").write_text(ROOT.replace("{placement: head}", "{study_test: [mine]}"))
    words = ["study_test.mine.depth=5,6", "hydra/launcher=joblib", "hydra.launcher.n_jobs=2"]
    done = subprocess.run(
        [sys.executable, "job.py", "-cp", str(tmp_path), "-m", *words],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "ANYSTYLE_PLUGINS": "mine", "JOBS": str(tmp_path / "jobs")},
    )
    assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in (tmp_path / "jobs").iterdir()) == ["5", "6"]


@pytest.mark.parametrize(
    ("words", "inputs", "text", "hydra"),
    [
        (["photos/", "seed=3"], ["photos/"], [], ["seed=3"]),
        (["seed=3", "photos/", "-m", "more"], ["photos/", "more"], [], ["seed=3", "-m"]),
        (["--text", "a=b", "c=d"], [], ["a=b"], ["c=d"]),
        (["--text=a=b", "--demo", "c=d", "in"], ["in"], ["a=b"], ["c=d"]),
        (["--text", "-m x"], [], ["-m x"], []),
        (["--text", "-z", "in"], ["in"], ["-z"], []),
        (["./a=b.jpg", "/a=b", "x"], ["./a=b.jpg", "/a=b", "x"], [], []),
        (["+new.key=1", "++x=2", "~loss", "~loss=style"], [], [], ["+new.key=1", "++x=2", "~loss", "~loss=style"]),
        (["hydra/launcher=joblib", "scenes@validation=x"], [], [], ["hydra/launcher=joblib", "scenes@validation=x"]),
        (["--cfg", "job", "--info", "defaults", "in"], ["in"], [], ["--cfg", "job", "--info", "defaults"]),
        (["a=b", "--cfg", "job", "c=d", "in"], ["in"], [], ["a=b", "c=d", "--cfg", "job"]),
        (["--cfg=job", "~/photos"], ["~/photos"], [], ["--cfg=job"]),
        (["in", "--", "a=b", "-m"], ["in", "a=b", "-m"], [], []),
        (["--style", "a=b", "c=d"], [], [], ["c=d"]),
    ],
)
def test_split(words, inputs, text, hydra):
    arguments, rest = split(flags(), words)
    assert (arguments.inputs, arguments.text, rest) == (inputs, text, hydra)


SIMPLE = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text().filter(lambda x: x != "???")


@settings(deadline=None)
@given(SIMPLE | st.lists(SIMPLE, max_size=3))
def test_override_keeps_every_value(value):
    parsed = OverridesParser.create().parse_override(override("x", value))
    assert not parsed.is_sweep_override() and OmegaConf.create({"x": parsed.value()}).x == value


def test_compose_inside_a_command_and_its_errors(tmp_path):
    (tmp_path / "config.yaml").write_text(ROOT)
    assert compose("config", ["placement=full"], conf=tmp_path).placement.every_layer is False
    with pytest.raises(UserError, match="Could not find 'placement/ful'"):
        compose("config", ["placement=ful"], conf=tmp_path)
    with pytest.raises(UserError, match="Cannot find primary config"):
        compose("nothing", conf=tmp_path)


def test_messages():
    assert message(UserError("a\n b")) == "a b" and message(ValueError("a bug")) is None
    assert message(OSError(28, "No space", "out/.partial-x1/a.ply")) == "out/a.ply: No space"
    assert message(FileNotFoundError(2, "No such file or directory", "x.jpg")) == "x.jpg: No such file or directory"
    assert message(MissingExtra('reports need: pip install "anystyle[report]"')) is not None
    assert message(ImportError("cannot import name 'x'")) is None and message(TypeError("a bug")) is None


def test_environment_and_arguments_are_put_back(tmp_path, monkeypatch, capsys):
    (tmp_path / "config.yaml").write_text(ROOT)
    monkeypatch.setattr(launch.paths, "CONF", tmp_path)
    monkeypatch.chdir(tmp_path)
    before = list(sys.argv)
    seen = []
    launch.launch("config", lambda config: seen.append((config.seed, sys.argv[1:])), ["seed=4"])
    assert seen == [(4, ["seed=4"])] and sys.argv == before and "HYDRA_FULL_ERROR" not in os.environ
