"""Points take their colour from one view."""

import torch

from anystyle.branch import single_view_colors
from anystyle.types import Cameras

HEIGHT, WIDTH, DEPTH = 8, 12, 2.0


def plane():
    """Three cameras side by side before a plane, the middle one at the origin, the others 2 and 3 pixels off."""
    poses = torch.eye(4).repeat(1, 3, 1, 1)
    poses[0, :, 0, 3] = torch.tensor([-2.0, 0.0, 3.0]) * DEPTH / WIDTH
    matrix = torch.tensor([[WIDTH, 0, WIDTH / 2], [0, WIDTH, HEIGHT / 2], [0, 0, 1]]).expand(1, 3, 3, 3)
    y, x = torch.meshgrid(torch.arange(HEIGHT) + 0.5, torch.arange(WIDTH) + 0.5, indexing="ij")
    rays = torch.stack([(x - WIDTH / 2) / WIDTH, (y - HEIGHT / 2) / WIDTH, torch.ones_like(x)], dim=-1)
    points = rays * DEPTH + poses[0, :, None, None, :3, 3]  # V H W 3
    color = torch.rand(1, 3, HEIGHT, WIDTH, 4, generator=torch.Generator().manual_seed(0))
    return color, points[None], Cameras(poses, matrix, (HEIGHT, WIDTH))


def test_the_view_at_the_origin_paints_what_it_sees_and_others_the_rest():
    color, points, cameras = plane()
    painted = single_view_colors(color, points, cameras)
    torch.testing.assert_close(painted[:, 1], color[:, 1], rtol=0, atol=1e-5)
    torch.testing.assert_close(painted[:, 0, :, 2:], color[:, 1, :, :-2], rtol=0, atol=1e-5)
    torch.testing.assert_close(painted[:, 2, :, :-3], color[:, 1, :, 3:], rtol=0, atol=1e-5)
    torch.testing.assert_close(painted[:, 0, :, :2], color[:, 0, :, :2], rtol=0, atol=1e-5)
    torch.testing.assert_close(painted[:, 2, :, -3:], color[:, 2, :, -3:], rtol=0, atol=1e-5)


def test_a_view_does_not_paint_through_what_stands_before_a_point():
    color, points, cameras = plane()
    points[:, 1] *= 0.5  # What the middle view shows is nearer: it does not see the plane.
    torch.testing.assert_close(single_view_colors(color, points, cameras)[:, 0], color[:, 0], rtol=0, atol=1e-5)


def test_the_order_of_views_does_not_matter_and_gradients_go_to_the_views_that_paint():
    color, points, cameras = plane()
    color.requires_grad_()
    order = [2, 0, 1]
    painted = single_view_colors(color, points, cameras)
    torch.testing.assert_close(
        single_view_colors(color[:, order], points[:, order], cameras.select(order)), painted[:, order]
    )
    painted.sum().backward()
    assert color.grad is not None and color.grad[0, 1].sum() > 2 * color[0, 1].numel()
    assert color.grad.isfinite().all()
