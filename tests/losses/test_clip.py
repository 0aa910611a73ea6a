"""CLIP losses against the published ones, and against literal transcriptions in a space computed by hand."""

from collections.abc import Sequence

import cv2
import numpy as np
import pytest
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.contracts import StyleEncoder
from anystyle.losses.clip_directional import ClipDirectional
from anystyle.losses.clip_patch import ClipPatch, random_corners, warp_to_corners
from anystyle.testing.oracle import assert_matches, fill_named, hashed, smooth_image
from anystyle.types import Stylization
from anystyle_backbones.long_clip import LongClip
from tests.support.oracle import golden
from tests.support.style_cases import stylization


class Projection(StyleEncoder):
    """A linear map of 8 x 8 pixels."""

    def __init__(self) -> None:
        super().__init__()
        self.dim = 16
        self.neutral = "a photo"
        self.register_buffer("matrix", hashed(31, [16, 192], -1, 1))
        self.learnt = nn.Parameter(torch.zeros(()))

    def embed_images(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M D"]:
        return F.normalize(F.interpolate(images, size=(8, 8), mode="area").flatten(1) @ self.matrix.T, dim=-1)

    def embed_texts(self, texts: Sequence[str]) -> Float[Tensor, "M D"]:
        raise NotImplementedError


RENDERED, PHOTOGRAPHS = smooth_image(4611, [2, 2, 3, 98, 126]), smooth_image(4613, [2, 2, 3, 98, 126])
DIRECTION = F.normalize(hashed(4615, [2, 16], -1, 1), dim=-1)


RECORD = golden("golden_metrics")["clip"]


@pytest.fixture(scope="module")
def published() -> LongClip:
    """ViT-B/32 as the goldens fill it; its text tower, which no loss reads, is of one thin layer."""
    with torch.device("meta"):
        encoder = LongClip(text_layers=1, text_width=64, vocabulary_size=600)
        shapes = {f"visual.{name}": tensor for name, tensor in encoder.network.visual.state_dict().items()}
    filled = fill_named(shapes, RECORD["clip_rules"])
    state = {name.removeprefix("visual."): tensor for name, tensor in filled.items()}
    encoder.network.visual.load_state_dict(state, assign=True)
    return encoder.eval().requires_grad_(False)


def at_the_goldens_inputs() -> tuple[Tensor, Stylization]:
    rendered = RENDERED.clone().requires_grad_()
    direction = F.normalize(hashed(4615, [2, 512], -1, 1), dim=-1)
    return rendered, stylization(rendered, PHOTOGRAPHS, direction=direction)


def test_directional_matches_the_reference(published: LongClip) -> None:
    expected = RECORD["global_only"]
    loss = ClipDirectional(style_encoder=published)
    rendered, result = at_the_goldens_inputs()
    value = loss.weight * loss(result)
    assert value.item() == pytest.approx(expected["loss"], rel=1e-5)
    value.backward()
    assert_matches(rendered.grad, expected["grad_pred"], rtol=2e-3, atol=2e-8)


def test_patches_match_the_reference(published: LongClip, monkeypatch: pytest.MonkeyPatch) -> None:
    """The goldens' loss is 2 * (global + 2 * patch), at one crop and one perspective for all copies."""
    crop = RECORD["crop"]
    places = iter([torch.tensor([crop["top"]]), torch.tensor([crop["left"]])])
    monkeypatch.setattr("anystyle.losses.clip_patch.torch.randint", lambda *args, **named: next(places))
    corners = torch.tensor(crop["perspective_endpoints"], dtype=torch.float32)
    monkeypatch.setattr("anystyle.losses.clip_patch.random_corners", lambda *args: corners[None])
    whole, patch = ClipDirectional(style_encoder=published), ClipPatch(style_encoder=published, shared_crop=True)
    rendered, result = at_the_goldens_inputs()
    value = whole.weight * whole(result) + patch.weight * patch(result)
    assert value.item() == pytest.approx(RECORD["patch_perspective"]["loss"], rel=1e-4)
    value.backward()
    assert_matches(rendered.grad, RECORD["patch_perspective"]["grad_pred"], rtol=2e-2, atol=2e-6)


def test_directional_is_its_equation() -> None:
    encoder = Projection()
    total = torch.zeros(())
    for scene in range(2):
        for view in range(2):
            after, before = (
                encoder.embed_images(
                    F.interpolate(images[scene, view][None], size=(224, 224), mode="bicubic", align_corners=False)
                )[0]
                for images in (RENDERED, PHOTOGRAPHS)
            )
            change = (after - before) / (after - before).norm()
            total = total + (1 - change @ DIRECTION[scene]) / 4
    result = stylization(RENDERED, PHOTOGRAPHS, direction=DIRECTION)
    torch.testing.assert_close(ClipDirectional(style_encoder=encoder)(result), total)


def test_an_unchanged_view_has_a_bounded_gradient() -> None:
    rendered = PHOTOGRAPHS.clone().requires_grad_()
    loss = ClipDirectional(style_encoder=Projection())(stylization(rendered, PHOTOGRAPHS, direction=DIRECTION))
    assert loss.item() == pytest.approx(1)
    loss.backward()
    assert rendered.grad.norm() < 1e4


def test_warp_is_the_published_perspective() -> None:
    """Against OpenCV, at the pixels that lie well inside; its plane has pixel centres at integers."""
    crop = golden("golden_metrics")["clip"]["crop"]
    corners = torch.tensor(crop["perspective_endpoints"], dtype=torch.float32)
    image = RENDERED[0, 0, :, crop["top"] : crop["top"] + 64, crop["left"] : crop["left"] + 64]
    found = warp_to_corners(image[None], corners[None])[0]
    start = np.array(crop["perspective_startpoints"], np.float32) - 0.5
    motion = cv2.getPerspectiveTransform(start, corners.numpy() - 0.5)
    options = {"flags": cv2.INTER_LINEAR, "borderMode": cv2.BORDER_CONSTANT}
    expected = cv2.warpPerspective(image.permute(1, 2, 0).numpy(), motion, (64, 64), **options)
    covered = cv2.warpPerspective(np.ones((64, 64), np.float32), motion, (64, 64), **options)
    # OpenCV interpolates in steps of 1/32 pixel.
    assert np.abs(found.permute(1, 2, 0).numpy() - expected)[covered == 1].max() < 0.02
    assert np.abs(found.permute(1, 2, 0).numpy())[covered == 0].max() < 1e-3


def test_corners_move_inwards_by_at_most_the_distortion() -> None:
    corners = random_corners(2000, 64, 0.5, torch.Generator().manual_seed(0))
    own = torch.tensor([[0.0, 0], [63, 0], [63, 63], [0, 63]])
    inwards = (corners - own) * torch.tensor([[1.0, 1], [-1, 1], [-1, -1], [1, -1]])
    assert inwards.min() == 0 and inwards.max() == 16
    # Uniform over the 17 whole numbers: standard error of the mean 0.11 at 2000 draws.
    torch.testing.assert_close(inwards.mean(0), torch.full((4, 2), 8.0), atol=0.5, rtol=0)


def test_patch_is_its_equation() -> None:
    """CLIPstyler's equation 5 crop by crop: the crops themselves are drawn as the loss says it draws them."""
    encoder, crops = Projection(), 3
    torch.manual_seed(5)
    loss = ClipPatch(style_encoder=encoder, crops=crops, batch=5)
    found = loss(stylization(RENDERED, PHOTOGRAPHS, direction=DIRECTION))
    torch.manual_seed(5)
    count = 2 * 2 * crops
    top, left = torch.randint(98 - 64 + 1, (count,)), torch.randint(126 - 64 + 1, (count,))
    corners = random_corners(count, 64, 0.5)
    total, place = torch.zeros(()), 0
    for scene in range(2):
        for view in range(2):
            photograph = PHOTOGRAPHS[scene, view][None]
            before = encoder.embed_images(F.interpolate(photograph, size=(224, 224), mode="bicubic"))[0]
            for _ in range(crops):
                rows, columns = (slice(start[place], start[place] + 64) for start in (top, left))
                seen = warp_to_corners(RENDERED[scene, view, :, rows, columns][None], corners[place][None])
                after = encoder.embed_images(F.interpolate(seen, size=(224, 224), mode="bilinear"))[0]
                change = (after - before) / (after - before).norm()
                total = total + (1 - change @ DIRECTION[scene]) / count
                place += 1
    torch.testing.assert_close(found, total)


def test_crops_are_independent_unless_shared() -> None:
    encoder = Projection().requires_grad_(False)
    # One view four times: what differs between them is the crops alone.
    rendered, photographs = RENDERED[:1, :1].expand(1, 4, -1, -1, -1), PHOTOGRAPHS[:1, :1].expand(1, 4, -1, -1, -1)
    seen: list[Tensor] = []

    def listen(images: Tensor) -> Tensor:
        seen.append(images)
        return Projection.embed_images(encoder, images)

    encoder.embed_images = listen
    result = stylization(rendered, photographs, direction=DIRECTION[:1])
    ClipPatch(style_encoder=encoder, crops=5, size=None)(result)
    patches = torch.cat(seen[1:])
    assert patches.shape == (20, 3, 64, 64) and len({patch.numpy().tobytes() for patch in patches}) == 20
    seen.clear()
    ClipPatch(style_encoder=encoder, shared_crop=True, size=None)(result)  # photographs are known from before
    assert len({patch.numpy().tobytes() for patch in torch.cat(seen)}) == 1


def test_crops_follow_the_global_generator_in_training_and_nothing_out_of_it() -> None:
    result = stylization(RENDERED, PHOTOGRAPHS, direction=DIRECTION)
    loss = ClipPatch(style_encoder=Projection(), crops=2)

    def values(seed: int) -> list[float]:
        torch.manual_seed(seed)
        return [loss(result).item() for _ in range(2)]

    first = values(1)
    assert first[0] != first[1] and values(1) == first and values(2) != first
    loss.eval()
    assert len({*values(1), *values(2)}) == 1


def test_crops_of_small_views_are_as_large_as_fits() -> None:
    small = stylization(RENDERED[:, :, :, :40, :90], RENDERED[:, :, :, :40, :90], direction=DIRECTION)
    clipped, exact = (ClipPatch(style_encoder=Projection(), crop_size=side).eval()(small) for side in (64, 40))
    assert torch.equal(clipped, exact)
