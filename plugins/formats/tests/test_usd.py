"""USD files as OpenUSD's own library sees them: every style a variant, cameras, and numbers bit for bit."""

import subprocess
import sys
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest
import torch

from anystyle.contracts import Format
from anystyle.errors import UserError
from anystyle.pipeline.export import export, export_styles, in_axes
from anystyle.pipeline.options import SplatOptions, ViewOptions
from anystyle.pipeline.saved import read_saved
from anystyle.pipeline.splats import cameras_of
from anystyle.registry.build import build
from anystyle.types import StyledScene
from anystyle_formats import usd
from tests.support.export_scene import camera, picture, psnr, scene
from tests.support.known_scene import rig

pytestmark = pytest.mark.skipif(find_spec("pxr") is None, reason='needs the extra: pip install "anystyle[usd]"')
SUFFIXES = ("usd", "usda", "usdc", "usdz")


def styled(coefficients=4):
    """Three styles: colours, colours and rotations, and the scene itself; two of titles that no prim can have."""
    plain = scene(coefficients)
    red = replace(plain, harmonics=plain.harmonics * torch.tensor([1.0, 0.5, 0.5]))
    turned = replace(plain, harmonics=-plain.harmonics, rotations=plain.rotations.roll(1, 1))
    titles = ("unstyled", "red & pale", "red+pale")
    styles = tuple(zip(titles, (plain, red, turned), strict=True))
    return StyledScene(styles, rig(3), ("a 1.jpg", "b.jpg", "1"), ("CC-BY-4.0",), "a “scene”")


def opened(path):
    from pxr import Usd

    return Usd.Stage.Open(str(path))


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_pxr_reads_what_is_written_bit_for_bit(suffix, tmp_path):
    given, path = styled(), tmp_path / f"scene.{suffix}"
    export_styles(given, path, suffix)
    stage, upright = opened(path), in_axes("y", given)
    field = stage.GetPrimAtPath("/Scene/Gaussians")
    variants = stage.GetDefaultPrim().GetVariantSet("style")
    names = ["unstyled", "red_pale", "red_pale_2"]
    assert sorted(variants.GetVariantNames()) == sorted(names) and variants.GetVariantSelection() == names[-1]
    for name, (_, gaussians) in zip(names, upright.styles, strict=True):
        variants.SetVariantSelection(name)
        unit = torch.nn.functional.normalize(gaussians.rotations[0], dim=-1)
        names_of = {"positions": "means", "radiance:sphericalHarmonicsCoefficients": "harmonics"}
        for attribute in ("positions", "scales", "opacities", "radiance:sphericalHarmonicsCoefficients"):
            values = getattr(gaussians, names_of.get(attribute, attribute))[0].numpy()
            found = np.array(field.GetAttribute(attribute).Get())
            np.testing.assert_array_equal(found, values.reshape(found.shape), attribute)
        quaternions = field.GetAttribute("orientations").Get()
        found = [[each.GetReal(), *each.GetImaginary()] for each in quaternions]
        np.testing.assert_array_equal(np.array(found, np.float32), unit.numpy())
        assert field.GetAttribute("radiance:sphericalHarmonicsDegree").Get() == 1
    # What all have in common is written once, outside of the variants.
    layer = stage.GetRootLayer()
    if suffix != "usdz":
        assert layer.GetAttributeAtPath("/Scene/Gaussians.positions") is not None
        inside = layer.GetPrimAtPath("/Scene{style=unstyled}Gaussians").attributes.keys()
        harmonics = ("radiance:sphericalHarmonicsCoefficients", "radiance:sphericalHarmonicsDegree")
        assert set(inside) == {"orientations", *harmonics}


def test_the_stage_says_where_it_comes_from_and_how_it_stands(tmp_path):
    from pxr import UsdGeom, UsdVol

    for up in ("y", "z"):
        export_styles(styled(), tmp_path / f"{up}.usdc", "usdc", up=up)
        stage = opened(tmp_path / f"{up}.usdc")
        assert UsdGeom.GetStageUpAxis(stage) == up.upper() and UsdGeom.GetStageMetersPerUnit(stage) == 1
        data = stage.GetRootLayer().customLayerData
        assert list(data["notes"]) == ["CC-BY-4.0"] and data["generator"] == "anystyle"
        assert list(data["styles"]) == ["unstyled", "red & pale", "red+pale"]
        assert stage.GetDefaultPrim().GetDisplayName() == "a “scene”"
        field = UsdVol.ParticleField3DGaussianSplat(stage.GetPrimAtPath("/Scene/Gaussians"))
        low, high = np.array(field.GetExtentAttr().Get())
        positions = np.array(field.GetPositionsAttr().Get())
        assert (low < positions.min(0)).all() and (high > positions.max(0)).all() and (high - low < 5).all()


def test_validators_of_openusd_find_nothing(tmp_path):
    from pxr import UsdValidation

    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) > 10
    for suffix in ("usdc", "usdz"):
        export_styles(styled(), tmp_path / f"scene.{suffix}", suffix)
        errors = UsdValidation.ValidationContext(validators).Validate(opened(tmp_path / f"scene.{suffix}"))
        assert [error.GetErrorAsString() for error in errors] == []


@pytest.mark.parametrize("up", ["y", "z", "opencv"])
def test_cameras_see_what_they_saw(up, tmp_path):
    """Also with a principal point beside the middle; and a scene that is read has them for its views."""
    beside = torch.tensor([[0.0, 0, 3], [0, 0, -2], [0, 0, 0]])
    cameras = replace(camera(), intrinsics=camera().intrinsics + beside)
    export_styles(replace(styled(), cameras=cameras, names=("mine",)), tmp_path / "scene.usda", "usda", up=up)
    found = read_saved(tmp_path / "scene.usda")
    assert found.names == ("mine",) and found.cameras.size == cameras.size
    torch.testing.assert_close(found.cameras.intrinsics, cameras.intrinsics, rtol=0, atol=1e-4)
    torch.testing.assert_close(found.cameras.world_from_camera, cameras.world_from_camera, rtol=0, atol=1e-6)
    from pxr import UsdGeom

    stage = opened(tmp_path / "scene.usda")
    frustum = UsdGeom.Camera(stage.GetPrimAtPath("/Scene/Cameras/mine")).GetCamera().frustum
    point = found.styles[0][1].means[0, 7].double()
    world = torch.stack([point[0], point[2], -point[1]]) if up == "z" else point * torch.tensor([1, -1, -1])
    seen = frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()
    x, y, _ = seen.Transform(tuple(world.tolist()))
    height, width = cameras.size
    u, v, depth = (cameras.intrinsics[0, 0].double() @ point).tolist()
    assert x == pytest.approx(2 * u / depth / width - 1, abs=1e-4)
    assert y == pytest.approx(1 - 2 * v / depth / height, abs=1e-4)
    side = ViewOptions(short_side=60)
    views, sources, origin = cameras_of(tmp_path / "scene.usda", found, side, SplatOptions(), 1, 60)
    assert origin == "stored beside it" and sources[0].name == "mine" and views.size == cameras.size


def test_all_styles_come_back(tmp_path):
    export_styles(styled(9), tmp_path / "scene.usdz", "usdz")
    found = read_saved(tmp_path / "scene.usdz")
    assert [title for title, _ in found.styles] == ["unstyled", "red & pale", "red+pale"]
    assert found.notes[0] == "CC-BY-4.0" and found.names == ("a 1.jpg", "b.jpg", "1")
    for (_, first), (_, second) in zip(found.styles, styled(9).styles, strict=True):
        for name in ("means", "scales", "opacities", "harmonics"):
            torch.testing.assert_close(getattr(first, name), getattr(second, name), rtol=0, atol=1e-5)


def test_what_other_stages_do_is_read(tmp_path):
    """Half precision, a transformation above, no colours, a hidden field, time samples."""
    from pxr import Gf, Sdf, Usd, UsdGeom, UsdVol, Vt

    gaussians = in_axes("y", StyledScene((("", scene(1)),))).styles[0][1]
    stage = Usd.Stage.CreateNew(str(tmp_path / "theirs.usda"))
    UsdGeom.SetStageUpAxis(stage, "Y")
    above = UsdGeom.Xform.Define(stage, "/World")
    above.AddTranslateOp().Set(Gf.Vec3d(1, 2, 3))
    above.AddScaleOp().Set(Gf.Vec3f(2, 2, 2))
    field = UsdVol.ParticleField3DGaussianSplat.Define(stage, "/World/Splats")
    means = (gaussians.means[0].numpy() - [1, 2, 3]) / 2
    field.CreatePositionsAttr().Set(Vt.Vec3fArray.FromNumpy(means.astype(np.float32)), 1.0)
    half = (gaussians.scales[0] / 2).half().numpy()
    field.CreateScaleshAttr(Vt.Vec3hArray.FromNumpy(half))
    quaternions = torch.nn.functional.normalize(gaussians.rotations[0], dim=-1)[:, [1, 2, 3, 0]]
    field.CreateOrientationsAttr(Vt.QuatfArray.FromNumpy(quaternions.contiguous().numpy()))
    field.CreateOpacitiesAttr(Vt.FloatArray.FromNumpy(gaussians.opacities[0].numpy()))
    field.CreateRadianceSphericalHarmonicsDegreeAttr(0)
    harmonics = np.ascontiguousarray(gaussians.harmonics[0, :, 0].numpy())
    field.CreateRadianceSphericalHarmonicsCoefficientsAttr(Vt.Vec3fArray.FromNumpy(harmonics))
    hidden = UsdVol.ParticleField3DGaussianSplat.Define(stage, "/World/Hidden")
    hidden.CreatePositionsAttr(Vt.Vec3fArray([Gf.Vec3f(0)]))
    UsdGeom.Imageable(hidden).MakeInvisible()
    stage.Save()
    found = read_saved(tmp_path / "theirs.usda")
    assert found.names == () and psnr(picture(found.styles[0][1]), picture(scene(1))) > 50
    field.GetPrim().RemoveProperty("radiance:sphericalHarmonicsCoefficients")
    UsdGeom.Imageable(hidden).MakeVisible()
    stage.GetPrimAtPath("/World/Splats").GetAttribute("orientations").Set(Vt.QuatfArray(3))
    stage.Save()
    with pytest.raises(UserError, match=r"theirs\.usda is not a readable USD file"):
        read_saved(tmp_path / "theirs.usda")
    assert Sdf.Layer.FindOrOpen(str(tmp_path / "theirs.usda")) is not None


def test_files_of_gsplat2usd_are_read(tmp_path):
    """NVIDIA's converter, which turns no axes; its stage says y all the same."""
    pytest.importorskip("gsplat2USD", reason="pip install --no-deps gsplat2usd")
    export(scene(16), tmp_path / "scene.ply", "ply")
    words = [sys.executable, "-m", "gsplat2USD", "-i", tmp_path / "scene.ply", "-o", tmp_path / "theirs.usda"]
    subprocess.run(words, check=True, capture_output=True)
    found = read_saved(tmp_path / "theirs.usda", "opencv").styles[0][1]
    assert found.harmonics.shape[2] == 16 and psnr(picture(found), picture(scene(16))) > 80


DAMAGED = (b"", b"#usda 1.0\n\xff", b"#usda 1.0\n", b"#usda 1.0\n(", b"PXR-USDC" + b"\xff" * 90, b"PK\3\4" + b"\0" * 40)


@pytest.mark.parametrize("data", DAMAGED)
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_damaged_files_end_in_one_line(suffix, data, tmp_path, capfd):
    (tmp_path / f"scene.{suffix}").write_bytes(data)
    with pytest.raises(UserError, match=rf"scene.{suffix} is not a readable USD file \((?!Error in)"):
        build(Format, suffix).read(tmp_path / f"scene.{suffix}")


def test_without_the_package_the_extra_is_named(monkeypatch):
    monkeypatch.setattr(usd, "find_spec", lambda name: None)
    with pytest.raises(ImportError, match=r'pip install "anystyle\[usd\]"'):
        build(Format, "usdz")
