"""EfficientNet-Lite0, statistics of features, and what styles are told apart by."""

import numpy as np
import pytest
import torch
from skimage.exposure import equalize_hist

from anystyle.data.images import read_image
from anystyle.evaluation.judge import judge_scene
from anystyle.testing.inputs import images
from anystyle.testing.oracle import hashed
from anystyle.types import Comparison, Style
from anystyle.vision import networks
from anystyle.vision.statistics import equalized_gray, hellinger, mean_std, rgb_uv_histogram
from anystyle_metrics.style_retrieval import StyleRetrieval
from tests.support.oracle import golden, stripes_and_rings
from tests.support.real_data import real


@pytest.fixture(scope="module")
def network():
    try:
        return networks.load("efficientnet_lite0")
    except FileNotFoundError as error:
        pytest.skip(str(error))


# Logits of classes on closed-form pictures, by the published implementation, efficientnet_lite_pytorch 0.1.0.
PUBLISHED = {
    0.3: {506: 9.58305, 723: 5.67388, 782: 5.19442, 0: 1.39016, 2: -2.20263},
    1.1: {506: 10.75606, 111: 5.59293, 723: 5.57744, 0: 1.03773, 2: -2.53318},
}


@torch.no_grad()
@pytest.mark.parametrize("phase", PUBLISHED)
def test_the_classifier_gives_the_published_implementations_scores(network, phase):
    logits = network.logits(stripes_and_rings(224, phase))[0]
    classes = list(PUBLISHED[phase])
    assert logits.argmax() == classes[0]
    np.testing.assert_allclose(logits[classes], list(PUBLISHED[phase].values()), rtol=0, atol=3e-5)


def test_layers_are_those_asked_for_and_no_others(network):
    picture = images(1, (64, 80))
    features = network(picture, ["expand4", "rgb", "expand1"])
    assert [tuple(each.shape) for each in features] == [(1, 240, 8, 10), (1, 3, 64, 80), (1, 96, 32, 40)]
    with pytest.raises(ValueError, match="choose from rgb, expand1"):
        network(picture, ["relu1_1"])


def test_equalized_gray_is_histogram_equalization():
    pictures = images(3, (40, 56)) * torch.tensor([1.0, 0.3, 0.7]).view(3, 1, 1, 1)
    ours = equalized_gray(pictures)
    luma = (pictures * torch.tensor([0.299, 0.587, 0.114]).view(3, 1, 1)).sum(1)
    for index in range(3):
        levels = (luma[index] * 255).round().byte().numpy()
        expected = np.searchsorted(np.sort(levels.ravel()), levels, side="right") / levels.size
        np.testing.assert_allclose(ours[index, 0], expected, rtol=0, atol=1e-6)
        # skimage interpolates its cumulative histogram between the centres of 256 bins over the range of levels.
        np.testing.assert_allclose(
            ours[index, 0], equalize_hist(levels, nbins=int(np.ptp(levels)) + 1), rtol=0, atol=0.01
        )


def test_mean_std_match_the_reference():
    record = golden("anystyle_golden")["calc_mean_std"]
    mean, std = mean_std(hashed(1070, [2, 3, 4, 5], -1, 1))
    torch.testing.assert_close(mean, torch.tensor(record["mean"]).flatten(1))
    torch.testing.assert_close(std, torch.tensor(record["std"]).flatten(1))


def test_histogram_has_a_finite_gradient_even_where_images_agree():
    image = hashed(1080, [1, 3, 16, 16]).requires_grad_()
    other = rgb_uv_histogram(image.detach())
    hellinger(rgb_uv_histogram(image), other).sum().backward()
    assert torch.isfinite(image.grad).all()
    same = hellinger(other, other)
    torch.testing.assert_close(same, torch.zeros_like(same))


@pytest.fixture(scope="module")
def paintings():
    files = [real(f"styles/style_{index:02d}.jpg") for index in (0, 3, 7, 12)]
    return torch.stack([_square(read_image(file)) for file in files])


@pytest.mark.filterwarnings("ignore:style_retrieval_gray does not tell 1 of 4 styles")
def test_scenes_that_show_their_painting_are_found_and_others_not(network, paintings):
    """Stylized views are crops of the paintings: each its own, or each the next one's."""
    for shift, expected in ((0, 1.0), (1, 0.0)):
        metric = StyleRetrieval()
        crops = paintings.roll(shift, 0)[:, None, :, 20:148, 10:138].expand(-1, 2, -1, -1, -1)
        metric.update(Comparison(content=crops, stylized=crops, style=Style(image=paintings), scenes=("one",) * 4))
        found = metric.scores()
        for name in ("style_retrieval", "style_retrieval_gray"):
            assert float(found[name]) == float(found[f"{name}_csls"]) == expected
        assert found["style_retrieval_gap"] > 0


def test_each_style_is_found_or_not_among_all_that_are_to_be_told_apart(network, paintings):
    """Two styles show their own painting, or both show one of the gallery's that neither is."""
    found = {}
    for shown in ((0, 1), (2, 3)):
        crops = [paintings[index][None, None, :, 20:148, 10:138] for index in shown]
        metric = StyleRetrieval()
        metric.gallery = list(paintings)
        rows = (
            Comparison(content=crop, stylized=crop, style=Style(image=paintings[index][None]), scenes=("one",))
            for index, crop in enumerate(crops)
        )
        found[shown] = judge_scene({"retrieval": metric}, rows)["retrieval"]
    assert [scores.scores["style_retrieval"] for scores in found.values()] == [1.0, 0.0]
    assert [row["style_retrieval_gray"] for row in found[0, 1].styles.values()] == [1.0, 1.0]
    assert [row["style_retrieval"] for row in found[2, 3].styles.values()] == [0.0, 0.0]


def _square(image):
    return torch.nn.functional.interpolate(image[None], size=(168, 168), mode="bicubic", antialias=True)[0].clamp(0, 1)
