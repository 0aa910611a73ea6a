"""What a training promises: see :class:`anystyle.contracts.Training`."""

import inspect
import logging
import tempfile
import typing
import warnings
from functools import cache
from pathlib import Path
from typing import Any

import lightning.pytorch as pl
import torch
from torch import Tensor, nn

from anystyle.contracts import StyleEncoder
from anystyle.contracts.training import Training
from anystyle.testing import asserts
from anystyle.testing.subject import Subject
from anystyle.testing.toy.backbone import ToyBackbone
from anystyle.testing.toy.loss import ToyLoss
from anystyle.testing.toy.renderer import ToyRenderer
from anystyle.testing.toy.scenes import ToyScenes
from anystyle.testing.toy.style_encoder import ToyStyleEncoder
from anystyle.testing.toy.styles import ToyStyles
from anystyle.testing.toy.stylizer import ToyStylizer
from anystyle.training.callbacks import StepSeed
from anystyle.training.data import StepData
from anystyle.types import Value
from anystyle.types.seeds import seeded

SOURCES = ToyScenes(size=(32, 32)), ToyStyles(size=32, period=8)


def test_exports_what_it_trains(plugin: Subject[Training]) -> None:
    """``exports`` names at least one module with weights, and every name is an identifier."""
    exported = _make(plugin).exports()
    assert exported, "`exports` is empty; return {'backbone': self.backbone}, or whatever module learns"
    for name, module in exported.items():
        valid = name.isidentifier() and isinstance(module, nn.Module) and next(module.parameters(), None) is not None
        assert valid, f"`exports` has {name!r}: {type(module).__name__}, not a module with weights by an identifier"


def test_batches_are_functions_of_the_step(plugin: Subject[Training]) -> None:
    """A step's batch does not depend on earlier steps, so that a resumed run equals an uninterrupted one."""
    source = _make(plugin).batches(*SOURCES, seed=0)
    first = source.batch(1, 0, 1)
    assert isinstance(first, Value), f"a batch is a {type(first).__name__}, not a dataclass of anystyle.types.Value"
    kept = first.map(Tensor.clone)
    source.batch(0, 0, 1)
    for what, again in (("this source", source), ("a new one", _make(plugin).batches(*SOURCES, seed=0))):
        asserts.same(again.batch(1, 0, 1), kept, f"the batch of step 1, asked again from {what}")


def test_steps_train_what_is_exported(plugin: Subject[Training]) -> None:
    """Two steps change the weights of something that it exports, to finite ones, and to the same bits twice."""
    before, after = _weights(_make(plugin)), _trained(plugin)
    asserts.finite(after, "the weights after two steps")
    changed = any(name not in before or not torch.equal(before[name], tensor) for name, tensor in after.items())
    assert changed, "the same exported weights before and after two steps; does the optimiser have them?"
    asserts.same(_trained.__wrapped__(plugin), after, "the weights of a second run of two steps")


def _make(plugin: Subject[Training]) -> Training:
    with seeded(0):
        parts = {"backbone": ToyBackbone(dim=12, depth=2), "stylizer": ToyStylizer(), "renderer": ToyRenderer()}
        return plugin.build(**parts, style_encoder=_encoder(plugin), losses={"toy": ToyLoss()})


def _encoder(plugin: Subject[Training]) -> StyleEncoder:
    """Of the class that the training's annotation asks for: a training may be made for one style encoder."""
    hint = typing.get_type_hints(plugin.cls.__init__).get("style_encoder")
    if inspect.isclass(hint) and issubclass(hint, StyleEncoder) and not inspect.isabstract(hint):
        with tempfile.TemporaryDirectory() as folder:
            return hint(**hint.example(Path(folder)))
    return ToyStyleEncoder()


@cache
def _trained(plugin: Subject[Training]) -> dict[str, Tensor]:
    """The weights after two steps."""
    training = _make(plugin)
    source = training.batches(*SOURCES, seed=0)
    off = ("logger", "enable_checkpointing", "enable_progress_bar", "enable_model_summary", "use_distributed_sampler")
    options: dict[str, Any] = dict.fromkeys(off, False) | {"num_sanity_val_steps": 0, "limit_val_batches": 0}
    logging.disable(logging.WARNING)  # Lightning greets, and advises on long runs
    with seeded(0), warnings.catch_warnings(action="ignore"):
        trainer = pl.Trainer(accelerator="cpu", max_steps=2, max_epochs=-1, callbacks=[StepSeed(0)], **options)
        trainer.fit(training, datamodule=StepData(source))
    logging.disable(logging.NOTSET)
    return _weights(training)


def _weights(training: Training) -> dict[str, Tensor]:
    modules = nn.ModuleDict(dict(training.exports()))
    return {name: tensor.detach().clone() for name, tensor in modules.state_dict().items()}
