"""EfficientNet-Lite0 and what styles are told apart by."""

import numpy as np
import pytest
import torch
from skimage.exposure import equalize_hist

from anystyle.data.images import read_image
from anystyle.metrics.style_retrieval import StyleRetrieval
from anystyle.perception import efficientnet, weights
from anystyle.perception.statistics import centered_cosines, equalized_gray
from anystyle.testing.inputs import images
from anystyle.types import Comparison, Style
from magenta_oracle import picture
from real_data import real


@pytest.fixture(scope="module")
def network():
    try:
        return efficientnet.load()
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
    logits = network.logits(torch.from_numpy(picture(224, phase))[None])[0]
    classes = list(PUBLISHED[phase])
    assert logits.argmax() == classes[0]
    np.testing.assert_allclose(logits[classes], list(PUBLISHED[phase].values()), rtol=0, atol=3e-5)


@torch.no_grad()
@pytest.mark.parametrize(("photo", "label"), [(1, 831), (3, 752), (5, 603)])  # studio couch, racket, horse cart
def test_the_classifier_knows_photographs(network, photo, label):
    image = read_image(real(f"photos/photo_{photo:02d}.jpg"))[None]
    small = torch.nn.functional.interpolate(image, size=(224, 224), mode="bicubic", antialias=True).clamp(0, 1)
    assert network.logits(small).argmax() == label


def test_another_file_is_refused(tmp_path):
    file = tmp_path / "efficientnet-lite0-57934424.pth"
    torch.save(efficientnet.EfficientNetLite0().state_dict(), file)
    with pytest.raises(ValueError, match=r"is not the published file, by its SHA-256"):
        efficientnet.load(file)


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


def test_equalized_gray_forgets_palette_and_exposure():
    picture = images(1, (64, 64))
    changed = 0.1 + 0.5 * picture
    torch.testing.assert_close(equalized_gray(changed), equalized_gray(picture), rtol=0, atol=0.04)
    tinted = picture.mean(1, keepdim=True) * torch.tensor([0.9, 0.5, 0.3]).view(3, 1, 1)
    torch.testing.assert_close(
        equalized_gray(tinted), equalized_gray(picture.mean(1, keepdim=True).expand(-1, 3, -1, -1)), rtol=0, atol=0.04
    )


def test_what_all_share_does_not_matter():
    source = torch.Generator().manual_seed(0)
    styles = torch.randn(5, 16, generator=source)
    order = torch.tensor([3, 0, 4, 1, 2])
    queries = 0.3 * styles[order] + 100 * torch.randn(1, 16, generator=source)
    cosines = centered_cosines(queries, styles - 7)
    assert torch.equal(cosines.argmax(1), order)
    torch.testing.assert_close(cosines[torch.arange(5), order], torch.ones(5), rtol=0, atol=1e-4)


@pytest.fixture(scope="module")
def paintings():
    files = [real(f"styles/style_{index:02d}.jpg") for index in (0, 3, 7, 12)]
    return torch.stack([_square(read_image(file)) for file in files])


def test_scenes_that_show_their_painting_are_found_and_others_not(network, paintings):
    """Stylized views are crops of the paintings: each its own, or each the next one's."""
    for shift, expected in ((0, 1.0), (1, 0.0)):
        metric = StyleRetrieval()
        crops = paintings.roll(shift, 0)[:, None, :, 20:148, 10:138].expand(-1, 2, -1, -1, -1)
        style = Style(image=paintings)
        metric.update(Comparison(content=crops, stylized=crops, style=style, scenes=("one",) * 4))
        assert {name: float(value) for name, value in metric.compute().items()} == {
            "style_retrieval": expected,
            "style_retrieval_gray": expected,
        }


def test_a_palette_alone_counts_in_color_only(network, paintings):
    """Flat views with the painting's mean colour: found in colour; in equalised grey nothing is left of them."""
    metric = StyleRetrieval()
    noise = images(1, (128, 128))[0].mean(0) - 0.5
    flat = paintings.mean((2, 3), keepdim=True) + 0.05 * noise
    metric.update(Comparison(content=flat[:, None], stylized=flat[:, None], style=Style(image=paintings)))
    figures = metric.compute()
    assert figures["style_retrieval"] > figures["style_retrieval_gray"]
    assert metric.weights == {"efficientnet-lite0-57934424.pth": weights.row("efficientnet_lite0").sha256}


def _square(image):
    return torch.nn.functional.interpolate(image[None], size=(168, 168), mode="bicubic", antialias=True)[0].clamp(0, 1)
