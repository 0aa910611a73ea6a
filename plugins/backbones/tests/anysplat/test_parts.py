"""What the whole network's goldens leave out: tokens of another reference view, and styled parts at published width."""

from functools import partial

import torch

from anystyle.injectors.zero_conv import ZeroConv
from anystyle.nn.attention import Block
from anystyle.testing.oracle import assert_matches, hashed
from anystyle.types import Inject, Tokens
from anystyle_backbones import dpt
from anystyle_backbones.anysplat import keys
from anystyle_backbones.anysplat.networks import Aggregator, Embedder, GaussianHead, Patches
from tests.support import anysplat_reference as reference
from tests.support.oracle import golden

GOLDEN = golden("anystyle_golden")


def test_the_reference_has_camera_and_register_tokens_of_its_own() -> None:
    embedder = Embedder(8, Patches(8, 14), registers=4, patch_size=14, reference="middle")
    stem = embedder(hashed(1, (2, 3, 3, 14, 28)))
    assert stem.special == 5 and stem.reference is not None and stem.reference.tolist() == [1, 1]
    own, shared = torch.cat([embedder.camera_token, embedder.register_token], dim=2)[0]
    torch.testing.assert_close(stem.data[:, :, :5], torch.stack([shared, own, shared]).expand(2, -1, -1, -1))


def with_injectors(injectors: torch.nn.ModuleDict) -> Inject:
    style = reference.style_vector()
    return lambda site, tokens: injectors[site](tokens, style) if site in injectors else tokens


def test_styled_aggregator_at_full_width() -> None:
    record = GOLDEN["aggregator_injection_d5"]
    make_block = partial(Block, 1024, 16, mlp_ratio=4.0, layer_scale=0.01, qk_norm=True)
    options = {"depth": 5, "rope_base": 100.0, "taps": (0, 4), "checkpointing": False}
    # Five layers have five published injectors, of which those of layers 0 and 4 are called; the others only count.
    injectors = {f"aggregator/{layer}": ZeroConv(dim=1024, style_dim=512) for layer in (0, 4, 5, 6, 7)}
    parts = torch.nn.ModuleDict(
        {"aggregator": Aggregator(1024, make_block, **options), "injectors": torch.nn.ModuleDict(injectors)}
    )
    assert reference.fill(parts, keys.branch_names, published="aggregator_injection.") == record["n_keys"]
    stem = Tokens(hashed(1005, (1, 2, 9, 1024), -1, 1), grid=(2, 2), special=5)
    with torch.no_grad():
        features = parts["aggregator"](stem, with_injectors(parts["injectors"]))
    assert_matches(features[0].data, record["out0"])
    assert_matches(features[4].data, record["out1"])


def test_styled_gaussian_head_at_full_width() -> None:
    record = GOLDEN["gs_head_style_full"]
    decoder = dpt.Dpt(dim=2048, features=256, channels=(256, 512, 1024, 1024), hidden=128, outputs=84)
    head = GaussianHead(
        decoder, torch.nn.Conv2d(3, decoder.width, 7, padding=3), sh_degree=4, taps=(0, 1, 2, 3), chunk=4
    )
    injectors = torch.nn.ModuleDict({site.name: reference.published_injector(site) for site in head.sites})
    parts = torch.nn.ModuleDict({"gaussian_head": head, "injectors": injectors})
    assert reference.fill(parts, keys.branch_names, published="gaussian_param_head_style.") == record["n_keys"]
    levels = {
        level: Tokens(hashed(1020 + level, (1, 2, 11, 2048), -1, 1), grid=(2, 3), special=5) for level in range(4)
    }
    with torch.no_grad():
        attributes = head(levels, hashed(1014, (1, 2, 3, 28, 42)), with_injectors(injectors))
    assert_matches(reference.raw_maps(attributes), record["out"])
