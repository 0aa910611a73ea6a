"""docs/add_a_network.md: its code, from the oracle to the weights, brings a published network that is written here."""

import sys
from pathlib import Path
from types import ModuleType

import torch
import torch.nn.functional as F
from torch import nn

from anystyle.testing import subject
from anystyle.testing.run import promises
from anystyle.testing.toy.backbone import ToyBackbone
from tests.support.docs_cases import FENCE

PAGE = (Path(__file__).parents[2] / "docs" / "add_a_network.md").read_text(encoding="utf-8")


class Encoder(nn.Module):
    def __init__(self, dim, patch_size):
        super().__init__()
        self.patch_embed = nn.Conv2d(3, dim, patch_size, stride=patch_size)

    def forward(self, images):
        tokens = torch.stack([self.patch_embed(2 * scene - 1).flatten(2).mT for scene in images])
        return torch.cat([tokens.mean(2, keepdim=True), tokens], dim=2)


class Network(nn.Module):
    """What others published: depth at 2 from tokens that learn from their scene's mean, and Gaussians beside."""

    def __init__(self, *, dim, depth, patch_size):
        super().__init__()
        self.side = patch_size
        self.encoder = Encoder(dim, patch_size)
        self.trunk = nn.ModuleList(nn.ModuleDict({"fc": nn.Linear(2 * dim, dim)}) for _ in range(depth))
        self.head = nn.ModuleDict({"position": nn.Linear(dim, 3), "depth": nn.Linear(dim, 2 * patch_size**2)})
        self.splats = nn.ModuleDict({"attributes": nn.Linear(dim, 11 * patch_size**2)})

    def forward(self, images):
        x = self.encoder(images)
        for layer in self.trunk:
            x = x + F.gelu(layer["fc"](torch.cat([x, x.mean((1, 2), keepdim=True).expand_as(x)], dim=-1)))
        raw = self.head["depth"](x[:, :, 1:])  # B V hw 2 side side
        rows, columns = images.shape[-2] // self.side, images.shape[-1] // self.side
        raw = raw.unflatten(2, (rows, columns)).unflatten(-1, (2, self.side, self.side))
        depth = 2 + raw[..., 0, :, :].tanh().transpose(3, 4).flatten(2, 3).flatten(3)
        return depth, torch.cat([0.1 * self.head["position"](x[:, :, 0]), depth.mean((2, 3))[..., None]], dim=-1)


def test_its_code_brings_a_network_whose_numbers_are_the_published_ones(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    oracle, check, weights = [text for language, text in FENCE.findall(PAGE) if language == "python"]
    space: dict[str, object] = {}
    exec(weights, space)
    Mine = type("Mine", (ToyBackbone,), {"__doc__": "Theirs.", "published": space["TheirCheckpoints"]()})
    for name, content in (("theirs", {}), ("theirs.model", {"Network": Network}), ("anystyle_mine", {"Mine": Mine})):
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)
    exec(oracle, space)
    exec(check, space)
    space["test_it_computes_what_was_published"]()
    tested = subject("backbone", Mine)
    kept = [promise for promise in promises("backbone") if "published" in promise.__name__]
    assert len(kept) == 2
    for promise in kept:
        promise(tested)
