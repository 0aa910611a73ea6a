"""Colours as a site, in every backbone whose Gaussian head offers it."""

from pathlib import Path

import pytest
import torch

from anystyle.contracts import Backbone
from anystyle.registry.catalog import catalog
from anystyle.types import Tokens, Views
from oracle import smooth_image

VIEWS = Views(smooth_image(1, (2, 3, 3, 28, 42)))


def made(name: str, **options: object) -> Backbone:
    torch.manual_seed(0)
    cls = catalog().find("backbone", name).load()
    return cls(**(cls.example(Path()) | options))


@pytest.mark.parametrize("chunk", [1, 8])
@pytest.mark.parametrize("name", ["anysplat", "depth_anything"])
@torch.no_grad()
def test_colours_are_a_site_where_wanted(name: str, chunk: int) -> None:
    plain, styled = made(name, chunk=chunk), made(name, chunk=chunk, styled_color=True, styled_levels=())
    assert [site.name for site in styled.gaussian_head.sites] == ["head/direct", "head/color"]
    assert "head/color" not in {site.name for site in plain.gaussian_head.sites}
    scene = styled.encode(VIEWS)
    seen: list[str] = []

    def inject(site: str, tokens: Tokens) -> Tokens:
        seen.append(site)
        if site != "head/color":
            return tokens
        assert tokens.data.shape[:3] == (2, 3, 28 * 42) and tokens.grid == (28, 42)  # all views, whatever the chunk
        return tokens.with_data(2 * tokens.data + 1)

    head = styled.gaussian_head
    before, after = head(scene.features, VIEWS.images), head(scene.features, VIEWS.images, inject)
    assert seen.count("head/color") == 1
    torch.testing.assert_close(after.color, 2 * before.color + 1)
    assert torch.equal(after.opacity, before.opacity) and torch.equal(after.rotation, before.rotation)
    assert torch.equal(before.color, plain.gaussian_head(scene.features, VIEWS.images).color)
