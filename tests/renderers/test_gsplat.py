"""What the gsplat renderer asks of gsplat, and what it makes of the answer, without a graphics card."""

import sys
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torch import Tensor

from anystyle.geometry.harmonics import colors, degree_of
from anystyle.geometry.projection import project
from anystyle.renderers.gsplat import GsplatRenderer
from anystyle.renderers.torch import TorchRenderer, blend
from anystyle.testing import renderer as contract
from anystyle.testing.subject import Subject
from tests.support.scenes import cameras, gaussians


def rasterization(**given: Any) -> tuple[Tensor, Tensor, dict[str, Any]]:
    """gsplat's function with gsplat's conventions, for one scene and the arguments that matter here."""
    means, opacities, width, height = (given[name] for name in ("means", "opacities", "width", "height"))
    assert given["render_mode"] == "RGB+D"
    assert means.dtype == given["viewmats"].dtype == given["Ks"].dtype == torch.float32
    limits = {"near": given["near_plane"], "far": given["far_plane"], "eps2d": given["eps2d"]}
    limits["antialiased"] = given["rasterize_mode"] == "antialiased"
    images = []
    for view, intrinsics in zip(given["viewmats"], given["Ks"], strict=True):
        splats = project(means, given["covars"], opacities, view, intrinsics, (height, width), **limits)
        shown = given["colors"][splats.index]
        if given["sh_degree"] is not None:
            assert degree_of(shown.shape[-2]) == given["sh_degree"]
            origin = torch.linalg.inv(view)[:3, 3]
            shown = colors(shown, torch.nn.functional.normalize(means[splats.index] - origin, dim=-1))
        payload = torch.cat([shown, splats.depths[:, None]], dim=-1)
        x, y = torch.arange(width) + 0.5, torch.arange(height) + 0.5
        images.append(blend(splats.means, splats.conics, splats.opacities, payload, x, y, 0.999))
    image = torch.stack(images).movedim(1, -1)
    shown = {name: torch.zeros(1, *size).index_copy(1, splats.index, getattr(splats, name)[None]) for name, size in
             (("means", (len(means), 2)), ("conics", (len(means), 3)), ("opacities", (len(means),)))}  # fmt: skip
    made = {"means2d": shown["means"], **shown, "width": width, "height": height, "tile_size": 16}
    return image[..., :4], 1 - image[..., 4:], made | {"isect_offsets": torch.zeros(1), "flatten_ids": splats.index}


def rasterize_to_pixels(means2d, conics, colors, opacities, width, height, tile_size, isect_offsets, flatten_ids):
    """gsplat's function for one view: the Gaussians of all tiles are ``flatten_ids``, nearest first."""
    assert isect_offsets.shape == (1,) and tile_size == 16
    means2d, conics, opacities, colors = (each[0, flatten_ids] for each in (means2d, conics, opacities, colors))
    x, y = torch.arange(width) + 0.5, torch.arange(height) + 0.5
    image = blend(means2d, conics, opacities, torch.nn.functional.pad(colors, (0, 1)), x, y, 0.999)
    return image[None, :3].movedim(1, -1), 1 - image[None, 4:].movedim(1, -1)


@pytest.mark.parametrize(("degree", "antialiased"), [(0, False), (4, False), (1, True)])
def test_asks_for_the_same_picture(monkeypatch: pytest.MonkeyPatch, degree: int, antialiased: bool) -> None:
    monkeypatch.setitem(sys.modules, "gsplat", SimpleNamespace(rasterization=rasterization))
    scene, views = gaussians(2, 60, degree).marked(antialiased), cameras(2, 3, (12, 20))
    options = {"near": 2.5, "far": 3.6, "eps2d": 0.5}
    expected = TorchRenderer(**options).accumulate(scene, views)
    torch.testing.assert_close(GsplatRenderer(**options).accumulate(scene, views), expected, rtol=1e-4, atol=2e-5)


def test_its_linear_views_are_as_promised(monkeypatch: pytest.MonkeyPatch) -> None:
    gsplat = SimpleNamespace(rasterization=rasterization, rasterize_to_pixels=rasterize_to_pixels)
    monkeypatch.setitem(sys.modules, "gsplat", gsplat)
    monkeypatch.setattr(GsplatRenderer, "devices", ())
    contract.test_a_linear_view_is_linear_and_shows_the_scene(
        Subject("renderer", GsplatRenderer, {"background": (0.2, 0.5, 0.8)})
    )
    assert GsplatRenderer().linear_view(gaussians(1, 0), cameras(1, 1, (4, 4))) is None


def test_asks_for_nothing_of_an_empty_scene(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(**arguments: Any) -> Any:
        raise AssertionError("gsplat was asked to render nothing")

    monkeypatch.setitem(sys.modules, "gsplat", SimpleNamespace(rasterization=refuse))
    scene, views = gaussians(2, 0), cameras(2, 3, (12, 20))
    assert torch.equal(GsplatRenderer().accumulate(scene, views), TorchRenderer().accumulate(scene, views))


def test_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gsplat", None)
    with pytest.raises(ImportError, match=r'pip install "anystyle\[gpu\]"'):
        GsplatRenderer().accumulate(gaussians(1, 5), cameras(1, 1, (4, 4)))


def test_the_real_gsplat_takes_these_arguments(monkeypatch: pytest.MonkeyPatch) -> None:
    import inspect

    real = inspect.signature(pytest.importorskip("gsplat").rasterization)
    scene, views = gaussians(1, 5, 1), cameras(1, 1, (4, 4))

    def check(**arguments: Any) -> Any:
        real.bind(**arguments)
        return rasterization(**arguments)

    monkeypatch.setitem(sys.modules, "gsplat", SimpleNamespace(rasterization=check))
    assert GsplatRenderer().accumulate(scene, views).isfinite().all()


_NAMES = """
means quats scales opacities colors viewmats Ks width height near_plane far_plane radius_clip eps2d sh_degree packed
tile_size backgrounds render_mode sparse_grad absgrad rasterize_mode channel_chunk distributed camera_model segmented
covars with_ut with_eval3d radial_coeffs tangential_coeffs thin_prism_coeffs ftheta_coeffs rolling_shutter viewmats_rs
"""
PUBLISHED = _NAMES.split()
"""The parameters of gsplat 1.5.3's ``rasterization``, as its wheel on the package index declares them."""


def test_the_published_signature_has_every_argument(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[str] = []

    def check(**arguments: Any) -> Any:
        given.extend(arguments)
        return rasterization(**arguments)

    monkeypatch.setitem(sys.modules, "gsplat", SimpleNamespace(rasterization=check))
    GsplatRenderer().accumulate(gaussians(1, 5, 1), cameras(1, 1, (4, 4)))
    assert set(PUBLISHED[:9]) <= set(given) <= set(PUBLISHED)
