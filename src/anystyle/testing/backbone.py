"""What a backbone promises: see :class:`anystyle.contracts.Backbone`."""

import copy

import torch
from torch import Tensor

from anystyle.contracts import Adapter, Aggregator, Backbone, Embedder, GaussianHead, GeometryHead
from anystyle.testing import backbone_sites as sites
from anystyle.testing import backbone_values as values
from anystyle.testing.backbone_encoding import Plugin, encoded, frozen, some_views
from anystyle.testing.check import Check, attempt, expect
from anystyle.testing.comparing import expect_same, expect_untouched

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
    Check(sites.sites_are_named_after_their_part, needed=True, see="ToyAggregator"),
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
    Check(sites.every_site_is_visited, see="ToyAggregator"),
    Check(sites.injected_tokens_are_used, see="ToyAggregator"),
    Check(sites.untouched_sites_change_nothing, see="ToyAggregator"),
    Check(encoding_twice_is_the_same),
    Check(copies_compute_the_same, see="ToyGaussianHead"),
    Check(freezing_is_for_good),
    Check(values.attributes_carry_gradients, see="ToyAdapter"),
)
