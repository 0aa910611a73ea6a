"""OpenUSD: Gaussians as ``ParticleField3DGaussianSplat`` of the schema UsdVol, styles as variants, and cameras.

The schema is OpenUSD's since version 26.3 (openusd.org, "ParticleField3DGaussianSplat"): linear scales, opacities in
[0, 1], quaternions wxyz, and spherical harmonics as 3DGS has them, Gaussian by Gaussian. What styles share is written
once; what they differ in, as a rule only colours, is in the variants of the set ``style``. The stage is y or z up.
"""

import re
import shutil
import tempfile
from collections.abc import Iterable
from importlib import import_module
from importlib.util import find_spec
from math import isqrt
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from anystyle.contracts import Format
from anystyle.io.atomic import atomic_path
from anystyle.io.splats import Offset, Remarks, Splats
from anystyle.types import Cameras, Gaussians, StyledScene
from anystyle_formats.packing import columns_of
from anystyle_formats.reading import Placed, cameras_of_one_size, gaussians, joined, offset_of_parts, reading, room_for

SET = "style"
_FOCAL = 24.0
"""Focal length of cameras; only its ratio to the apertures says something."""
_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
"""Between OpenCV's axes of a camera and OpenGL's, which are USD's."""
_HARMONICS = "radiance:sphericalHarmonicsCoefficients"


class _Modules:
    """The modules of OpenUSD, which have no types, imported when they are used."""

    def __getattr__(self, name: str) -> Any:
        return import_module(f"pxr.{name}")


pxr: Any = _Modules()


class Usd(Format):
    """OpenUSD: ``usd`` and ``usdc`` are binary, ``usda`` is text, ``usdz`` a package; each style is a variant."""

    up = "y"
    has_notes = has_offset = many_styles = reads = True

    def __init__(self) -> None:
        if find_spec("pxr") is None or tuple(pxr.Usd.GetVersion()) < (0, 26, 3):
            raise ImportError('USD files need usd-core 26.3 or newer: pip install "anystyle[usd]"')

    def write(self, scene: StyledScene, path: Path) -> None:
        kind = path.suffix.lower() if path.suffix.lower() in (".usda", ".usdz") else ".usdc"
        with atomic_path(path) as temporary, tempfile.TemporaryDirectory() as folder:
            layer = Path(folder, "scene.usda" if kind == ".usda" else "scene.usdc")
            stage = _stage(scene)  # a layer lives as long as its stage
            stage.GetRootLayer().Export(str(layer))
            if kind == ".usdz":
                package = Path(folder, "scene.usdz")
                if not pxr.UsdUtils.CreateNewUsdzPackage(pxr.Sdf.AssetPath(str(layer)), str(package)):
                    raise OSError(f"{path} cannot be packed")
                layer = package
            shutil.copyfile(layer, temporary)

    def read(self, path: Path) -> StyledScene:
        with reading(path, "USD file") as remarks, tempfile.TemporaryDirectory() as folder:
            stage = _opened(_known(path, Path(folder)))
            data = stage.GetRootLayer().customLayerData
            titles = dict(zip(data.get("variants", ()), data.get("styles", ()), strict=True))
            styles: list[tuple[str, list[Placed]]] = []
            root = stage.GetDefaultPrim()
            variants = root.GetVariantSet(SET) if root else None
            names = sorted(variants.GetVariantNames()) if variants else []
            if variants and names:
                # The order of styles where it is known; the chosen one is last.
                order, chosen = [*titles, *names], variants.GetVariantSelection()
                stage.SetEditTarget(stage.GetSessionLayer())
                for name in sorted(names, key=lambda name: (name == chosen, order.index(name))):
                    variants.SetVariantSelection(name)
                    styles.append((str(titles.get(name, name)), _found(stage, remarks)))
            else:
                styles.append((path.stem, _found(stage, remarks)))
            offset = offset_of_parts(styles[-1][1], remarks)
            named = tuple((title, joined(parts, offset)) for title, parts in styles)
            cameras, views = _read_cameras(stage, offset)
            up = "z" if pxr.UsdGeom.GetStageUpAxis(stage) == pxr.UsdGeom.Tokens.z else "y"
            notes = tuple(map(str, data.get("notes", ())))
        return StyledScene(named, cameras, views, notes, up=up, offset=offset)


def _opened(path: Path) -> Any:
    try:
        return pxr.Usd.Stage.Open(str(path))
    except pxr.Tf.ErrorException:  # its text is the library's own lines and files
        raise ValueError("OpenUSD cannot parse it") from None


def _known(path: Path, folder: Path) -> Path:
    """The path, or a link to it, of a suffix that says what the file is: OpenUSD goes by suffixes."""
    with path.open("rb") as file:
        start = file.read(8)
    suffix = ".usdc" if start == b"PXR-USDC" else ".usdz" if start[:4] == b"PK\3\4" else ".usda"
    if path.suffix.lower() in (suffix, ".usd"):
        return path
    (folder / f"scene{suffix}").symlink_to(path.resolve())
    return folder / f"scene{suffix}"


def _stage(scene: StyledScene) -> Any:
    stage = pxr.Usd.Stage.CreateInMemory("scene.usda")
    pxr.UsdGeom.SetStageUpAxis(stage, pxr.UsdGeom.Tokens.z if scene.up == "z" else pxr.UsdGeom.Tokens.y)
    pxr.UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    root = pxr.UsdGeom.Xform.Define(stage, "/Scene")
    stage.SetDefaultPrim(root.GetPrim())
    root.GetPrim().SetDisplayName(scene.title or "Scene")
    if scene.up == "opencv":  # no axes of a stage: half a turn about x stands the scene upright
        root.AddRotateXOp().Set(180.0)
    if any(scene.offset):
        root.AddTranslateOp().Set(pxr.Gf.Vec3d(*scene.offset))
    field = pxr.UsdVol.ParticleField3DGaussianSplat.Define(stage, "/Scene/Gaussians")
    styles = [_attributes(scene.splats(index)) for index in range(len(scene.styles))]
    shared = [name for name in styles[0] if all(np.array_equal(style[name], styles[0][name]) for style in styles)]
    reaches = [(style["positions"], 3 * style["scales"].max(1, keepdims=True)) for style in styles]
    low = np.min([(means - reach).min(0) for means, reach in reaches], 0)
    high = np.max([(means + reach).max(0) for means, reach in reaches], 0)
    field.CreateExtentAttr(pxr.Vt.Vec3fArray.FromNumpy(np.stack([low, high])))
    _author(field, {name: styles[0][name] for name in shared})
    variants = root.GetPrim().GetVariantSets().AddVariantSet(SET)
    names = _identifiers(title for title, _ in scene.styles)
    for name, style in zip(names, styles, strict=True):
        variants.AddVariant(name)
        variants.SetVariantSelection(name)
        with variants.GetVariantEditContext():
            _author(field, {key: values for key, values in style.items() if key not in shared})
    if scene.names:
        pxr.UsdGeom.Scope.Define(stage, "/Scene/Cameras")
    height, width = scene.cameras.size
    poses, matrices = (
        tensor[0].double().cpu().numpy() for tensor in (scene.cameras.world_from_camera, scene.cameras.intrinsics)
    )
    views = zip(_identifiers(scene.names), scene.names, poses, matrices, strict=True)
    for camera, name, pose, matrix in views:
        prim = pxr.UsdGeom.Camera.Define(stage, f"/Scene/Cameras/{camera}")
        prim.GetPrim().SetDisplayName(name)
        prim.GetPrim().SetCustomData({"height": height, "width": width})
        prim.AddTransformOp().Set(pxr.Gf.Matrix4d((pose @ _FLIP).T.tolist()))
        apertures = _FOCAL * width / matrix[0, 0], _FOCAL * height / matrix[1, 1]
        prim.CreateFocalLengthAttr(_FOCAL)
        prim.CreateHorizontalApertureAttr(apertures[0])
        prim.CreateVerticalApertureAttr(apertures[1])
        prim.CreateHorizontalApertureOffsetAttr(apertures[0] * (0.5 - matrix[0, 2] / width))
        prim.CreateVerticalApertureOffsetAttr(apertures[1] * (matrix[1, 2] / height - 0.5))
        prim.CreateClippingRangeAttr(pxr.Gf.Vec2f(0.01, 1e6))
    stage.GetRootLayer().documentation = "\n".join(scene.notes)
    stage.GetRootLayer().customLayerData = {
        "generator": "anystyle",
        "notes": pxr.Vt.StringArray(list(scene.notes)),
        "variants": pxr.Vt.StringArray(names),
        "styles": pxr.Vt.StringArray([title for title, _ in scene.styles]),
    }
    return stage


def _attributes(splats: Splats) -> dict[str, NDArray[np.float32]]:
    """The attributes of the schema that are arrays: float32, rows of Gaussians or of their coefficients."""
    means, rotations, scales, opacities, harmonics = columns_of(splats, torch.float32)
    columns = {
        "positions": means,
        "orientations": rotations[:, [1, 2, 3, 0]],  # as quaternions lie in memory
        "scales": scales,
        "opacities": opacities.clip(0, 1),
        _HARMONICS: harmonics.reshape(-1, 3),
    }
    return {name: np.ascontiguousarray(values) for name, values in columns.items()}


def _author(field: Any, columns: dict[str, NDArray[np.float32]]) -> None:
    """Set attributes where the stage is edited: on the prim, or in a variant of it."""
    kinds = {"orientations": pxr.Vt.QuatfArray, "opacities": pxr.Vt.FloatArray}
    for name, values in columns.items():
        attribute = field.GetPrim().GetAttribute(name)
        attribute.Set(kinds.get(name, pxr.Vt.Vec3fArray).FromNumpy(values))
        if name == _HARMONICS:
            coefficients = len(values) // len(field.GetPositionsAttr().Get())
            field.CreateRadianceSphericalHarmonicsDegreeAttr(isqrt(coefficients) - 1)
            primvar = pxr.UsdGeom.Primvar(attribute)
            primvar.SetElementSize(coefficients)
            primvar.SetInterpolation(pxr.UsdGeom.Tokens.vertex)


def _identifiers(titles: Iterable[str]) -> list[str]:
    """Different names for prims and variants, near to the titles."""
    names: list[str] = []
    for title in titles:
        name = re.sub(r"\W+", "_", title, flags=re.ASCII).strip("_")[:60] or "unnamed"
        name = f"_{name}" if name[0].isdigit() else name
        number = sum(re.fullmatch(rf"{re.escape(name)}(_\d+)?", other) is not None for other in names)
        names.append(f"{name}_{number + 1}" if number else name)
    return names


def _found(stage: Any, remarks: Remarks) -> list[Placed]:
    """All Gaussians that the stage shows, in its own axes."""
    transforms, found = pxr.UsdGeom.XformCache(), []
    for prim in stage.Traverse():
        shown = pxr.UsdGeom.Imageable(prim).ComputeVisibility() != pxr.UsdGeom.Tokens.invisible
        if shown and prim.IsA(pxr.UsdVol.ParticleField3DGaussianSplat):
            found.append((_splats(prim, remarks), np.array(transforms.GetLocalToWorldTransform(prim)).T))
    return found


def _splats(prim: Any, remarks: Remarks) -> Gaussians:
    positions = _array(prim, "positions", np.zeros((0, 3)))
    count = room_for(remarks.path, len(positions))
    rows = (int(prim.GetAttribute("radiance:sphericalHarmonicsDegree").Get()) + 1) ** 2
    # What is absent is what the schema says: no rotation, a size of 1, opaque, middle grey.
    coefficients = _array(prim, _HARMONICS, np.zeros((count * rows, 3)))
    return gaussians(
        remarks,
        positions,
        _array(prim, "orientations", np.tile([0.0, 0, 0, 1], (count, 1)))[:, [3, 0, 1, 2]],
        _array(prim, "scales", np.ones((count, 3))),
        _array(prim, "opacities", np.ones(count)),
        coefficients[: count * rows].reshape(count, rows, 3),
    )


def _array(prim: Any, name: str, absent: NDArray[Any]) -> NDArray[Any]:
    """The values of an attribute at the earliest time, in float or else in half precision."""
    for each in (name, f"{name}h"):
        values = prim.GetAttribute(each).Get(pxr.Usd.TimeCode.EarliestTime())
        if values is not None and len(values):
            return np.array(values)
    return absent


def _read_cameras(stage: Any, offset: Offset) -> tuple[Cameras, tuple[str, ...]]:
    """The cameras of a stage without an offset, of one size; of stages of other programs only its aspect is known."""
    found: list[tuple[tuple[int, int], str, NDArray[np.float64], NDArray[np.float64]]] = []
    transforms = pxr.UsdGeom.XformCache()
    for prim in filter(pxr.UsdGeom.Camera, stage.Traverse()):
        view, data = pxr.UsdGeom.Camera(prim).GetCamera(), prim.GetCustomData()
        across, down, focal = view.horizontalAperture, view.verticalAperture, view.focalLength
        width = int(data.get("width", 1024))
        height = int(data.get("height", round(width * down / across)))
        world = np.array(transforms.GetLocalToWorldTransform(prim)).T
        world[:3, 3] -= offset
        world[:3, :3] /= np.linalg.norm(world[:3, :3], axis=0)
        matrix = np.diag([focal * width / across, focal * height / down, 1.0])
        matrix[0, 2] = width * (0.5 - view.horizontalApertureOffset / across)
        matrix[1, 2] = height * (0.5 + view.verticalApertureOffset / down)
        found.append(((height, width), prim.GetDisplayName() or prim.GetName(), world @ _FLIP, matrix))
    return cameras_of_one_size(found)
