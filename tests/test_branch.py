"""What the style branch hands to injectors."""

import torch

from anystyle.branch import placed
from anystyle.types import Geometry, Tokens
from oracle import hashed
from style_cases import cameras, stylization


def test_places_follow_the_order_that_a_backbone_gives_its_views() -> None:
    images, depth = hashed(1, [1, 3, 3, 4, 6], 0, 1), 1 + hashed(2, [1, 3, 4, 6], 0, 1)
    given = cameras(1, 3, (4, 6))
    pose = given.world_from_camera.clone()
    pose[0, 1:, :3, 3] = hashed(3, [2, 3], 0, 1)
    geometry = Geometry(type(given)(pose, given.intrinsics, given.size), depth, depth)
    scene = stylization(images, images, geometry=geometry).scene
    tokens = Tokens(torch.zeros(1, 3, 2 + 6, 5), grid=(2, 3), special=2)
    places = placed(tokens, scene).places
    torch.testing.assert_close(places, geometry.places((2, 3)))
    turned = placed(Tokens(tokens.data, (2, 3), 2, order=torch.tensor([[2, 0, 1]])), scene).places
    assert turned is not None
    assert places is not None
    torch.testing.assert_close(turned, places[:, [2, 0, 1]])
