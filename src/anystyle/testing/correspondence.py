"""What a correspondence promises: see :class:`anystyle.contracts.Correspondence`."""

from dataclasses import replace

import torch
import torch.nn.functional as F
from torch import Tensor

from anystyle.contracts import Correspondence
from anystyle.testing.check import Check, attempt, expect, refusal
from anystyle.testing.comparing import conform, expect_close, expect_finite, expect_same
from anystyle.testing.inputs import generator
from anystyle.testing.subject import Subject
from anystyle.types import Flow, Frames

Plugin = Subject[Correspondence]

SIZE = (96, 128)
FOCAL, DEPTH = 100.0, 4.0


def flow_has_the_frames_shape(plugin: Plugin) -> None:
    """It gives one displacement and one visibility a pixel, for any number of pairs and any size."""
    for number, size in ((1, SIZE), (2, (128, 96))):
        wall = _wall(number, size)
        what = f"{number} pair(s) of frames of {size[0]}x{size[1]} pixels"
        with attempt(f"the flow between {what}", change="make it work for any number of pairs and pixels"):
            flow = plugin.instance(wall, _wall(number, size, shift=4))
        conform(flow, Flow, f"the flow between {what}", M=number, H=size[0], W=size[1])
        expect_finite(flow, f"the flow between {what}")


def nothing_moved_is_no_flow(plugin: Plugin) -> None:
    """Between a frame and itself the flow is 0, and nearly everything is visible."""
    wall = _wall(1, SIZE)
    flow = plugin.instance(wall, wall)
    fraction = float(flow.visible.float().mean())
    expect(
        fraction > 0.8,
        given=f"{100 * fraction:.0f} % of the pixels of a frame visible in itself",
        change="allow for rounding where depths or flows are compared",
    )
    largest = float(flow.displacement.abs().amax(1)[flow.visible].max())
    expect(
        largest < 0.5,
        given=f"displacements of up to {largest:.2f} pixels between a frame and itself",
        change="subtract the source pixel, in the same convention of pixel centres",
    )


def moved_cameras_are_followed(plugin: Plugin) -> None:
    """A wall seen by a camera that moved right moves left by as many pixels; x comes first; up and down likewise."""
    source = _wall(1, SIZE)
    for shift, drop in ((6, 0), (0, 5)):
        flow = plugin.instance(source, _wall(1, SIZE, shift=shift, drop=drop))
        inside = flow.visible[0, 16:-16, 16:-16]
        fraction = float(inside.float().mean())
        expect(
            fraction > 0.5,
            given=f"{100 * fraction:.0f} % of a wall visible after a move of {shift or drop} pixels",
            expected="most of it",
            change="call a pixel hidden only where another is in front of it, or where it leaves the frame",
        )
        displacement = flow.displacement[0, :, 16:-16, 16:-16][:, inside].median(dim=1).values
        gap = float((displacement - torch.tensor([-float(shift), -float(drop)])).abs().max())
        expect(
            gap < 1,
            given=f"a displacement (x, y) of ({float(displacement[0]):.1f}, {float(displacement[1]):.1f}) pixels",
            expected=f"({-shift}, {-drop})",
            change="return where the source's pixels are in the target, minus where they are in the source",
        )


def what_left_the_frame_is_not_visible(plugin: Plugin) -> None:
    """Pixels whose point lies outside of the target are not visible there."""
    flow = plugin.instance(_wall(1, SIZE), _wall(1, SIZE, shift=24))
    fraction = float(flow.visible[0, 16:-16, :12].float().mean())
    expect(
        fraction < 0.2,
        given=f"{100 * fraction:.0f} % of the left margin visible after the wall moved left by 24 pixels",
        change="set `visible` to false where the target pixel lies outside",
    )


def pairs_are_independent(plugin: Plugin) -> None:
    """A batch of pairs gives what each pair gives alone, and the same again; frames are left as they were."""
    source, target = _wall(2, SIZE), _wall(2, SIZE, shift=4)
    kept = source.map(Tensor.clone)
    together = plugin.instance(source, target)
    for index in range(2):
        expect_close(
            together.row(index),
            plugin.instance(source.row(index), target.row(index)),
            what=f"pair {index} of a batch against the same pair alone",
            change="match each pair by itself",
        )
    change = "look for random numbers, and for operations that write into what came in"
    expect_same(plugin.instance(source, target), together, what="the same pairs again", change=change)
    expect_same(source, kept, what="the source frames", change=change)


def missing_knowledge_is_said(plugin: Plugin) -> None:
    """Frames without depth or cameras give a flow, or a ValueError of one line that says what is missing."""
    bare = [replace(_wall(1, SIZE, shift=s), depth=None, world_from_camera=None, intrinsics=None) for s in (0, 4)]
    with refusal("say which of depth, poses and intrinsics it needs"):
        conform(plugin.instance(*bare), Flow, "the flow between images alone", M=1, H=SIZE[0], W=SIZE[1])


def _wall(number: int, size: tuple[int, int], *, shift: int = 0, drop: int = 0) -> Frames:
    # A textured wall that faces the cameras; theirs moved right and down by so much that it moves by whole pixels.
    height, width = size
    source = generator(11)
    coarse = torch.rand(number, 3, height // 4 + 16, width // 4 + 16, generator=source)
    texture = F.interpolate(coarse, scale_factor=4, mode="bicubic", align_corners=False).clamp(0, 1)
    images = texture[:, :, 8 + drop : 8 + drop + height, 8 + shift : 8 + shift + width]
    pose = torch.eye(4).repeat(number, 1, 1)
    pose[:, 0, 3], pose[:, 1, 3] = shift * DEPTH / FOCAL, drop * DEPTH / FOCAL
    intrinsics = torch.tensor([[FOCAL, 0.0, width / 2], [0.0, FOCAL, height / 2], [0.0, 0.0, 1.0]])
    depth = torch.full((number, height, width), DEPTH)
    return Frames(images.contiguous(), depth, pose, intrinsics.repeat(number, 1, 1))


def displacement_alone_is_the_flows(plugin: Plugin) -> None:
    """Asked for the displacement alone, it gives that of the whole flow."""
    source, target = _wall(2, SIZE), _wall(2, SIZE, shift=4)
    expect_close(
        plugin.instance.displacement(source, target),
        plugin.instance(source, target).displacement,
        what="the displacement alone against that of the flow",
        change="leave `displacement` as it is inherited, or compute the same in it",
    )


CHECKS: tuple[Check, ...] = (
    Check(flow_has_the_frames_shape, needed=True),
    Check(nothing_moved_is_no_flow),
    Check(moved_cameras_are_followed),
    Check(what_left_the_frame_is_not_visible),
    Check(pairs_are_independent),
    Check(displacement_alone_is_the_flows),
    Check(missing_knowledge_is_said),
)
