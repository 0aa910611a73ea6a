"""What a backbone promises: see :class:`anystyle.contracts.Backbone`."""

import copy
from dataclasses import replace

import torch
from torch import Tensor

from anystyle.contracts import Adapter, Aggregator, Backbone, Embedder, GaussianHead, GeometryHead
from anystyle.testing import backbone_values as values
from anystyle.testing.backbone_encoding import Plugin, encoded, expect_grid, frozen, some_views
from anystyle.testing.check import Check, attempt, expect
from anystyle.testing.comparing import conform, expect_same, expect_untouched, tensors_of
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


PARTS = {
    "embedder": Embedder,
    "aggregator": Aggregator,
    "geometry_head": GeometryHead,
    "gaussian_head": GaussianHead,
    "adapter": Adapter,
}


def all_five_parts_are_there(plugin: Plugin) -> None:
    """The constructor sets the five parts, ``patch_size`` and ``resolution``."""
    backbone = plugin.instance
    for name, base in PARTS.items():
        part = getattr(backbone, name, None)
        expect(
            isinstance(part, base),
            given=f"`{name}` is {'not set' if part is None else f'of class {type(part).__name__}'}",
            expected=f"a part that inherits from anystyle.contracts.{base.__name__}",
            change=f"set `self.{name}` in the constructor",
        )
    for name in ("patch_size", "resolution"):
        value = getattr(backbone, name, None)
        expect(
            isinstance(value, int) and value >= 1,
            given=f"`{name}` is {value!r}",
            expected="a number of pixels, at least 1",
            change=f"set `self.{name}` in the constructor",
        )


def final_methods_are_left_alone(plugin: Plugin) -> None:
    """``encode``, ``freeze``, ``train`` and ``sites`` are the framework's."""
    for name in ("encode", "freeze", "train", "sites"):
        owner = next(cls for cls in plugin.cls.__mro__ if name in vars(cls))
        expect(
            owner is Backbone,
            given=f"{owner.__name__} overrides `{name}`",
            expected="the method of anystyle.contracts.Backbone",
            change="move the work into one of the five parts",
        )


@torch.no_grad()
def encoding_twice_is_the_same(plugin: Plugin) -> None:
    """The same views give the same scene, bit for bit, and are left as they were."""
    backbone = frozen(plugin)
    given = some_views(plugin)
    before = given.images.clone()
    first = backbone.encode(given)
    expect_untouched(given.images, before, "the images after `encode`")
    kept = first.map(Tensor.clone)
    again = backbone.encode(given)
    for what, scene in (("the second scene", again), ("the first scene, after the second was made", first)):
        expect_same(
            scene, kept, what=what, change="look for random numbers, or for state that a forward pass leaves behind"
        )


@torch.no_grad()
def copies_compute_the_same(plugin: Plugin) -> None:
    """Deep copies of the aggregator and of the Gaussian head give the same bits, on weights of their own."""
    backbone = frozen(plugin)
    scene = encoded(plugin)
    with attempt("copy.deepcopy of a part", change="keep in the part only what can be copied, no hooks or handles"):
        aggregator, head = copy.deepcopy(backbone.aggregator), copy.deepcopy(backbone.gaussian_head)
    expected, change = "the same bits", "keep all that the part computes with in its parameters and buffers"
    expect_same(aggregator(scene.stem), scene.features, what="features of a copy", expected=expected, change=change)
    attributes = head(scene.features, scene.views.images)
    expect_same(attributes, scene.attributes, what="attributes of a copy", expected=expected, change=change)
    for parameter in (*aggregator.parameters(), *head.parameters()):
        parameter.add_(1.0)
    again = backbone.encode(scene.views)
    expect_same(
        again.attributes,
        scene.attributes,
        what="the original's attributes, after the copy learned",
        change="do not share tensors outside of parameters and buffers",
    )


def freezing_is_for_good(plugin: Plugin) -> None:
    """After ``freeze`` nothing learns, and every module stays in ``eval`` whatever is asked for."""
    backbone = plugin.build()
    backbone.train()
    loose = [name or "the backbone" for name, module in backbone.named_modules() if not module.training]
    expect(
        not loose,
        given=f"after `train()` {', '.join(loose[:3])} is in eval mode",
        expected="every module in training mode until it is frozen",
        change="do not override `train` in a part",
    )
    frozen = backbone.freeze()
    backbone.train()
    awake = [name for name, module in backbone.named_modules() if module.training]
    learning = [name for name, parameter in backbone.named_parameters() if parameter.requires_grad]
    expect(
        frozen is backbone and not awake and not learning,
        given=f"after `freeze()` and `train()`: in training mode {awake[:3]}, learning {learning[:3]}",
        change="register every part and layer as a submodule",
    )


CHECKS: tuple[Check, ...] = (
    Check(all_five_parts_are_there, needed=True),
    Check(final_methods_are_left_alone),
    Check(sites_are_named_after_their_part, needed=True, see="ToyAggregator"),
    Check(values.encodes_two_views, needed=True),
    Check(values.encodes_a_single_view),
    Check(values.encodes_every_shape),
    Check(values.encodes_several_scenes_at_once),
    Check(values.dtypes_are_kept, see="ToyGeometryHead"),
    Check(values.numbers_are_finite),
    Check(values.cameras_are_rigid_pinholes, see="ToyGeometryHead"),
    Check(values.confidence_is_not_negative, see="ToyGeometryHead"),
    Check(values.pixels_share_gaussians_fairly, see="ToyAdapter"),
    Check(values.gaussians_are_renderable, see="ToyAdapter"),
    Check(every_site_is_visited, see="ToyAggregator"),
    Check(injected_tokens_are_used, see="ToyAggregator"),
    Check(untouched_sites_change_nothing, see="ToyAggregator"),
    Check(encoding_twice_is_the_same),
    Check(copies_compute_the_same, see="ToyGaussianHead"),
    Check(freezing_is_for_good),
    Check(values.attributes_carry_gradients, see="ToyAdapter"),
)
