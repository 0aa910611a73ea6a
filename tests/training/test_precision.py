"""Mixed precision: what is computed in bfloat16 and what is not."""

import torch

from anystyle.branch import StyleBranch
from anystyle.stylizer import Stylizer
from anystyle.training.run import train
from anystyle_methods.total_variation import TotalVariation
from tests.support.training_cases import STYLIZATION, configuration

WORDS = (
    *STYLIZATION, "trainer.precision=bf16-mixed", "placement=full", "training.pool=1", "training.batch_size=1",
    "training.text_ratio=0", "training.cache_scenes=0", "training.decay_steps=6", "export.half=false",
)  # fmt: skip


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
