"""What a backbone promises of the places where style may enter."""

from dataclasses import replace

import torch

from anystyle.testing.backbone_encoding import Plugin, encoded, expect_grid, frozen, some_views
from anystyle.testing.check import expect
from anystyle.testing.comparing import conform, expect_same, tensors_of
from anystyle.testing.inputs import generator
from anystyle.types import Site, Tokens, untouched


def sites_are_named_after_their_part(plugin: Plugin) -> None:
    """Sites are called ``aggregator/...`` or ``head/...``, once each, with the channels of their tokens."""
    backbone = plugin.instance
    names: list[str] = []
    for prefix, sites in (("aggregator/", backbone.aggregator.sites), ("head/", backbone.gaussian_head.sites)):
        for site in sites:
            expect(
                isinstance(site, Site) and site.name.startswith(prefix) and len(site.name) > len(prefix),
                given=f"a site {site!r}",
                expected=f"a Site whose name starts with {prefix!r} and goes on",
                change="rename it; the first word tells placements which part it is in",
            )
            expect(
                "." not in site.name and site.dim >= 1,
                given=f"a site {site.name!r} of {site.dim} channels",
                expected="a name without '.', and at least 1 channel",
                change="use '/' between the words of the name: it becomes a key of the state dict",
            )
            expect(
                site.name not in names,
                given=f"two sites named {site.name!r}",
                change="number them, such as 'aggregator/4'",
            )
            names.append(site.name)
    expect(bool(names), given="no site at all", change="list it in `sites` and call `inject(name, tokens)` there")


@torch.no_grad()
def every_site_is_visited(plugin: Plugin) -> None:
    """Every site, and no other, is passed to ``inject``, in the order of ``sites``, with the promised channels."""
    backbone, given = frozen(plugin), some_views(plugin)
    visited: dict[str, Tokens] = {}

    def record(site: str, tokens: Tokens) -> Tokens:
        visited.setdefault(site, tokens)
        return tokens

    features = backbone.aggregator(backbone.embedder(given.images), record)
    backbone.gaussian_head(features, given.images, record)
    expect(
        list(visited) == [site.name for site in backbone.sites],
        given=f"`inject` was called at {', '.join(visited) or 'no site'}",
        expected=f"calls at {', '.join(site.name for site in backbone.sites)}, in this order",
        change="make `sites` and the calls of `inject` agree",
    )
    for site in backbone.sites:
        where = f"`inject` at {site.name}"
        conform(visited[site.name], Tokens, where, B=1, V=2, C=site.dim)
        expect_grid(visited[site.name], where)


@torch.no_grad()
def injected_tokens_are_used(plugin: Plugin) -> None:
    """What ``inject`` returns at a site is what the network goes on with."""
    backbone = frozen(plugin)
    scene = encoded(plugin)
    images = scene.views.images
    for site in backbone.sites:

        def shake(name: str, tokens: Tokens, chosen: str = site.name) -> Tokens:
            if name != chosen:
                return tokens
            noise = torch.randn(tokens.data.shape, generator=generator(1)).to(tokens.data)
            return replace(tokens, data=tokens.data + noise * (1 + tokens.data.std()))

        in_aggregator = site.name.startswith("aggregator/")
        if in_aggregator:
            plain, shaken = scene.features, backbone.aggregator(scene.stem, shake)
        else:
            plain, shaken = scene.attributes, backbone.gaussian_head(scene.features, images, shake)
        ours, theirs = tensors_of(shaken), tensors_of(plain)
        expect(
            any(not torch.equal(ours[name], theirs[name]) for name in theirs),
            given=f"other tokens at {site.name} change nothing in the {'features' if in_aggregator else 'attributes'}",
            change=f"go on with what is returned: `tokens = inject({site.name!r}, tokens)`",
        )


@torch.no_grad()
def untouched_sites_change_nothing(plugin: Plugin) -> None:
    """With an ``inject`` that returns its tokens, features and attributes are the same bit for bit."""
    backbone = frozen(plugin)
    scene = encoded(plugin)
    expected, change = "the same bits as without `inject`", "do nothing else where `inject` is called"
    for inject in (untouched, lambda site, tokens: replace(tokens, data=tokens.data.clone())):
        features = backbone.aggregator(scene.stem, inject)
        expect_same(features, scene.features, what="features", expected=expected, change=change)
        attributes = backbone.gaussian_head(scene.features, scene.views.images, inject)
        expect_same(attributes, scene.attributes, what="attributes", expected=expected, change=change)
