"""Losses on features against the goldens, literal transcriptions of their equations, and what must not matter."""

import gc
import weakref

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from anystyle.contracts import Loss
from anystyle.losses.content import Content
from anystyle.losses.features import features_to_compare, objective
from anystyle.losses.style import StyleLoss
from anystyle.testing.oracle import assert_matches, smooth_image
from anystyle.vision import networks
from anystyle_methods.gram import Gram
from anystyle_methods.nnfm import NNFM
from anystyle_methods.simultaneous_scales import SimultaneousScales
from anystyle_methods.sliced_wasserstein import SlicedWasserstein
from anystyle_methods.total_variation import TotalVariation
from tests.support.oracle import golden
from tests.support.style_cases import filled_vgg_file, stylization

RENDERED = smooth_image(4501, [2, 2, 3, 84, 112])
PHOTOGRAPHS = smooth_image(4503, [2, 2, 3, 84, 112])
STYLES = smooth_image(4505, [2, 3, 112, 112])
SMALL = {"size": None, "layers": ("relu1_1", "relu2_1")}


@pytest.fixture(scope="module")
def vgg() -> networks.FeatureNetwork:
    return networks.load("vgg19", filled_vgg_file())


def test_style_and_content_match_the_reference() -> None:
    expected = golden("golden_metrics")["style_content_loss"]
    rendered = RENDERED.clone().requires_grad_()
    style, content = StyleLoss(), Content()
    with torch.no_grad():
        everywhere = style.weight * style(stylization(rendered, PHOTOGRAPHS, STYLES))
    assert everywhere.item() == pytest.approx(expected["mask_none"]["style"], rel=1e-4)
    result = stylization(rendered, PHOTOGRAPHS, STYLES, has_image=torch.tensor([True, False]))
    total, values = objective({"style": style, "content": content}, result)  # in one pass over the renders
    assert style.weight * values["style"].item() == pytest.approx(expected["mask_1_0"]["style"], rel=1e-4)
    assert content.weight * values["content"].item() == pytest.approx(expected["mask_1_0"]["content"], rel=1e-4)
    total.backward()
    assert_matches(rendered.grad, expected["mask_1_0"]["grad_pred"], rtol=2e-3, atol=2e-8)


@pytest.mark.parametrize("build", [StyleLoss, Gram, SlicedWasserstein])
def test_a_style_without_an_image_adds_nothing(build: type[Loss]) -> None:
    loss = build(network="vgg19", **SMALL)
    images, photographs = RENDERED[:, :, :, :40, :40], PHOTOGRAPHS[:, :, :, :40, :40]
    styles = STYLES[:, :, :50, :60].clone()
    styles[1] = torch.nan  # undefined where there is none
    half = loss(stylization(images, photographs, styles, has_image=torch.tensor([True, False])))
    torch.testing.assert_close(half, loss(stylization(images[:1], photographs[:1], styles[:1])))
    assert loss(stylization(images, photographs, styles, has_image=torch.tensor([False, False]))) == 0
    assert loss(stylization(images, photographs)) == 0


@pytest.mark.parametrize("build", [StyleLoss, Gram, SlicedWasserstein, NNFM])
def test_a_render_that_is_the_style_image_is_perfect(build: type[Loss]) -> None:
    image = STYLES[:1, :, :48, :48]
    loss = build(network="vgg19", size=None, layers=("relu2_1",))
    perfect = stylization(image[:, None], PHOTOGRAPHS[:1, :1, :, :48, :48], image)
    assert loss(perfect).item() == pytest.approx(0, abs=1e-5)


def test_gram_is_its_equation(vgg: networks.FeatureNetwork) -> None:
    images, styles = RENDERED[:1, :, :, :40, :48], STYLES[:1, :, :56, :40]
    total = torch.zeros(())
    for layer in ("relu1_1", "relu3_1"):
        (target,) = vgg(styles, [layer])
        expected = torch.einsum("cp,dp->cd", target[0].flatten(1), target[0].flatten(1)) / target[0, 0].numel()
        for view in images[0]:
            (found,) = vgg(view[None], [layer])
            products = torch.einsum("cp,dp->cd", found[0].flatten(1), found[0].flatten(1)) / found[0, 0].numel()
            total = total + ((products - expected) ** 2).mean() / 2
    loss = Gram(size=None, layers=("relu1_1", "relu3_1"))
    torch.testing.assert_close(loss(stylization(images, images, styles)), total, rtol=1e-4, atol=0)


def test_relative_losses_are_the_root_of_the_ratio_of_each_layer() -> None:
    rendered, photographs = RENDERED[:1, :1, :, :40, :40], PHOTOGRAPHS[:1, :1, :, :40, :40]
    styles = STYLES[:1, :, :40, :40]
    ratios = []
    for layer in ("relu1_1", "relu2_1"):
        loss = StyleLoss(size=None, layers=(layer,))
        ratio = loss(stylization(rendered, photographs, styles)) / loss(stylization(photographs, photographs, styles))
        ratios.append((ratio + 1e-3).sqrt())
    found = StyleLoss(relative=True, **SMALL)(stylization(rendered, photographs, styles))
    torch.testing.assert_close(found, torch.stack(ratios).mean(), rtol=1e-4, atol=0)


def test_nnfm_is_its_equation(vgg: networks.FeatureNetwork) -> None:
    images, styles = RENDERED[:, :, :, :24, :32], STYLES[:, :, :40, :24]
    layers = ("relu3_1", "relu3_2", "relu3_3")
    total = torch.zeros(())
    for scene in range(2):
        wanted = torch.cat(vgg(styles[scene][None], layers), dim=1)[0].flatten(1).T
        for view in images[scene]:
            found = torch.cat(vgg(view[None], layers), dim=1)[0].flatten(1).T
            similarity = F.cosine_similarity(found[:, None], wanted[None], dim=-1)
            total = total + (1 - similarity).min(dim=1).values.mean() / 4
    torch.testing.assert_close(NNFM(size=None)(stylization(images, images, styles)), total, rtol=1e-4, atol=1e-6)


def test_a_palette_loss_tells_two_colours_from_their_mean() -> None:
    """Stripes of orange and navy, against flat brown (their mean) and against the same two colours placed anew."""
    orange, navy = torch.tensor([1.0, 0.5, 0.0]), torch.tensor([0.0, 0.0, 0.5])
    stripes = torch.where((torch.arange(32) % 8 < 4)[None, None, :], orange[:, None, None], navy[:, None, None])
    stripes = stripes.expand(3, 32, 32)
    flat = ((orange + navy) / 2)[:, None, None].expand(3, 32, 32)
    halves = stripes.mT
    loss = SlicedWasserstein(network="vgg19")

    def against(image: Tensor) -> float:
        return loss(stylization(image[None, None], PHOTOGRAPHS[:1, :1, :, :32, :32], stripes[None])).item()

    assert against(halves) == pytest.approx(0, abs=1e-10) and against(flat) > 0.05


def test_features_to_compare_are_computed_once_for_a_tensor_and_die_with_it() -> None:
    computed: list[Tensor] = []

    def compute(images: Tensor) -> list[Tensor]:
        computed.append(images.clone())
        return [images]

    images = PHOTOGRAPHS.clone()
    first, again = (features_to_compare(images, ("network",), compute)[0] for _ in range(2))
    assert first is again
    torch.testing.assert_close(first, PHOTOGRAPHS.flatten(0, 1))
    features_to_compare(images, ("another network",), compute)
    images.mul_(0.5)
    torch.testing.assert_close(features_to_compare(images, ("network",), compute)[0], images.flatten(0, 1))
    images.numpy()[...] *= 0.5  # as a buffer is filled, of which PyTorch's count of writes knows nothing
    torch.testing.assert_close(features_to_compare(images, ("network",), compute)[0], images.flatten(0, 1))
    features_to_compare(images.bfloat16(), ("network",), compute)
    assert len(computed) == 5
    gone = weakref.ref(images)
    del images, first, again
    computed.clear()
    gc.collect()
    assert gone() is None


def test_the_objective_is_the_weighted_sum_and_reads_a_network_once_for_all_its_losses() -> None:
    size, layers = None, ("relu2_1", "relu3_1")
    terms: dict[str, Loss] = {
        "nnfm": NNFM(network="texture", size=size, layers=("relu3_1", "relu3_2"), weight=2.0),
        "content": Content(network="texture", size=size, layers=layers, weight=0.5),
        "scales": SimultaneousScales(network="texture", layers=layers, scales=2, weight=0.01),
        "small": StyleLoss(network="texture", size=48, layers=layers),
        "total_variation": TotalVariation(),
    }
    rendered = RENDERED[:, :, :, :48, :64].clone().requires_grad_()
    result = stylization(rendered, PHOTOGRAPHS[:, :, :, :48, :64], STYLES)
    plain = {name: term(result) for name, term in terms.items()}
    expected = torch.stack([terms[name].weight * value for name, value in plain.items()]).sum()
    (gradient,) = torch.autograd.grad(expected, rendered)
    seen: list[torch.Size] = []
    for name in ("nnfm", "content", "scales", "small"):
        terms[name].network.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[0].shape[-2:]))
    total, values = objective(terms, result)
    torch.testing.assert_close(total, expected)
    torch.testing.assert_close(values, {name: value.detach() for name, value in plain.items()})
    torch.testing.assert_close(torch.autograd.grad(total, rendered)[0], gradient)
    assert sorted(seen) == [(24, 32), (48, 48), (48, 64)]  # targets are known from before
