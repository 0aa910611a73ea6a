"""Photographs that stand twice in a capture: the same file, encoded again, of another size or exposure, or a burst."""

import io
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from anystyle.data.images import open_image, to_tensor
from anystyle.examples import resolved
from anystyle_captures.twins import groups, held_out, to_try
from tests.support.known_scene import photographed_wall, rig

SIZE = (192, 144)


def encoded(picture, quality=60, scale=1.0):
    file = io.BytesIO()
    picture.resize((round(scale * SIZE[0]), round(scale * SIZE[1]))).save(file, "JPEG", quality=quality)
    return Image.open(file).convert("RGB").resize(SIZE)


COPIES = {
    "exact": lambda picture: picture,
    "encoded again": encoded,
    "half the size": lambda picture: encoded(picture, scale=0.5),
    "darker": lambda picture: picture.point(lambda level: round(0.6 * level)),
    "a burst": lambda picture: picture.transform(SIZE, Image.Transform.AFFINE, (1, 0, 0.7, 0, 1, -0.4), Image.BILINEAR),
}


@pytest.mark.parametrize("copy", COPIES.values(), ids=COPIES)
def test_a_copy_is_on_the_side_of_its_twin(copy, caplog):
    """Photograph 10 is a copy of photograph 3 and would be held out while that is fitted to."""
    photographs = [
        open_image(path, longest=512).resize(SIZE)
        for path in sorted(resolved(Path("example:street")).glob("*.jpg"))[:9]
    ]
    cameras = rig(10).select([*range(9), 3])
    names = [*(f"view{number}" for number in range(9)), "view4_copy"]
    images = torch.stack([to_tensor(picture) for picture in [*photographs, copy(photographs[3])]])
    found = groups(images, cameras, names)
    assert [3, 9] in found and len(found) == 9 and "view3 = view4_copy" in caplog.text
    for every in (2, 3, 4, 9):
        assert len({3, 9} & set(held_out(found, every))) in (0, 2)


def test_pictures_that_are_alike_from_different_places_are_no_twins():
    """A vase on a turntable looks the same from everywhere."""
    images = photographed_wall(num_views=1)[0].expand(7, -1, -1, -1)
    assert groups(images, rig(7)) == [[view] for view in range(7)]


@pytest.mark.parametrize(("number", "every", "expected"), [(24, 8, (4, 12, 20)), (8, 8, (4,)), (7, 8, ()), (24, 0, ())])
def test_every_so_many_th_view_is_held_out(number, every, expected):
    assert held_out([[view] for view in range(number)], every) == expected


def test_a_trial_leaves_every_second_of_the_others_out_and_twins_together():
    assert to_try([[0], [1, 5], [2], [3], [4]], (2,), rig(6)) == (1, 4, 5)


def test_the_same_photographs_are_held_out_in_any_order():
    names = [f"view{number}" for number in range(12)]
    images, cameras, _ = photographed_wall(num_views=12)
    order = np.random.default_rng(0).permutation(12).tolist()
    exchanged = [names[view] for view in order]
    found = groups(images, cameras, names)
    assert held_out(found, 8) == (4,) and held_out(found, 4) == (2, 6, 10)
    again = groups(images[order], cameras.select(order), exchanged)
    assert {exchanged[view] for view in held_out(again, 4)} == {"view2", "view6", "view10"}
