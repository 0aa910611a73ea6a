import torch
from scipy.spatial.transform import Rotation

from anystyle.types import Attributes, Cameras, Geometry, StyleEmbedding, Tokens, Views


def cameras(batch=2, views=3, size=(6, 8)):
    pose = torch.eye(4, dtype=torch.float64).repeat(batch, views, 1, 1)
    rotations = Rotation.random(batch * views, rng=0).as_matrix()
    pose[..., :3, :3] = torch.tensor(rotations).unflatten(0, (batch, views))
    pose[..., :3, 3] = torch.randn(batch, views, 3, dtype=torch.float64)
    lens = torch.tensor([[7.0, 0, 4.2], [0, 7.5, 2.9], [0, 0, 1]], dtype=torch.float64)
    return Cameras(pose.float(), lens.float().expand(batch, views, 3, 3), size)


def test_the_inverse_pose_is_the_inverse_matrix_under_autocast_too():
    given = cameras()
    expected = torch.linalg.inv(given.world_from_camera)
    torch.testing.assert_close(given.camera_from_world, expected, rtol=1e-5, atol=1e-5)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        torch.testing.assert_close(given.camera_from_world, expected, rtol=1e-5, atol=1e-5)


def test_places_of_the_first_view_are_its_own_pixels_and_a_point_has_one_place_in_all_views():
    given = cameras()
    depth = torch.rand(2, 3, 6, 8) + 0.5
    geometry = Geometry(given, depth, depth)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        places = geometry.places((6, 8))
    x, y = (torch.arange(8) + 0.5) / 4 - 1, (torch.arange(6) + 0.5) / 3 - 1
    own = torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1).flatten(0, 1).expand(2, -1, -1)
    torch.testing.assert_close(places[:, 0], own, rtol=1e-4, atol=1e-4)
    # Points of the other views in the first camera's axes, by its matrix and its lens.
    points = geometry.points().flatten(2, 3).double()
    seen = points @ given.camera_from_world[:, :1, :3, :3].double().mT + given.camera_from_world[:, :1, None, :3, 3]
    image = seen @ given.intrinsics[:, :1].double().mT / seen[..., 2:].abs()
    front = seen[..., 2] > 0.1
    expected = image[..., :2] / torch.tensor([4.0, 3.0]) - 1
    assert front[:, 1:].any()
    torch.testing.assert_close(places[front].double(), expected[front], rtol=1e-3, atol=1e-3)
    coarse = geometry.places((2, 4)).unflatten(2, (2, 4))
    whole = places.unflatten(2, (6, 8))
    torch.testing.assert_close(coarse[:, :, 1, 2], whole[:, :, 3:, 4:6].mean((2, 3)), rtol=1e-4, atol=1e-4)


def test_points_project_back_to_their_pixels():
    given = cameras()
    depth = torch.rand(2, 3, 6, 8) + 0.5
    with torch.autocast("cpu", dtype=torch.bfloat16):
        points = Geometry(given, depth, depth).points(pixel_center=0.5)
    local = torch.einsum("bvij,bvhwj->bvhwi", given.camera_from_world[..., :3, :3], points)
    local = local + given.camera_from_world[..., None, None, :3, 3]
    torch.testing.assert_close(local[..., 2], depth, rtol=1e-5, atol=1e-5)
    pixel = torch.einsum("bvij,bvhwj->bvhwi", given.intrinsics, local)
    x = torch.arange(8) + 0.5
    y = torch.arange(6)[:, None] + 0.5
    torch.testing.assert_close(pixel[..., 0] / pixel[..., 2], x.expand(2, 3, 6, 8), rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(pixel[..., 1] / pixel[..., 2], y.expand(2, 3, 6, 8), rtol=1e-4, atol=1e-4)


def test_stretched_images_keep_their_rays():
    given = cameras()
    wide = given.resized((12, 24))
    for row in range(2):
        ratio = wide.intrinsics[0, 0, row] / given.intrinsics[0, 0, row]
        torch.testing.assert_close(ratio[row], ratio[2])
    assert wide.size == (12, 24)


def test_values_are_pytrees_that_can_be_seen_as_batches():
    views = Views(torch.rand(1, 3, 3, 6, 8), cameras(batch=1), names=("a", "b", "c"))
    many = views.expand(4)
    assert many.images.shape[0] == 4 and many.cameras is not None and many.cameras.intrinsics.shape[0] == 4
    assert many.images.data_ptr() == views.images.data_ptr() and many.names == views.names
    assert views.to(torch.float64).images.dtype == torch.float64
    assert views.select([2, 0]).names == ("c", "a")


def test_unstyled_attributes_are_the_same_tensors():
    def attributes():
        return Attributes(*(torch.rand(1, 2, 4, 4, *shape) for shape in ((), (3,), (4,), (3, 9))))

    base, styled = attributes(), attributes()
    mixed = base.with_(styled, ("color", "rotation"))
    assert mixed.color is styled.color and mixed.rotation is styled.rotation
    assert mixed.opacity is base.opacity and mixed.scale is base.scale
    assert base.with_degree(1).color.shape[-1] == 4


def test_the_ends_of_a_way_between_styles_are_the_styles():
    first, second = (StyleEmbedding(torch.randn(2, 8), torch.randn(2, 8)) for _ in range(2))
    assert torch.equal(first.toward(second, 0.0).vector, first.vector)
    assert torch.equal(first.toward(second, 1.0).direction, second.direction)
    middle = first.toward(second, torch.tensor([0.5, 0.25]))
    torch.testing.assert_close(middle.vector[1], 0.75 * first.vector[1] + 0.25 * second.vector[1])


def test_patches_change_and_special_tokens_stay():
    tokens = Tokens(torch.rand(1, 2, 7, 5), grid=(2, 2), special=3)
    changed = tokens.with_patches(tokens.patches + 1)
    assert torch.equal(changed.data[:, :, :3], tokens.data[:, :, :3])
    assert torch.equal(changed.patches, tokens.patches + 1)
