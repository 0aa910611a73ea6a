"""What is Warp's own: pictures and gradients are held by tests/renderers, with those of the other renderers."""

import subprocess
import sys

import pytest
import torch

from anystyle.errors import MissingExtra
from anystyle.geometry.projection import MIN_ALPHA
from anystyle.registry.catalog import catalog
from tests.support.scenes import cameras, gaussians

WARP = catalog().find("renderer", "warp").load()


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    from anystyle_warp_renderer import tiles

    monkeypatch.setitem(sys.modules, "warp", None)
    tiles.imported.cache_clear()
    with pytest.raises(MissingExtra, match=r'pip install "anystyle\[warp\]"'):
        WARP()
    assert WARP.lacks() == 'is not installed: pip install "anystyle[warp]"'


@pytest.mark.parametrize(
    ("torch_sees", "warp_sees", "told"), [(False, False, None), (True, True, None), (True, False, "newer driver")]
)
def test_a_driver_that_is_too_old_is_named(monkeypatch: pytest.MonkeyPatch, torch_sees, warp_sees, told) -> None:
    warp = pytest.importorskip("warp")
    assert WARP.lacks() is None
    monkeypatch.setattr(torch.cuda, "is_available", lambda: torch_sees)
    monkeypatch.setattr(warp, "is_cuda_available", lambda: warp_sees)
    lacks = WARP.lacks()
    assert (lacks is None) if told is None else (told in lacks)


def test_it_says_nothing_as_it_starts() -> None:
    pytest.importorskip("warp")
    code = """
from tests.support.scenes import cameras, gaussians, warp
warp.values[0]()(gaussians(1, 5), cameras(1, 1, (4, 4)))
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (run.returncode, run.stdout, run.stderr) == (0, "", "")


def test_tiles_list_what_they_show_nearest_first() -> None:
    """Every Gaussian in every tile in which a pixel of it is seen."""
    pytest.importorskip("warp")
    from anystyle_warp_renderer.tiles import TILE, TileLists

    size, renderer = (3 * TILE + 3, 2 * TILE + 1), WARP()
    splats, _ = renderer.project_view(gaussians(1, 60), cameras(1, 1, size), 0, 0)
    tiles = TileLists.of(splats, size, 0.999)
    rows, columns = torch.meshgrid(*(torch.arange(side) for side in size), indexing="ij")
    away = torch.stack([columns, rows], -1) + 0.5 - splats.means[:, None, None]
    xx, xy, yy = splats.conics[:, None, None].unbind(-1)
    sigma = 0.5 * (xx * away[..., 0] ** 2 + yy * away[..., 1] ** 2) + xy * away.prod(-1)
    seen = splats.opacities[:, None, None] * (-sigma).exp() >= MIN_ALPHA  # n H W
    assert len(tiles.starts) == 13 and int(tiles.starts[-1]) == len(tiles.entries)
    for tile, (first, stop) in enumerate(zip(tiles.starts[:-1], tiles.starts[1:], strict=True)):
        top, left = tile // 3 * TILE, tile % 3 * TILE
        listed = tiles.entries[first:stop].tolist()
        assert listed == sorted({*listed})
        assert {*seen[:, top : top + TILE, left : left + TILE].any((1, 2)).nonzero()[:, 0].tolist()} <= {*listed}
