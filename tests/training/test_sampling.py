"""What a step looks at: the published tables, and that it is a function of the step."""

from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from anystyle.contracts import SceneSource, StyleSource
from anystyle.data.images import read_image, to_tensor
from anystyle.examples import resolved
from anystyle.testing.oracle import hashed
from anystyle.training.collate import fit_views, mirror_views, stack_styles, stack_views
from anystyle.training.data import SceneBatches
from anystyle.training.sampling import bounded_views, gap_bounds, generator
from anystyle.types import Cameras, Style, Views
from anystyle_tiny.training.supervision import project
from tests.support.oracle import golden

SAMPLER = golden("anystyle_golden")["sampler"]
COUNTS = range(2, 19)


class Frames(SceneSource):
    """Scenes whose images say which scene and view they are."""

    def __init__(self, views: int = 300) -> None:
        self.views = views

    def __len__(self) -> int:
        return 5

    def name(self, scene: int) -> str:
        return str(scene)

    def num_views(self, scene: int) -> int:
        return self.views

    def read(self, scene, views) -> Views:
        values = torch.tensor([[scene / 10, view / 1000, 0.0] for view in views])
        return Views(images=values[None, :, :, None, None].expand(-1, -1, -1, 28, 42).contiguous())


class Named(StyleSource):
    def __len__(self) -> int:
        return 7

    def read(self, style: int) -> Style:
        return Style(text=(f"style {style}",))


def test_the_numbers_of_views_are_drawn_with_the_published_chances():
    source = SceneBatches(Frames(), context_views=(2, 18), view_power=2.0)
    np.testing.assert_allclose(source.probabilities, [SAMPLER["prob"][str(count)] for count in COUNTS], rtol=1e-12)


@pytest.mark.parametrize("count", COUNTS)
def test_batches_and_windows_are_the_published_ones(count):
    assert SceneBatches(Frames(), context_views=(count, count)).shape(0) == (SAMPLER["batch"][str(count)], count)
    assert list(gap_bounds(count, 1000)) == SAMPLER["gap"][str(count)]


@pytest.mark.parametrize("count", [2, 5, 18])
def test_bounded_views_lie_in_their_window(count):
    low, high = gap_bounds(count, 300)
    for seed in range(50):
        views = bounded_views(generator(seed), 300, count, 2)
        left, *between, right = views[:count]
        assert low <= right - left <= high and len(set(between)) == count - 2
        assert all(left < view < right for view in between) and all(left <= view <= right for view in views[count:])


def test_a_capture_that_is_too_short_says_what_to_change():
    with pytest.raises(ValueError, match=r"too short for 18 views.*context_views"):
        gap_bounds(18, 20)


def test_a_batch_depends_on_seed_and_step_alone():
    first, second = (SceneBatches(Frames(), Named(), seed=3) for _ in range(2))
    for step in (7, 0, 7, 12345):
        one, other = first.batch(step), second.batch(step)
        assert torch.equal(one.views.images, other.views.images)
        assert one.keys == other.keys and one.style.text == other.style.text
    assert not torch.equal(
        first.batch(7).views.images[:1], SceneBatches(Frames(), Named(), seed=4).batch(7).views.images[:1]
    )


def test_processes_share_a_batch_and_nothing_is_lost():
    source = SceneBatches(Frames(), Named(), seed=1, batch_size=6, context_views=(3, 3))
    joined = torch.stack([source.batch(5, rank, 3).views.images for rank in range(3)], dim=1).flatten(0, 1)
    assert torch.equal(joined, source.batch(5).views.images)
    with pytest.raises(ValueError, match="6 scenes a step cannot be shared by 4"):
        source.batch(5, 0, 4)


@pytest.mark.parametrize("count", [2, 5, 7, 18])
def test_several_processes_have_the_published_batch_each(count):
    """36 images a process: as many scenes in each as the published tables say, and none of them twice."""
    source = SceneBatches(Frames(), Named(), seed=1, images=8 * 36, context_views=(count, count))
    shares = [source.batch(3, rank, 8) for rank in range(8)]
    assert [len(share.keys) for share in shares] == 8 * [SAMPLER["batch"][str(count)]]
    assert len({key for share in shares for key in share.keys}) == 8 * SAMPLER["batch"][str(count)]
    # Fewer images than processes have views: a scene each.
    few = SceneBatches(Frames(), seed=1, images=36, context_views=(count, count))
    assert all(len(few.batch(0, rank, 30).keys) == 1 for rank in (0, 29))


def test_equal_keys_mean_equal_views_and_a_pool_has_so_many():
    source = SceneBatches(Frames(), seed=0, batch_size=4, context_views=(2, 3), pool=5)
    seen: dict[int, torch.Tensor] = {}
    for step in range(40):
        batch = source.batch(step)
        for key, images in zip(batch.keys, batch.views.images, strict=True):
            assert torch.equal(seen.setdefault(key, images), images)
    assert 5 <= len(seen) <= 10


def test_heights_are_multiples_of_the_patch_in_the_published_range():
    source = SceneBatches(Frames(), seed=0, heights=(224, 448), width=448, multiple=14)
    sizes = {source._size(step, (28, 42)) for step in range(300)}
    assert {height for height, _ in sizes} == set(range(224, 449, 14)) and {width for _, width in sizes} == {448}


def scene(height: int = 60, width: int = 80) -> Views:
    pose = torch.eye(4).repeat(1, 2, 1, 1)
    pose[0, 1, 0, 3] = 0.3
    intrinsics = torch.tensor([[70.0, 0, 38], [0, 65, 33], [0, 0, 1]]).expand(1, 2, 3, 3).clone()
    return Views(
        images=hashed(1, (1, 2, 3, height, width)),
        cameras=Cameras(pose, intrinsics, (height, width)),
        depth=1 + hashed(2, (1, 2, height, width)),
    )


def test_resized_views_see_points_where_the_resized_picture_shows_them():
    views = scene()
    fitted = fit_views(views, (30, 30))
    point = torch.tensor([[[0.1, -0.05, 2.0]]])
    before, after = project(views.cameras, point)[0], project(fitted.cameras, point)[0]
    # Half the size, then five columns cut off each side of 40.
    torch.testing.assert_close(after, before / 2 - torch.tensor([5.0, 0.0]))
    assert fitted.depth.shape == (1, 2, 30, 30)
    torch.testing.assert_close(fit_views(views, (60, 60)).images, views.images[..., 10:70])


def test_resized_photographs_are_about_as_sharp_as_by_lanczos():
    photograph = min(resolved(Path("example:street")).glob("*.jpg"))
    with Image.open(photograph) as picture:
        lanczos = to_tensor(picture.resize((448, 336), Image.Resampling.LANCZOS))
    fitted = fit_views(Views(images=read_image(photograph)[None, None]), (336, 448)).images[0, 0]
    assert 0.85 < fitted.diff(dim=-1).abs().mean() / lanczos.diff(dim=-1).abs().mean() < 1.05


def test_the_mirrored_scene_shows_mirrored_points_at_mirrored_pixels():
    views = scene()
    mirrored = mirror_views(views)
    point = torch.tensor([[[0.1, -0.05, 2.0]]])
    before = project(views.cameras, point)[0]
    after = project(mirrored.cameras, point * torch.tensor([-1.0, 1.0, 1.0]))[0]
    torch.testing.assert_close(after[..., 0], 80 - before[..., 0])
    torch.testing.assert_close(after[..., 1], before[..., 1])
    again = mirror_views(mirrored)
    assert torch.equal(again.images, views.images) and torch.equal(again.depth, views.depth)


def test_stacking_says_what_does_not_fit():
    with pytest.raises(ValueError, match=r"\(60, 80\).*heights"):
        stack_views([scene(), scene(70)])
    both = stack_styles([Style(text=("a",)), Style(image=hashed(1, (1, 3, 8, 8)))])
    assert both.text == ("a", "") and both.has_image.tolist() == [False, True]
