"""What a correspondence promises: see :class:`anystyle.contracts.Correspondence`."""

import torch
import torch.nn.functional as F
from torch import Tensor

from anystyle.contracts import Correspondence
from anystyle.testing import asserts
from anystyle.testing.inputs import generator
from anystyle.testing.subject import Subject
from anystyle.types import Flow, Frames
from anystyle.types.shapes import check_value

SIZE = (96, 128)
FOCAL, DEPTH = 100.0, 4.0


def test_flow_has_the_shape_of_the_frames(plugin: Subject[Correspondence]) -> None:
    """It gives one displacement and one visibility per pixel, for any number of pairs and any size."""
    for number, size in ((1, SIZE), (2, (128, 96))):
        flow = plugin.instance(_wall(number, size), _wall(number, size, shift=4))
        check_value(flow, Flow, "the correspondence", M=number, H=size[0], W=size[1])
        asserts.finite(flow, "the flow")


def test_moved_cameras_are_followed(plugin: Subject[Correspondence]) -> None:
    """A wall moves against the camera by as many pixels, x first; what left the frame is not visible."""
    for shift, drop in ((0, 0), (6, 0), (0, 5)):
        flow = plugin.instance(_wall(1, SIZE), _wall(1, SIZE, shift=shift, drop=drop))
        visible = flow.visible[0, 16:-16, 16:-16]
        share = float(visible.float().mean())
        assert share > 0.5, f"{100 * share:.0f} % of a wall visible after a move by {(shift, drop)} pixels"
        moved = flow.displacement[0, :, 16:-16, 16:-16][:, visible].median(dim=1).values
        expected = torch.tensor([-float(shift), -float(drop)])
        assert float((moved - expected).abs().max()) < 1, f"displaced (x, y) by {moved.tolist()}, not {expected}"
    flow = plugin.instance(_wall(1, SIZE), _wall(1, SIZE, shift=24))
    visible = float(flow.visible[0, 16:-16, :12].float().mean())
    assert visible < 0.2, f"{100 * visible:.0f} % of the left margin visible after the wall moved left by 24 pixels"


def test_pairs_are_independent(plugin: Subject[Correspondence]) -> None:
    """A batch of pairs gives what each pair gives alone, and the same again; frames are left as they were."""
    source, target = _wall(2, SIZE), _wall(2, SIZE, shift=4)
    before = source.map(Tensor.clone)
    together = plugin.instance(source, target)
    for index in range(2):
        alone = plugin.instance(source.row(index), target.row(index))
        asserts.close(together.row(index), alone, f"pair {index} of a batch against the same pair alone")
    asserts.same(plugin.instance(source, target), together, "the same pairs again")
    asserts.same(source, before, "the source frames")
    displacement = plugin.instance.displacement(source, target)
    asserts.close(displacement, together.displacement, "`displacement` against that of the flow")


def _wall(number: int, size: tuple[int, int], *, shift: int = 0, drop: int = 0) -> Frames:
    """A textured wall, and cameras that face it, moved right by ``shift`` and down by ``drop`` pixels of the wall."""
    height, width = size
    coarse = torch.rand(number, 3, height // 4 + 16, width // 4 + 16, generator=generator(11))
    texture = F.interpolate(coarse, scale_factor=4, mode="bicubic", align_corners=False).clamp(0, 1)
    images = texture[:, :, 8 + drop : 8 + drop + height, 8 + shift : 8 + shift + width]
    pose = torch.eye(4).repeat(number, 1, 1)
    pose[:, 0, 3], pose[:, 1, 3] = shift * DEPTH / FOCAL, drop * DEPTH / FOCAL
    intrinsics = torch.tensor([[FOCAL, 0.0, width / 2], [0.0, FOCAL, height / 2], [0.0, 0.0, 1.0]])
    depth = torch.full((number, height, width), DEPTH)
    return Frames(images.contiguous(), depth, pose, intrinsics.repeat(number, 1, 1))
