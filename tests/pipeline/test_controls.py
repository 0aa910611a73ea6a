"""How a style is applied: closed forms, scipy, and the ends that must be exact."""

from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from PIL import Image
from scipy.spatial.transform import Rotation, Slerp

import anystyle
from anystyle import Controls, ViewOptions
from anystyle.commands import stylize
from anystyle.contracts import PosedViews
from anystyle.data.folder import read_views
from anystyle.data.images import to_tensor
from anystyle.geometry.harmonics import colors
from anystyle.pipeline.controls import LUMA, SeenScene, blended, rescaled, with_colors_of
from anystyle.pipeline.masks import Box, MaskFolder, Sphere, inside, mask_files, parsed
from anystyle.pipeline.saved import read_gaussians
from anystyle.pipeline.words import request
from anystyle.renderers.torch import TorchRenderer
from anystyle.types import Cameras, Gaussians, Original, SourceImage
from anystyle_captures.structure_from_motion import StructureFromMotion
from tests.support import scenes
from tests.support.cards import World, arc
from tests.support.pictures import picture

VIEWS = ViewOptions(short_side=56, take=3)


def test_the_ends_of_strength_have_the_bits_of_each_scene():
    first, second = scenes.gaussians(1, 40, 1), scenes.gaussians(1, 40, 1, seed=1)
    mixed = blended(first, second, (torch.arange(40) % 2)[None].float())
    for item in fields(Gaussians):
        one, two, both = (getattr(value, item.name) for value in (first, second, mixed))
        assert torch.equal(both[:, ::2], one[:, ::2]) and torch.equal(both[:, 1::2], two[:, 1::2]), item.name


def test_halfway_is_the_middle_of_colours_and_the_middle_rotation():
    first, second = scenes.gaussians(1, 40), scenes.gaussians(1, 40, 1, seed=1)
    middle = blended(first, second, 0.5)
    torch.testing.assert_close(middle.harmonics[:, :, 0], (first.harmonics + second.harmonics[:, :, :1])[:, :, 0] / 2)
    torch.testing.assert_close(middle.harmonics[:, :, 1:], second.harmonics[:, :, 1:] / 2)
    for index in range(40):
        both = np.stack([first.rotations[0, index].numpy(), second.rotations[0, index].numpy()])
        expected = Slerp([0, 1], Rotation.from_quat(both, scalar_first=True))(0.5)
        actual = Rotation.from_quat(middle.rotations[0, index].numpy(), scalar_first=True)
        assert (expected * actual.inv()).magnitude() < 1e-5


def test_scenes_of_different_sizes_are_not_blended():
    with pytest.raises(ValueError, match="40 and 41 Gaussians"):
        blended(scenes.gaussians(1, 40), scenes.gaussians(1, 41), 0.5)


def test_preserved_colours_have_the_styles_brightness_and_the_scenes_hues_from_every_direction():
    scene, styled = scenes.gaussians(1, 40), scenes.gaussians(1, 40, 2, seed=1)
    kept = with_colors_of(scene, styled)
    directions = torch.nn.functional.normalize(
        torch.randn(1, 40, 3, generator=torch.Generator().manual_seed(2)), dim=-1
    )

    def shown(gaussians):
        # An offset keeps all above the cut at 0, so that colours are linear.
        lifted = gaussians.harmonics.clone()
        lifted[:, :, 0] += 20
        return colors(lifted, directions)

    luma = torch.tensor(LUMA)
    torch.testing.assert_close(shown(kept) @ luma, shown(styled) @ luma)
    chroma = [rgb - (rgb @ luma)[..., None] for rgb in (shown(kept), shown(scene))]
    torch.testing.assert_close(chroma[0], chroma[1], rtol=0, atol=1e-5)
    assert torch.equal(with_colors_of(scene, styled, 0.0).harmonics, styled.harmonics)


def test_strokes_grow_as_the_scale_says():
    image = torch.rand(3, 32, 48, generator=torch.Generator().manual_seed(0))
    assert rescaled(image, 1.0) is image
    x = torch.linspace(0, 1, 48).expand(3, 32, 48)
    # Twice as large: the middle half of a ramp, stretched over the image.
    ramp = rescaled(x, 2.0)
    assert float(ramp[0, 0, -1] - ramp[0, 0, 0]) == pytest.approx(0.5 * 47 / 47, abs=0.03)
    # Half as large: the whole among its mirrors, so that the ramp runs down, up and down.
    small = rescaled(x, 0.5)[0, 16]
    assert float(small[12:36].diff().min()) >= -0.01 and float(small[:12].diff().max()) <= 0.01
    assert rescaled(image, 0.5).shape == image.shape == rescaled(image, 3.0).shape


def test_signed_distances_of_a_sphere_and_a_box():
    gaussians = scenes.gaussians(1, 200)
    shown = SeenScene([], Cameras(torch.eye(4)[None, None], torch.eye(3)[None, None], (2, 2)), TorchRenderer())
    points = gaussians.means[0]
    ball = Sphere((0.1, 0.2, 0.3), 1.0).weights(gaussians, shown)[0]
    assert torch.equal(ball == 1, (points - torch.tensor([0.1, 0.2, 0.3])).norm(dim=1) <= 1)
    low, high = torch.tensor([-0.5, -1.0, -0.2]), torch.tensor([0.7, 0.3, 0.9])
    box = Box(tuple(low.tolist()), tuple(high.tolist())).weights(gaussians, shown)[0]
    assert torch.equal(box == 1, ((points >= low) & (points <= high)).all(1)) and 0 < box.mean() < 1
    soft = Box(tuple(low.tolist()), tuple(high.tolist()), soft=0.5).weights(gaussians, shown)[0]
    outside = torch.maximum(low - points, points - high).clamp_min(0).norm(dim=1)
    assert bool((soft[outside > 0.25] == 0).all()) and bool((soft[box == 1] >= 0.5 - 1e-6).all())


def test_a_soft_edge_runs_smoothly_from_one_to_zero():
    weights = inside(torch.linspace(-1, 1, 101), 1.0)
    assert weights[0] == 1 and weights[-1] == 0 and float(weights[50]) == pytest.approx(0.5)
    assert bool((weights.diff() <= 0).all())
    torch.testing.assert_close(weights + weights.flip(0), torch.ones(101))


def test_masks_of_photographs_reach_the_gaussians_that_show_in_them(tmp_path):
    """Gaussians left of the middle of a view get its dark half; the mask has twice the view's size."""
    size = (48, 64)
    gaussians = replace(
        scenes.gaussians(1, 4),
        means=torch.stack([torch.tensor([-0.4, -0.2, 0.2, 0.4]), torch.zeros(4), torch.full((4,), 2.0)], 1)[None],
        scales=torch.full((1, 4, 3), 0.03),
        opacities=torch.full((1, 4), 0.9),
    )
    intrinsics = torch.tensor([[64.0, 0, 32], [0, 64.0, 24], [0, 0, 1]])
    cameras = Cameras(torch.eye(4)[None, None], intrinsics[None, None], size)
    mask = np.zeros((96, 128), np.uint8)
    mask[:, 64:] = 255
    Image.fromarray(mask).save(tmp_path / "one.png")
    shown = SeenScene([SourceImage.covering("one", size, size)], cameras, TorchRenderer())
    weights = MaskFolder(tmp_path).weights(gaussians, shown)[0]
    assert weights.shape == (4,) and weights[:2].max() < 0.02 and weights[2:].min() > 0.98
    palette = Image.fromarray(mask // 255, "P")
    palette.putpalette([0, 0, 0, 128, 0, 0])  # as of segmented films
    for labels in (Image.fromarray(mask // 255), Image.fromarray(mask // 85), palette):
        labels.save(tmp_path / "one.png")
        assert torch.equal(MaskFolder(tmp_path).weights(gaussians, shown)[0], weights)
    # White on a dark photograph, whose brightness counts.
    dark = np.random.default_rng(0).integers(0, 40, (96, 128, 3), np.uint8)
    Image.fromarray(np.maximum(mask[..., None], dark)).save(tmp_path / "one.png")
    assert MaskFolder(tmp_path).weights(gaussians, shown)[0, :2].max() < 0.2
    Image.fromarray(mask.astype(np.uint16) // 255).save(tmp_path / "one.png")
    with pytest.raises(ValueError, match="no level is white, the largest is 1 of 65535; save labels"):
        MaskFolder(tmp_path).weights(gaussians, shown)
    Image.fromarray(np.dstack([255 - mask, mask])).save(tmp_path / "one.png")  # dark where it is opaque
    assert MaskFolder(tmp_path).weights(gaussians, shown).max() < 0.02
    photograph = tmp_path.with_suffix(".jpg")
    Image.new("L", size).save(photograph)
    (tmp_path / "one.png").rename(tmp_path / f"{photograph.stem}.png")
    lying = replace(shown, sources=[replace(shown.sources[0], path=photograph)])
    with pytest.raises(ValueError, match=r"has 128x96 pixels, and .* 48x64, upright; give a mask of the same aspect"):
        MaskFolder(tmp_path).weights(gaussians, lying)
    (tmp_path / f"{photograph.stem}.png").rename(tmp_path / "one.png")
    behind = replace(gaussians, means=gaussians.means * torch.tensor([1.0, 1.0, -1.0]))
    assert float(MaskFolder(tmp_path).weights(behind, shown).abs().max()) < 1e-5
    with pytest.raises(ValueError, match="no mask for the photograph two"):
        MaskFolder(tmp_path).weights(gaussians, replace(shown, sources=[SourceImage.covering("two", size, size)]))


def test_a_mask_follows_the_photograph_that_is_made_straight(tmp_path):
    """Drawn on photographs of a barrel, at another size: it shows what the views show, and the views are straight."""
    originals = []
    for number, pose in enumerate(arc(4, 30)):
        pixels = World(0).picture(pose, 200.0, (168, 192), radial=-0.25)
        path = tmp_path / f"{number}.png"
        Image.fromarray(pixels).resize((384, 336)).save(path)
        originals.append(Original(str(number), path, (336, 384), Image.fromarray(pixels), Image.Exif()))
    find = StructureFromMotion(keep=False)
    posed = find(originals, short_side=84, multiple=14, enlarge=True, on_progress=lambda _: None)
    assert isinstance(posed, PosedViews) and len(posed.sources) == 4
    for view, source in enumerate(posed.sources):
        with Image.open(tmp_path / f"{source.name}.png") as mask:
            straight = to_tensor(source.of_view(mask))
            crooked = to_tensor(replace(source, straightened=None).of_view(mask))
        image = posed.views.images[0, view]
        errors = [float((picture - image).square().mean().sqrt()) for picture in (straight, crooked)]
        assert errors[0] < 0.04 and errors[1] > 2 * errors[0]


def test_words_become_masks(tmp_path):
    assert parsed("sphere:1,2,3,0.5,soft=0.1") == Sphere((1.0, 2.0, 3.0), 0.5, 0.1)
    assert parsed("box:0,0,0,1,2,3") == Box((0.0, 0.0, 0.0), (1.0, 2.0, 3.0))
    assert parsed(f"{tmp_path},soft=0") == MaskFolder(tmp_path, 0.0)
    boxes = ("box:1,2,3,0,0,0", "box:0,0,0,1,1,1,soft=x")
    for word in ("nowhere", "sphere:1,2,3", "sphere:1,2,3,-1", "sphere:a,b,c,d", "ball:1", *boxes):
        with pytest.raises(ValueError, match="mask"):
            parsed(word)


def test_flags_become_every_combination():
    words = ["--strength", "0,0.5", "--preserve-color", "1", "photos", "--scale", "2", "--text", "x"]
    controls = list(request(words).controls)
    assert controls == [Controls(0.0, 1.0, 2.0), Controls(0.5, 1.0, 2.0)] and request([]).controls == (Controls(),)
    for words in (["--strength", "x"], ["--strength", "1.5"], ["--scale", "0"]):
        with pytest.raises(ValueError):
            request(words)


def test_strengths_are_a_strip_from_the_unstyled_scene_on(photographs, tmp_path):
    words = ["views.short_side=56", "views.take=2", "video.frames=2", "video.scale=0.5", "--strength", "0,0.5,1"]
    stylize.main([str(photographs), "--text", "dots", "--out", str(tmp_path), *words])
    folders = sorted(path for path in tmp_path.iterdir() if path.is_dir())
    assert [folder.name for folder in folders] == ["01-dots_strength-0", "02-dots_strength-0-5", "03-dots"]
    files = [tmp_path / "unstyled.safetensors", *(folder / "scene.safetensors" for folder in folders)]
    assert files[0].read_bytes() == files[1].read_bytes()
    unstyled, _, middle, styled = map(read_gaussians, files)
    assert torch.equal(middle.harmonics, blended(unstyled, styled, 0.5).harmonics)
    with Image.open(tmp_path / "sheet.png") as sheet:
        assert sheet.width > 5 * 220  # the photograph, the unstyled scene, and three strengths


def test_a_mask_and_preserved_colour_change_what_they_are_for(photographs, caplog):
    stylizer = anystyle.load()
    everywhere = Sphere((0.0, 0.0, 0.0), 1e6)
    nowhere = Sphere((0.0, 0.0, 0.0), 1e-9)
    controls = [Controls(mask=everywhere), Controls(mask=nowhere), Controls(preserve_color=1.0), Controls()]
    results = anystyle.stylize(photographs, "dots", model=stylizer, views=VIEWS, controls=controls)
    full, none, preserved, plain = (result.gaussians for result in results)
    assert torch.equal(full.harmonics, plain.harmonics)
    assert torch.equal(none.harmonics, results.run.unstyled.harmonics)
    assert caplog.text.count(f"the mask {nowhere.text} holds none of the Gaussians, whose median is [") == 1
    assert not torch.equal(preserved.harmonics, plain.harmonics)
    small = anystyle.load("tiny")
    with pytest.raises(ValueError, match="is a text"):
        anystyle.stylize(photographs, "dots", model=small, views=VIEWS, controls=Controls(scale=2.0))
    (large,) = anystyle.stylize(photographs, "dots", model=stylizer, views=VIEWS, controls=Controls(scale=2.0))
    assert not torch.equal(large.gaussians.harmonics, plain.harmonics)


def test_several_styles_share_a_scene_by_place_or_by_attribute(photographs, tmp_path):
    """As the documentation does it: results are values, and one with other Gaussians is saved as any."""
    middle = Sphere((0.0, 0.0, 1.0), 0.3)
    dots, hatching = anystyle.stylize(
        photographs, ["dots", "fine hatching"], model=anystyle.load(), views=VIEWS, video={"frames": 2}
    )
    both = replace(dots, gaussians=blended(dots.gaussians, hatching.gaussians, hatching.weights(middle)))
    inside = (both.gaussians.means - torch.tensor(middle.center)).norm(dim=-1) <= middle.radius
    assert 0 < int(inside.sum()) < inside.numel()
    assert torch.equal(both.gaussians.harmonics[inside], hatching.gaussians.harmonics[inside])
    assert torch.equal(both.gaussians.harmonics[~inside], dots.gaussians.harmonics[~inside])
    assert not torch.equal(hatching.gaussians.harmonics, both.gaussians.harmonics)
    anystyle.save(both, tmp_path / "both")
    assert torch.equal(read_gaussians(tmp_path / "both" / "scene.safetensors").harmonics, both.gaussians.harmonics)


def test_masks_lie_in_the_folders_of_photographs_or_are_named_as_views(tmp_path):
    for name in ("photos/cam0/1.png", "photos/cam1/1.png", "masks/cam0/1.png", "masks/cam1/1.png"):
        picture(tmp_path / name, 0, (64, 48))
    _, sources = read_views([tmp_path / "photos"], short_side=48, multiple=16, max_views=8)
    assert mask_files(tmp_path / "masks", sources) == [tmp_path / "masks" / f"cam{n}" / "1.png" for n in (0, 1)]
    for number in (0, 1):
        Image.new("RGB", (64, 48)).save(tmp_path / f"cam{number}_1.jpg")
    assert mask_files(tmp_path, sources) == [tmp_path / f"cam{number}_1.jpg" for number in (0, 1)]
    with pytest.raises(ValueError, match="may be"):
        mask_files(tmp_path / "masks" / "cam0", [replace(source, name="x") for source in sources])
