#!/usr/bin/env bash
# PEFT 0.21.2, adapters of convolutions: OFT that learnt nothing changes outputs sixfold, and merging undoes it.
#
# A convolution of 3x3, 8 channels, on 16x16 pixels. An adapter should change nothing before it is trained. Seen: what
# it changes untrained, over the mean size of outputs; and, with random numbers in the place of training, how far
# `merge_and_unload` is from the adapter at the pixels of the border, over what the adapter does there:
#                          untrained, padding of     trained, merged       trained, merged
#                          zeros      "reflect"      zeros                 "reflect", at the border
#   OFT                    5.9        5.9            1.0 (everywhere)      1.0 (everywhere)
#   OFT, kernel of 1x1     0          no border      0                     no border
#   HRA                    0          0.16           0                     1.0
#   LoRA, LoHa, LoKr       0          0              0                     0.7 to 0.8
#   HiRA                   0          0              0                     0.8
#   IA3                    0          0              0                     0
# OFT turns patches and adds them up where they overlap, nine at a pixel; merged it turns the kernel, which is right.
# The others pad with zeros where the layer reflects, as networks of style do, and merging brings the reflection: what
# was trained is not what is saved. No warning. Of these LoRA is known publicly. Leave such layers out of
# `target_modules`, or train with nn.ReflectionPad2d before a convolution without padding.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 numpy==2.4.6 peft==0.21.2 transformers==5.24.0 accelerate==1.15.0
env/bin/python -W error::UserWarning - <<'PYTHON'
import torch
from peft import HiraConfig, HRAConfig, IA3Config, LoHaConfig, LoKrConfig, LoraConfig, OFTConfig, get_peft_model
from torch import nn


class Network(nn.Module):
    def __init__(self, layer):
        super().__init__()
        self.layer = layer

    def forward(self, pictures):
        return self.layer(pictures)


def border(values):
    inside = torch.ones(values.shape[-2:], dtype=torch.bool)
    inside[1:-1, 1:-1] = False
    return values[..., inside].abs().mean()


@torch.no_grad()
def look(kind, options, layer):
    """What an untrained adapter changes; merged against trained at the border, and inside."""
    pictures = torch.rand(2, 8, 16, 16, generator=torch.Generator().manual_seed(0))
    network = Network(layer)
    base = network(pictures)
    torch.manual_seed(3)
    model = get_peft_model(network, kind(target_modules=["layer"], **options)).eval()
    untrained = float((model(pictures) - base).abs().mean() / base.abs().mean())
    for parameter in model.parameters():
        if parameter.requires_grad:
            parameter.add_(torch.randn_like(parameter) * 0.05)
    trained = model(pictures)
    merged = model.merge_and_unload()(pictures)
    size = border(trained - base)
    inside = (merged - trained)[..., 1:-1, 1:-1].abs().mean() / (trained - base)[..., 1:-1, 1:-1].abs().mean()
    return untrained, float(border(merged - trained) / size), float(inside)


def layer(mode="zeros", size=3):
    torch.manual_seed(0)
    return nn.Conv2d(8, 8, size, padding=size // 2, padding_mode=mode)


ADAPTERS = {
    "OFT": (OFTConfig, {"r": 4, "oft_block_size": 0}),
    "HRA": (HRAConfig, {"r": 4}),
    "LoRA": (LoraConfig, {"r": 8}),
    "LoHa": (LoHaConfig, {"r": 8}),
    "LoKr": (LoKrConfig, {"r": 8}),
    "HiRA": (HiraConfig, {}),
    "IA3": (IA3Config, {"feedforward_modules": ["layer"]}),
}
found = {}
for name, (kind, options) in ADAPTERS.items():
    for mode in ("zeros", "reflect"):
        found[name, mode] = look(kind, options, layer(mode))
        print(f"{name:5} {mode:8} untrained {found[name, mode][0]:.3f}, merged at the border "
              f"{found[name, mode][1]:.3f}, inside {found[name, mode][2]:.6f}")
small = look(*ADAPTERS["OFT"], layer(size=1))
print("OFT, 1x1:", *(f"{value:.6f}" for value in small))
assert max(small) < 1e-4
for mode in ("zeros", "reflect"):
    untrained, at_border, inside = found.pop(("OFT", mode))
    assert 5 < untrained < 7 and 0.8 < at_border < 1.2 and 0.8 < inside < 1.2
for (name, mode), (untrained, at_border, inside) in found.items():
    assert inside < 1e-3, (name, mode)
    if mode == "zeros" or name == "IA3":
        assert untrained < 1e-4 and at_border < 1e-3, (name, mode)
    else:
        assert 0.9 < at_border < 1.2 if name == "HRA" else 0.6 < at_border < 0.9, (name, mode)
        assert 0.1 < untrained < 0.2 if name == "HRA" else untrained < 1e-4, (name, mode)
PYTHON
echo "as described"
