"""The bundled texture network: it tells textures apart, and its statistics carry them whatever the colours."""

import pytest
import torch

from anystyle import perception
from anystyle.io.checkpoint import read_header
from anystyle.perception import weights
from anystyle.perception.statistics import gram, pooled_moments
from anystyle.perception.texture import Texture
from anystyle_tiny.procedural.patterns import PATTERNS
from anystyle_tiny.procedural.styles import ProceduralStyles

LAYERS = ("relu2_2", "relu3_2", "relu4_1")


@pytest.fixture(scope="module")
def network() -> perception.FeatureNetwork:
    return perception.load("texture")


def test_the_file_says_how_it_was_made() -> None:
    header = read_header(weights.find("texture"))
    assert header.part == "texture"
    assert header.provenance["command"].startswith("anystyle train experiment=tiny_perceptual")
    assert header.provenance["steps"] > 0
    assert header.provenance["commit"]


def read(split: str, count: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Pictures and the numbers of their patterns."""
    styles = ProceduralStyles(size=64, split=split)
    images = torch.cat([styles.read(style).image for style in range(count)])
    return images, torch.tensor([styles.traits(style).pattern for style in range(count)])


@torch.no_grad()
def probed(network: perception.FeatureNetwork, known: torch.Tensor, names: torch.Tensor, unknown: torch.Tensor):
    """The pattern of each unknown picture, by ridge regression on pooled features of known ones."""
    rows, others = (
        torch.cat([pooled_moments(tap) for tap in network(images, LAYERS)], dim=-1) for images in (known, unknown)
    )
    mean, std = rows.mean(0), rows.std(0) + 1e-3
    rows, others = (rows - mean) / std, (others - mean) / std
    targets = torch.nn.functional.one_hot(names, len(PATTERNS)).float()
    weight = torch.linalg.solve(rows.T @ rows + 30 * torch.eye(rows.shape[1]), rows.T @ (targets - targets.mean(0)))
    return (others @ weight + targets.mean(0)).argmax(-1)


def test_a_linear_layer_reads_the_pattern_of_combinations_never_seen(network: perception.FeatureNetwork) -> None:
    """Far better than from the features of a network at birth; chance is 0.05."""
    torch.manual_seed(0)
    (known, names), (unknown, truth) = read("train", 300), read("heldout", 100)
    trained, untrained = (
        (probed(judge, known, names, unknown) == truth).float().mean() for judge in (network, Texture())
    )
    assert trained > 0.4
    assert trained > 2 * untrained


def test_two_cuts_of_a_texture_are_nearer_than_two_textures(network: perception.FeatureNetwork) -> None:
    """Gram matrices of the left and right halves of one picture, against those of other pictures."""
    styles = ProceduralStyles(size=128, split="heldout")
    chosen = [style for style in range(60) if styles.traits(style).scale == 0][:16]
    images = torch.cat([styles.read(style).image for style in chosen])
    with torch.no_grad():
        left, right = (
            torch.cat([gram(tap).flatten(1) / gram(tap).flatten(1).norm() for tap in network(half, LAYERS)], dim=-1)
            for half in (images[..., :64], images[..., 64:])
        )
    nearest = torch.cdist(left, right).argmin(dim=1)
    assert (nearest == torch.arange(len(chosen))).float().mean() >= 0.85
