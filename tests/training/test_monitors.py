"""What one sees of a run, what stops it, and which options are refused."""

import csv

import pytest
import torch
from lightning.pytorch.loggers import CSVLogger, TensorBoardLogger
from PIL import Image

from anystyle.contracts import StyleSource
from anystyle.errors import MissingExtra
from anystyle.testing.oracle import hashed
from anystyle.training.data import ATTEMPTS, SceneBatches
from anystyle.training.run import make_data, make_training, train
from anystyle.training.safeguards import FiniteLoss
from anystyle.training.trainer import check_options, make_loggers, make_trainer
from anystyle.types import Style
from tests.support.oracle import golden
from tests.support.refusals import raises_line
from tests.support.training_cases import STYLIZATION, configuration

TRACKED = (*STYLIZATION, "loggers=[tensorboard]", "training.preview_every=10", 'training.preview_texts=["red dots"]')
TOLERANCE = 1e-3
"""Relative. Two threads in place of one change losses by 1e-4; a learning rate 1 % higher, by more than this."""


@pytest.fixture(scope="module")
def tracked(tmp_path_factory):
    """Twenty steps of a stylization with everything logged."""
    out = tmp_path_factory.mktemp("tracked")
    train(configuration((*TRACKED, "trainer.max_steps=20"), out), out)
    return out


def logged(folder):
    """What was logged to the table, by column."""
    with (folder / "log" / "version_0" / "metrics.csv").open() as file:
        rows = list(csv.DictReader(file))
    return {name: [float(row[name]) for row in rows if row[name]] for name in rows[0]}


def test_every_step_has_the_losses_that_it_always_had(tracked):
    columns = logged(tracked)
    for name, losses in golden("losses_tiny").items():
        tolerance = 20 * TOLERANCE if name == "gradient_norm" else TOLERANCE
        assert columns[f"train/{name}"] == pytest.approx(losses, rel=tolerance), name
    assert sum(columns["train/loss"][-5:]) < 0.95 * sum(columns["train/loss"][:5])
    # The checkpoint holds the branch alone; what is frozen has files of its own.
    state = torch.load(tracked / "last.ckpt", weights_only=True)["state_dict"]
    assert state and all(key.startswith("stylizer.branch.") for key in state)


def test_terms_rates_gradients_and_speed_are_logged_to_a_table_and_to_tensorboard(tracked):
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    names, columns = {"train/loss", "train/samples", "lr/head", "lr/head injectors"}, logged(tracked)
    # Two scenes a step of two views each.
    assert columns["train/samples"] == list(range(4, 84, 4))
    # Warm-up of one step from a hundredth of the peak.
    assert columns["lr/head"][:2] == pytest.approx([5e-6, 5e-4])
    events = EventAccumulator(str(tracked / "tensorboard" / "version_0"))
    events.Reload()
    assert names <= set(events.Tags()["scalars"])
    assert [event.step for event in events.Images("previews")] == [10, 20]


def test_the_grid_always_shows_the_same_scene_in_the_same_styles(tracked):
    first, second = (Image.open(path).convert("RGB") for path in sorted((tracked / "previews").glob("*.png")))
    # Two views of 28 pixels; photographs, unstyled, one text, one image.
    assert first.size == second.size == (56, 4 * 28)
    above = (0, 0, 56, 56)
    assert first.crop(above).tobytes() == second.crop(above).tobytes() and first.tobytes() != second.tobytes()


def test_a_trial_exercises_everything_and_leaves_nothing(tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr("anystyle.training.stylization.log_picture", lambda logger, *rest: seen.append(type(logger)))
    outcome = train(configuration((*TRACKED, "fast_dev_run=true", "checkpoint.every_steps=1"), tmp_path), tmp_path)
    assert outcome.finished and outcome.steps == 2 and outcome.weights == ()
    assert seen == 2 * [CSVLogger, TensorBoardLogger] and not list(tmp_path.iterdir())


def test_a_loss_that_explodes_stops_the_run(tmp_path):
    config = configuration(STYLIZATION, tmp_path)
    trainer = make_trainer(config, tmp_path, FiniteLoss(tmp_path / "refused_batch.pt"), [])
    guard = FiniteLoss(tmp_path / "batch.pt", growth=10.0)
    training = make_training(config)
    for step in range(25):
        guard.on_train_batch_start(trainer, training, torch.tensor(step), step)
        guard.on_before_backward(trainer, training, torch.tensor(2.0 + step % 3))
    with pytest.raises(ValueError, match=r"the loss is 31, 1\d times the usual; the batch is in"):
        guard.on_before_backward(trainer, training, torch.tensor(31.0))
    assert torch.load(tmp_path / "batch.pt", weights_only=True)["batch"] == 24


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("trainer.precision=16-mixed",), "use bf16-mixed"),
        (("trainer.precision=64",), "weights have single precision; use bf16-mixed"),
        (("trainer.strategy=dpp",), "dpp"),
        (("trainer.strategy=fsdp",), "`fsdp` requires a GPU accelerator"),
        (("+trainer.inference=3",), "unexpected keyword argument 'inference'"),
        (("trainer.max_steps=0",), "trainer.max_steps=0: expected int >= 1"),
        (("trainer.gradient_clip_val=-1",), "trainer.gradient_clip_val=-1: expected float >= 0"),
        (("trainer.val_check_interval=0",), "trainer.val_check_interval=0"),
        (("trainer.devices=0",), "devices=0"),
        (("loggers=tensorboard",), r"loggers=\[tensorboard\]"),
        (("seed=abc",), "seed=abc: expected 0 <= int"),
        (("validation_steps=-1",), "validation_steps=-1"),
        (("checkpoint.every_steps=0",), "checkpoint.every_steps=0: expected int >= 1"),
        (("average=2",), "average=2: expected 0 < float < 1 . None; a decay"),
        (("explosion=0.5",), "explosion=0.5: .* a factor such as 1000"),
        (("resume=maybe",), "resume=maybe: expected 'auto' . 'never' . 'changed'"),
        (("trainer.accelerator=gpu",), "gpu"),
        (("trainer.accumulate_grad_batch=2",), r"Did you mean 'accumulate_grad_batches'\?"),
        (("trainer.accumulate_grad_batches=two",), "could not be converted to Integer"),
        (("trainer.max_step=3",), r"Did you mean 'max_steps'\?"),
        (("trainer.max_time=3",), "days and time as DD:HH:MM:SS"),
        (("trainer.profiler=no_such",), "it can only be one of"),
        (("trainer.precision=transformer-engine",), "transformer_engine"),
        (("loggers=[tensorbord]",), "Did you mean 'tensorboard'"),
    ],
)
def test_contradictory_options_are_refused_in_one_line(tmp_path, words, told):
    if "trainer.accelerator=gpu" in words and torch.cuda.is_available():
        pytest.skip("there is a graphics card")
    with raises_line(ValueError, match=told):
        config = configuration((*STYLIZATION, *words), tmp_path)
        check_options(config)
        make_trainer(config, tmp_path, FiniteLoss(tmp_path / "refused_batch.pt"), [])


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("training.batch_size=0",), "training.batch_size=0: expected int >= 1"),
        (("training.batch_size=null", "training.images=0"), "training.images=0: expected int >= 1"),
        (("training.context_views=[3]",), r"training.context_views=\[3\]: give the least and the greatest"),
        (("training.heights=[28,10]",), r"training.heights=\[28, 10\]"),
        (("training.heights=[30,40]",), r"no multiple of that lies between; give one, such as \[28, 42\]"),
        (("training.heights=[28,28]", "training.width=40"), "training.width=40: .* such as 42"),
        (("training.learning_rate=0",), "training.learning_rate=0.0"),
        (("training.warmup=-1",), "training.warmup=-1: expected int >= 0"),
        (("training.betas=[0.9]",), r"training.betas=\[0.9\]: 2 values are expected"),
        (("training.text_ratio=2",), "training.text_ratio=2.0: expected 0 <= float <= 1"),
        (("~styles",), "needs styles; add styles=NAME"),
        (("scenes.size=30",), r"images are 30x30 pixels.*scenes.multiple=14"),
    ],
)
def test_options_of_a_training_that_no_step_can_have_are_refused_in_one_line(tmp_path, words, told):
    given = [word for word in STYLIZATION if not (word.startswith("styles") and "~styles" in words)]
    with raises_line(ValueError, match=told):
        config = configuration((*given, *words), tmp_path)
        make_data(config, make_training(config)).train.batch(0)


def test_mistakes_in_the_data_show_before_networks_are_loaded(tmp_path, monkeypatch):
    monkeypatch.setattr("anystyle.training.run.make_training", lambda config: pytest.fail("networks were built"))
    given = [word for word in STYLIZATION if not word.startswith("styles")]
    with pytest.raises(ValueError, match="there is no such folder of paintings"):
        train(configuration((*given, "styles=wikiart", f"styles.root={tmp_path / 'gone'}"), tmp_path), tmp_path)


@pytest.mark.parametrize(
    ("name", "package"), [("wandb", "wandb"), ("mlflow", "mlflow-skinny"), ("tensorboard", "tensorboard")]
)
def test_a_tracker_that_is_not_installed_names_its_package(tmp_path, monkeypatch, name, package):
    def absent(*args, **kwargs):
        raise ModuleNotFoundError(name)

    loggers = {"wandb": "WandbLogger", "mlflow": "MLFlowLogger", "tensorboard": "TensorBoardLogger"}
    monkeypatch.setattr(f"anystyle.training.trainer.{loggers[name]}", absent)
    with pytest.raises(MissingExtra, match=f"pip install {package}$"):
        make_loggers([name], tmp_path)


class Torn(StyleSource):
    """Styles of which every third cannot be read."""

    def __len__(self) -> int:
        return 9

    def read(self, style: int) -> Style:
        if style % 3 == 0:
            raise ValueError(f"style_{style}.png is a damaged image")
        return Style(image=hashed(style, (1, 3, 28, 28)))


def test_what_cannot_be_read_is_drawn_anew_with_a_warning(tmp_path, caplog):
    config = configuration((*STYLIZATION, "trainer.max_steps=8"), tmp_path)
    scenes = make_data(config, make_training(config)).train.scenes
    source, again = (SceneBatches(scenes, Torn(), batch_size=4, context_views=(2, 2), spread="any") for _ in range(2))
    for step in range(8):
        batch, other = source.batch(step), again.batch(step)
        assert torch.equal(batch.views.images, other.views.images)
        assert batch.style.has_image.all() and len(batch.keys) == 4
    assert 10 < caplog.text.count("is a damaged image") < 60
    with pytest.raises(ValueError, match=rf"{ATTEMPTS} draws .* could not be read; the last one: .*900 context"):
        SceneBatches(scenes, batch_size=1, context_views=(900, 900), spread="any").batch(0)


def test_only_what_learns_recomputes_its_blocks(tmp_path, monkeypatch):
    words = (*STYLIZATION, "placement=full", "training.cache_scenes=0")
    plain = make_training(configuration(words, tmp_path))
    saving = make_training(configuration((*words, "backbone.checkpointing=true"), tmp_path))
    saving.load_state_dict(plain.state_dict())
    import anystyle_backbones.blocks as module

    calls = []
    whole = module.checkpoint
    monkeypatch.setattr(
        module, "checkpoint", lambda block, *args, **named: calls.append(block) or whole(block, *args, **named)
    )
    gradients = []
    for training in (plain, saving):
        batch = make_data(configuration(words, tmp_path), training).train.batch(0)
        training.train()
        result = training.stylize(batch, training.embed(batch.style, 0))
        (result.renders.color * hashed(3, result.renders.color.shape)).mean().backward()
        gradients.append([p.grad for p in training.stylizer.branch.parameters() if p.grad is not None])
    copied = {id(block) for block in saving.stylizer.branch.aggregator.modules()}
    assert len(calls) == 8 and all(id(block) in copied for block in calls)
    for one, other in zip(*gradients, strict=True):
        torch.testing.assert_close(one, other)
