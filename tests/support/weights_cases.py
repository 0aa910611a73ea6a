"""Published checkpoints in miniature, for tests of what reads them."""

import re
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor

from anystyle.branch import StyleBranch
from anystyle.injectors.zero_conv import ZeroConv
from anystyle.placements import Full, Head
from anystyle.registry.catalog import catalog

STYLE_DIM = 512
PLACEMENTS = {"head": Head(), "full": Full()}


def small_checkpoint(placement: str | None, prefix: str = "", seed: int = 0) -> dict[str, Tensor]:
    """AnySplat of a few thin layers, or AnyStyle around it, under published names."""
    plugin = catalog().find("backbone", "anysplat").load()
    from anystyle_backbones.anysplat import keys

    torch.manual_seed(seed)
    backbone = plugin(**plugin.example(Path()))
    state = _published(backbone.state_dict(), keys.backbone_names)
    state["aggregator.patch_embed.mask_token"] = torch.zeros(1, backbone.aggregator.dim)
    if placement is not None:
        branch = StyleBranch(
            backbone,
            sites=PLACEMENTS[placement].select(backbone.sites),
            make_injector=lambda site: ZeroConv(
                dim=site.dim, style_dim=STYLE_DIM, hidden=16 if site.name == "head/direct" else 24
            ),
        )
        for parameter in branch.parameters():
            torch.nn.init.normal_(parameter, std=0.05)
        state |= _published(branch.state_dict(), keys.branch_names)
        for layer in (0, 2):
            state[f"text_adapter.mlp.{layer}.weight"] = 0.01 * torch.randn(STYLE_DIM, STYLE_DIM)
            state[f"text_adapter.mlp.{layer}.bias"] = torch.zeros(STYLE_DIM)
    return {prefix + name: tensor.contiguous() for name, tensor in state.items()}


def training_checkpoint(placement: str) -> dict[str, object]:
    """As a training run leaves it: optimiser state and configuration beside the weights."""
    from omegaconf import OmegaConf

    state = small_checkpoint(placement, "model.encoder.")
    moments = {place: {"exp_avg": torch.zeros(tensor.shape)} for place, tensor in enumerate(state.values())}
    return {
        "state_dict": state,
        "optimizer_states": [{"state": moments}],
        "hyper_parameters": OmegaConf.create({"model": {"encoder": {"layers": [0, 4]}}}),
        "global_step": 90000,
    }


def _published(state: Mapping[str, Tensor], names: object) -> dict[str, Tensor]:
    found = {}
    for key, name in names(list(state)).items():
        tensor = state[key].clone()
        one_by_one = re.search(r"projects\.\d\.weight|zero_proj\.weight", name)
        found[name] = tensor[:, :, None, None] if one_by_one else tensor
    return found
