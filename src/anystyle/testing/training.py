"""What a training promises: see :class:`anystyle.training.contract.Training`."""

import inspect
import logging
import tempfile
import typing
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import lightning.pytorch as pl
import torch
from torch import Tensor, nn

from anystyle.contracts import SceneSource, StyleEncoder, StyleSource
from anystyle.testing.check import Check, attempt, expect, refusal
from anystyle.testing.comparing import expect_same
from anystyle.testing.declaration import example
from anystyle.testing.subject import Subject, seeded
from anystyle.testing.toy.backbone import ToyBackbone
from anystyle.testing.toy.loss import ToyLoss
from anystyle.testing.toy.renderer import ToyRenderer
from anystyle.testing.toy.scenes import ToyScenes
from anystyle.testing.toy.style_encoder import ToyStyleEncoder
from anystyle.testing.toy.styles import ToyStyles
from anystyle.testing.toy.stylizer import ToyStylizer
from anystyle.training.callbacks import StepSeed
from anystyle.training.contract import Training
from anystyle.training.data import BatchSource, StepData
from anystyle.types import Value

Plugin = Subject[Training]
Sources = tuple[SceneSource, StyleSource]

STEPS = 2


def exports_what_it_teaches(plugin: Plugin) -> None:
    """``exports`` names at least one module with weights, and every name is one that a weights file can have."""
    exported = _make(plugin).exports()
    expect(
        isinstance(exported, Mapping) and len(exported) > 0,
        given=f"`exports` returned {exported!r}",
        change="return {'backbone': self.backbone}, or whatever the run is for",
    )
    for name, module in exported.items():
        expect(
            name.isidentifier() and isinstance(module, nn.Module) and any(True for _ in module.parameters()),
            given=f"{name!r}: {type(module).__name__}",
            expected="a module with parameters, under a name of letters, digits and '_'",
            change="export the module that learns",
        )


def batches_are_functions_of_the_step(plugin: Plugin) -> None:
    """A step's batch is the same whatever was asked before, so that a continued run equals an uninterrupted one."""
    sources = _sources(plugin)
    source = _make(plugin).batches(*sources, seed=0)
    first = source.batch(1, 0, 1)
    expect(
        isinstance(first, Value),
        given=f"a batch that is a {type(first).__name__}",
        expected="a dataclass that inherits from anystyle.types.Value",
        change="define one with the tensors of a step, so that it can be moved between devices",
    )
    kept = first.map(Tensor.clone)
    source.batch(0, 0, 1)
    for what, again in (("this source", source), ("a new one", _make(plugin).batches(*sources, seed=0))):
        expect_same(
            again.batch(1, 0, 1),
            kept,
            what=f"the batch of step 1, asked again from {what}",
            change="draw from a generator that is seeded with the seed and the step in each call",
        )


def missing_sources_are_said(plugin: Plugin) -> None:
    """Without scenes and styles it makes its batches all the same, or raises a ValueError of one line."""
    with refusal("use `anystyle.training.contract.required(scenes, 'scenes')`"):
        _make(plugin).batches(None, None, seed=0)


def steps_teach_what_is_exported(plugin: Plugin) -> None:
    """Two steps leave finite weights, and change those of something that it exports."""
    trained, before = _trained(plugin), _weights(_make(plugin))
    after = _weights(trained)
    bad = [name for name, tensor in after.items() if tensor.is_floating_point() and not bool(tensor.isfinite().all())]
    expect(
        not bad,
        given=f"NaN or infinity in {', '.join(bad[:3])} after {STEPS} steps",
        change="look for a division by zero in the loss, and for a learning rate that is too large",
    )
    expect(
        any(name not in before or not torch.equal(before[name], tensor) for name, tensor in after.items()),
        given=f"the same exported weights before and after {STEPS} steps",
        change="return a loss that depends on them, and give their parameters to the optimiser",
    )


def learning_is_reproducible(plugin: Plugin) -> None:
    """The same steps from the same weights give the same weights, bit for bit."""
    expect_same(
        _weights(_trained(plugin, again=True)),
        _weights(_trained(plugin)),
        what=f"weights after {STEPS} steps, learned again",
        change="draw random numbers from torch's global generator alone; it is seeded before each step",
    )


def _make(plugin: Plugin) -> Training:
    # New parts each time: training changes them.
    with seeded(0):
        backbone, encoder, stylizer = ToyBackbone(dim=12, depth=2), _encoder(plugin), ToyStylizer()
    parts = {
        "backbone": backbone,
        "renderer": ToyRenderer(),
        "style_encoder": encoder,
        "stylizer": stylizer,
        "losses": {"toy": ToyLoss()},
    }
    return plugin.build(**parts)


def _encoder(plugin: Plugin) -> StyleEncoder:
    # A training may be made for one style encoder; its annotation says so.
    hints = typing.get_type_hints(plugin.cls.__init__)
    hint = hints.get("style_encoder")
    if inspect.isclass(hint) and issubclass(hint, StyleEncoder) and not inspect.isabstract(hint):
        with tempfile.TemporaryDirectory() as folder:
            return hint(**example(hint, Path(folder)))
    return ToyStyleEncoder()


def _sources(plugin: Plugin) -> Sources:
    """Scenes and styles that it says it can make a batch of, or else the toys."""
    return plugin.once("sources", lambda: _suiting(plugin))


def _suiting(plugin: Plugin) -> Sources:
    sources = plugin.cls.example_sources() or (ToyScenes(size=(32, 32)), ToyStyles(size=32, period=8))
    change = "return options from `example` that small sources are enough for, or sources from `example_sources`"
    with attempt("the batch of step 0", change=change):
        _make(plugin).batches(*sources, seed=0).batch(0, 0, 1)
    return sources


def _trained(plugin: Plugin, *, again: bool = False) -> Training:
    return plugin.once(f"trained {again}", lambda: _train(plugin))


def _train(plugin: Plugin) -> Training:
    training, (scenes, styles) = _make(plugin), _sources(plugin)
    source: BatchSource = training.batches(scenes, styles, seed=0)
    change = "see the line named above"
    with attempt(f"{STEPS} steps", change=change), seeded(0), _quiet():
        trainer = pl.Trainer(
            accelerator="cpu",
            max_steps=STEPS,
            max_epochs=-1,
            logger=False,
            enable_checkpointing=False,
            enable_progress_bar=False,
            enable_model_summary=False,
            use_distributed_sampler=False,
            num_sanity_val_steps=0,
            limit_val_batches=0,
            callbacks=[StepSeed(0)],
        )
        trainer.fit(training, datamodule=StepData(source))
    return training


@contextmanager
def _quiet() -> Iterator[None]:
    # Lightning greets, and advises on what matters in long runs alone.
    loggers = [logging.getLogger(name) for name in ("lightning.pytorch", "lightning.pytorch.utilities.rank_zero")]
    levels = [logger.level for logger in loggers]
    try:
        for logger in loggers:
            logger.setLevel(logging.ERROR)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


def _weights(training: Training) -> dict[str, Any]:
    return {
        f"{name}.{key}": tensor.detach().clone()
        for name, module in training.exports().items()
        for key, tensor in module.state_dict().items()
    }


CHECKS: tuple[Check, ...] = (
    Check(exports_what_it_teaches, needed=True),
    Check(batches_are_functions_of_the_step, needed=True),
    Check(missing_sources_are_said),
    Check(steps_teach_what_is_exported),
    Check(learning_is_reproducible),
)
