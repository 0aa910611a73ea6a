"""The commands that pages show, what makes each small enough for a test, and which of them no test machine can run."""

import re
import shlex
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
PAGES += [page for folder in ("docs", "plugins/*") for page in sorted(ROOT.glob(f"{folder}/*.md"))]
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SHELLS = ("console", "bash", "sh")
_INLINE = re.compile(r"`((?:anystyle|torchrun|srun|make|python|pip|git|(?:[A-Z_]+=[^\s`]+ )+\w+)\s[^`]+)`")

_BACKBONE = (
    "weights.backbone=null backbone.resolution=28 backbone.native_resolution=28 backbone.dim=16 backbone.embed_depth=1 "
    "backbone.depth=4 backbone.taps=[0,1,2,3] backbone.heads=2 backbone.camera_heads=2 backbone.depth_features=8 "
    "backbone.depth_channels=[8,8,8,8] backbone.gaussian_features=16 backbone.gaussian_channels=[8,8,8,8] "
    "backbone.gaussian_hidden=8"
)
_SOURCES = "scenes=folder scenes.root=SCENES styles=folder styles.root=STYLES"
ADDED = (
    (r"anystyle stylize (?!.*--cfg)(?!.*short_side)", "views.short_side=56"),
    (r"anystyle stylize (?!.*--cfg)", "video.frames=2"),
    (r"anystyle film ", "video.frames=2 video.height=64"),
    (r"anystyle stylize example:", "reconstruction=feedforward poses=predicted views.take=3"),
    (r"anystyle train .*=tiny_", "trainer.max_steps=2 training.warmup=1 scenes.num_scenes=2"),
    (r"anystyle train .*=tiny_(?!.*backbone=mine)", "scenes.size=28"),
    (r"anystyle train .*=tiny_[sam]", "training.batch_size=1 styles.size=28"),
    (r"anystyle train .*=tiny_[sa]", "loss.clip_patch.crop_size=16"),
    (r"anystyle train .*=tiny_[sam]", "training.pool=2 training.cache_scenes=2 training.preview_every=0"),
    (r"anystyle train .*=tiny_reconstruction", "training.batch_size=1 training.context_views=[2,2] validation_steps=1"),
    (r"anystyle train (?!.*(paper|depth_anything|=mine|--cfg|--info))", _BACKBONE),
    (r"anystyle train -m (?!.*(sweep.dir|hydra/launcher))", "hydra.sweep.dir=multirun/DATE/TIME"),
    (r"anystyle evaluate --run .*=paper_image", f"{_SOURCES} scenes.short_side=28"),
    (r"anystyle evaluate .*=SCENES", "scenes.short_side=56"),
    (r"anystyle stylize .*method=(nnfm|stylized_gs)(?!.*--cfg)", "method.num_steps=2"),
    (r"anystyle evaluate .*=paper_text", "protocol.num_scenes=1 protocol.num_styles=2"),
    (r"anystyle evaluate .*=paper_text(?!.*scenes.root)", "scenes.size=28 styles.size=28"),
    (r"anystyle study design", "study.participants=4 study.sets=4 study.image_size=64"),
    (r"anystyle study analyze (?!.*study_test)", "study_test.sign_flip.resamples=99"),
    (r"anystyle study power", "--studies 20"),
)
"""Words that a command is run with behind its own, by what it begins with: sizes and numbers, not what it is about."""
INSTEAD = {
    "anystyle train experiment=... backbone=anysplat_tiny": (
        "anystyle train experiment=tiny_reconstruction backbone=anysplat_tiny"
    ),
    "anystyle evaluate --run multirun/DATE/TIME protocol=paper_image ...": (
        "anystyle evaluate --run multirun/DATE/TIME protocol=paper_image"
    ),
    "anystyle plugins new protocol NAME": "anystyle plugins new protocol mine",
    "anystyle plugins new study_test NAME": "anystyle plugins new study_test mine",
    "anystyle weights list NAME ...": "anystyle weights list vgg16 alexnet",
}
"""Commands with places to fill in, filled in."""
FEWER = {
    "docs/ablation.md": {
        "seed=0,1,2": "seed=0",
        "ablation=base,all_geometry,no_clip_loss,no_style_loss,no_text,distillation": "ablation=base,distillation",
        "placement=aggregator,full": "placement=full",
        "hydra/launcher=joblib": None,
        "hydra.launcher.n_jobs=2": None,
    },
    "docs/getting_started.md": {
        "ablation=base,all_geometry,no_clip_loss,no_style_loss,no_text": "ablation=base,no_text"
    },
    "docs/rivals.md": {"method=branch,nnfm,projection": "method=branch,projection"},
    "docs/clusters.md": {"seed=0,1,2": "seed=0", "placement=head,full": "placement=full"},
    "README.md": {"placement=head,aggregator,full": "placement=head,full"},
}
"""Words of sweeps that are other or none on a page that shows more jobs than a test can train. All rows and placements
are trained by ``ablation/test_ablations.py``."""
ENDS = {
    r"anystyle weights download ": "cannot be fetched",
    r"anystyle stylize .*model=any(splat|style_head|style_full)\b": "the weights '.*' are missing: get",
    r"anystyle film .*camera_path.json": "there is no camera path of nerfstudio camera_path.json",
    r"anystyle .*--run runs/mine ": "there is no run runs/mine",
    r"anystyle stylize .*poses_from=": "poses_from=.* does not exist",
    r"anystyle stylize .*poses=known": "no cameras are stored beside the photographs",
    r"anystyle stylize .*--photo-masks ": "there is no folder of masks",
    r"anystyle (stylize scene.spz|evaluate .* DEPTH) ": "there is no (file scene.spz|depth folder DEPTH)",
    r"anystyle stylize (panoramas/|walk_360.mp4) ": "there is no folder, image or video",
    r"anystyle stylize .*(reconstruction=fit|quality=best)": "no cameras are found: there is too little to see",
    r"anystyle stylize .*weights.backbone=model.safetensors": "there is no weights file model.safetensors",
}
"""Commands that need a file which is not at hand: they run as well, and end in one line that says which."""
TELLS = {
    r"anystyle plugins check ": "promises kept",
    r"anystyle stylize placement=sparse placement.step=3 --cfg job": "_target_: sparse.Sparse\nstep: 3",
    r"anystyle stylize (photos/|example:\w+) (?!.*(=any|weights|html))": "/sheet.png",
    r"anystyle stylize photos/ .*html": "look at out/scene.html",
    r"anystyle train (?!.*(-m|--cfg|--info|fast_dev|smoke|paper))": "steps done; ",
}
"""What the commands that begin so say, by which it is seen that they did their work."""
NOT_RUN = {
    r"anystyle NAME$": "a name to fill in",
    r"anystyle plugins check \w+ NAME$": "names to fill in",
    r"for archive in ": "archives of 730 GB",
    r"anystyle export SCENE": "a file of a format that the reader adds",
    r"python -m build$": "builds the reader's package",
    r"pip install ": "needs a network",
    r"make (demo|setup|lint|notebooks|(benchmark-|test-)(smoke|slow)|test|format lint)$": "needs a network",
    r"anystyle (app|view( \S+)?$)": "serves until it is interrupted; tests of these plugins look at the pages",
    r"anystyle (evaluate -m model=anystyle_head,styl3r|stylize .*model=styl)": "needs published weights",
    r"python -m tests\.benchmarks\.": "minutes, and pictures that do not travel with the project",
    r"ssh ": "needs another machine",
    r"make benchmark-methods ": "sets up an environment from a network; benchmark/tests judge a method beside others",
    r"anystyle benchmark run methods=mine": "a method that the reader adds; benchmark/tests run one",
    r"anystyle benchmark run track=mine/": "a track that the reader writes; benchmark/tests run one",
    r"make docs$": "tests/docs/test_site.py does what it does",
    r"python -m pytest tests/docs$": "these tests",
    r"torchrun ": "needs several graphics cards, or machines",
    r"srun ": "needs a cluster",
    r"anystyle (train|evaluate) -m hydra/sweeper=optuna ": "many jobs; training/test_search.py runs a few",
    r"anystyle train -m hydra/launcher=submitit_slurm ": "needs a cluster",
    r"anystyle train -m hydra/launcher=(joblib|submitit_local) ": "ablation/test_ablations.py runs both launchers",
    r"anystyle train experiment=(paper_(?!.*model=tiny)|styl)": "needs graphics cards, data sets and published weights",
    r"anystyle (evaluate protocol=table|report .?T2)": "tests of these plugins do, small",
    r"anystyle benchmark (judge|compare) ": "needs an edition; tests have one",
    r"anystyle benchmark ladder ": "hours; benchmark/tests/test_ladder.py counts a small one",
    r"anystyle evaluate protocol=captures": "minutes; captures/tests/test_protocol.py runs a small one",
}
"""Commands that no test machine can run, and why. They are parsed and composed by ``test_docs.py``."""


def named(page: Path) -> str:
    """A page as people call it."""
    return page.relative_to(ROOT).as_posix()


def blocks(page: Path, *languages: str) -> list[str]:
    """The fenced blocks of some languages."""
    return [body for language, body in FENCE.findall(page.read_text(encoding="utf-8")) if language in languages]


def shown(page: Path) -> list[str]:
    """Every command of a page, in its order; those within sentences and tables last. Comments are left out.

    A bare name within a sentence, such as ``anystyle weights`` or ``anystyle plugins check``, speaks of a command and
    shows none.
    """
    lines = "\n".join(blocks(page, *SHELLS)).replace("\\\n", " ").splitlines()
    found = [line.strip().removeprefix("$ ") for line in lines]
    prose = FENCE.sub("", page.read_text(encoding="utf-8"))
    found += [text for text in _INLINE.findall(prose) if not re.fullmatch(r"anystyle( [a-z_]+){1,2}", text)]
    return [line for line in (shlex.join(shlex.split(line, comments=True)) for line in found) if line]


def small(page: str, line: str) -> list[str]:
    """The words of a command with those that are added to it."""
    line = INSTEAD.get(line, line)
    words = shlex.split(line)
    fewer = FEWER.get(page, {})
    words = [word for word in (fewer.get(word, word) for word in words) if word is not None]
    return words + [word for pattern, more in ADDED if re.match(pattern, line) for word in shlex.split(more)]


def reason(line: str) -> str | None:
    """Why a command is not run; ``None`` where it is."""
    return next((why for pattern, why in NOT_RUN.items() if re.match(pattern, line)), None)


def ending(line: str) -> str | None:
    """What the one line says in which a command must end; ``None`` where it must work."""
    return next((told for pattern, told in ENDS.items() if re.match(pattern, line)), None)


def told(line: str) -> str:
    """What a command must say."""
    return next((words for pattern, words in TELLS.items() if re.match(pattern, line)), "")
