"""Mixed precision: what is computed in bfloat16 and what is not, and that such a run continues bit for bit too."""

import pytest
import torch
from safetensors.torch import load_file

from anystyle.branch import StyleBranch
from anystyle.stylizer import Stylizer
from anystyle.training.run import train
from anystyle_methods.total_variation import TotalVariation
from tests.support.training_cases import STYLIZATION, configuration

WORDS = (
    *STYLIZATION, "trainer.precision=bf16-mixed", "placement=full", "training.pool=1", "training.batch_size=1",
    "training.text_ratio=0", "training.cache_scenes=0", "training.decay_steps=6", "export.half=false",
)  # fmt: skip


@pytest.mark.slow
def test_a_mixed_run_learns_and_continues_bit_for_bit(tmp_path):
    whole, halves = tmp_path / "whole", tmp_path / "halves"
    outcome = train(configuration(WORDS, whole), whole)
    rows = [line.split(",") for line in (whole / "log" / "version_0" / "metrics.csv").read_text().splitlines()]
    column = rows[0].index("train/loss")
    losses = [float(row[column]) for row in rows[1:] if row[column]]
    assert outcome.finished and losses[-1] < losses[0]
    train(configuration((*WORDS, "trainer.max_steps=3"), halves), halves)
    train(configuration((*WORDS, "resume=changed"), halves), halves)
    first, second = (load_file(out / "branch.safetensors") for out in (whole, halves))
    assert all(torch.equal(first[key], second[key]) for key in first)
    # Bits of full precision are other bits: the precision was no empty word.
    plain = tmp_path / "plain"
    train(configuration((*WORDS, "trainer.precision=32-true"), plain), plain)
    assert any(not torch.equal(first[key], tensor) for key, tensor in load_file(plain / "branch.safetensors").items())


def test_networks_compute_in_half_and_weights_geometry_and_losses_do_not(tmp_path, monkeypatch):
    seen: dict[str, set[torch.dtype]] = {"frozen": set(), "styled": set(), "judged": set()}
    mixed: set[bool] = set()
    encode, predict, judge = Stylizer.encode, StyleBranch.forward, TotalVariation.forward

    def encoding(self, views):
        product = next(module for module in self.backbone.aggregator.modules() if isinstance(module, torch.nn.Linear))
        hook = product.register_forward_hook(lambda module, given, found: seen["frozen"].add(found.dtype))
        scene = encode(self, views)
        hook.remove()
        assert not torch.is_grad_enabled() or not scene.attributes.color.requires_grad
        assert not self.backbone.training and not self.style_encoder.training
        assert {p.dtype for p in self.parameters()} == {torch.float32}
        return scene

    def predicting(self, scene, embedding):
        attributes = predict(self, scene, embedding)
        assert self.training and attributes.color.requires_grad
        seen["styled"].add(attributes.color.dtype)
        return attributes

    def judging(self, result):
        mixed.add(torch.is_autocast_enabled("cpu"))
        geometry = result.scene.geometry
        tensors = (
            result.renders.color, result.renders.depth, result.gaussians.means, result.views.images, geometry.depth,
            geometry.cameras.world_from_camera, result.embedding.direction,
        )  # fmt: skip
        seen["judged"] |= {tensor.dtype for tensor in tensors}
        return judge(self, result)

    monkeypatch.setattr(Stylizer, "encode", encoding)
    monkeypatch.setattr(StyleBranch, "forward", predicting)
    monkeypatch.setattr(TotalVariation, "forward", judging)
    train(configuration((*WORDS, "trainer.max_steps=1"), tmp_path), tmp_path)
    assert seen["frozen"] == seen["styled"] == {torch.bfloat16}
    assert seen["judged"] == {torch.float32} and mixed == {False}
    checkpoint = torch.load(tmp_path / "last.ckpt", weights_only=True)
    averages = [value for state in checkpoint["optimizer_states"][0]["state"].values() for value in state.values()]
    assert {tensor.dtype for tensor in (*checkpoint["state_dict"].values(), *averages)} == {torch.float32}
