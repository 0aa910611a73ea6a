"""What backbones, placements and injectors promise together, whichever they are."""

from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor

from anystyle.branch import ATTRIBUTES, StyleBranch, sites_of
from anystyle.contracts import Backbone, Injector, Placement
from anystyle.io.checkpoint import load_strictly
from anystyle.stylizer import Stylizer
from anystyle.testing.check import Check, Unavailable, expect
from anystyle.testing.comparing import expect_close, expect_gradient, expect_same, expect_untouched, tensors_of
from anystyle.testing.inputs import generator, images, views
from anystyle.testing.subject import Subject
from anystyle.testing.toy.renderer import ToyRenderer
from anystyle.testing.toy.style_encoder import ToyStyleEncoder
from anystyle.types import Gaussians, Scene, Site

TEXTS = ("deep red", "blue and white")


@dataclass(frozen=True)
class Composition:
    """One backbone, one placement and one injector.

    Args:
        backbone: Its subject; the instance is shared by all compositions of it.
        placement: Its subject.
        injector: Its subject.
    """

    backbone: Subject[Backbone]
    placement: Subject[Placement]
    injector: Subject[Injector]

    @cached_property
    def sites(self) -> tuple[Site, ...]:
        """What the placement selects.

        Raises:
            Unavailable: It needs sites that the backbone does not offer.
        """
        backbone = self.backbone.instance
        try:
            return self.placement.instance.select(sites_of(backbone))
        except ValueError as error:
            raise Unavailable(f"the two do not go together: {error}") from error

    @cached_property
    def scene(self) -> Scene:
        """Two views, encoded."""
        patch = self.backbone.instance.patch_size
        return self.stylizer().encode(views(1, 2, (2 * patch, 3 * patch)))

    def stylizer(self, styled: tuple[str, ...] = ("rotation", "color"), seed: int = 0) -> Stylizer:
        """A stylizer with an untrained branch, which replaces the ``styled`` attributes."""
        encoder = ToyStyleEncoder()
        branch = StyleBranch(
            self.backbone.instance,
            sites=self.sites,
            make_injector=lambda site: self.injector.build(seed=seed, dim=site.dim, style_dim=encoder.dim),
            styled=styled,
        )
        stylizer = Stylizer(
            backbone=self.backbone.instance, style_encoder=encoder, branch=branch, renderer=ToyRenderer()
        )
        return stylizer.eval()

    @cached_property
    def trained(self) -> tuple[Stylizer, dict[str, Tensor | None]]:
        """A stylizer after one step towards random Gaussians, and the gradients of the second."""
        stylizer = self.stylizer(ATTRIBUTES)
        embedding = stylizer.embed(text=list(TEXTS))
        optimizer = torch.optim.Adam(stylizer.branch.parameters(), lr=1e-2)
        for step in range(2):
            optimizer.zero_grad()
            total = torch.zeros(())
            for index, tensor in enumerate(tensors_of(stylizer.restyle(self.scene, embedding)).values()):
                if tensor.requires_grad:
                    target = torch.randn(tensor.shape, generator=generator(index))
                    total = total + (tensor / tensor.detach().abs().mean().clamp_min(1e-6) * target).mean()
            total.backward()
            if step == 0:
                optimizer.step()
        return stylizer, {name: parameter.grad for name, parameter in stylizer.branch.named_parameters()}


@torch.no_grad()
def nothing_changes_at_birth(composed: Composition) -> None:
    """Before any training the stylized scene is the unstyled one, bit for bit, whatever is styled."""
    for styled in (("rotation", "color"), ATTRIBUTES):
        stylizer = composed.stylizer(styled)
        by_image, by_text = stylizer.embed(image=images(1, (32, 32))), stylizer.embed(text=TEXTS[0])
        expect_same(
            stylizer.restyle(composed.scene, by_image if styled == ATTRIBUTES else by_text),
            stylizer.unstyled(composed.scene),
            what=f"Gaussians styled ({', '.join(styled)}) by an untrained branch",
            change="an injector is the identity at birth, and a copied part computes what the original does: give "
            "linear layers contiguous tensors, for of others products with learning weights are rounded otherwise",
        )


def everything_learns_by_the_second_step(composed: Composition) -> None:
    """Every trainable parameter of the branch has a finite gradient, not all 0, by the second step."""
    _, gradients = composed.trained
    change = "leave out what has no influence, or register it as a buffer; detach nothing on the way"
    for name, gradient in gradients.items():
        expect_gradient(gradient, f"`{name}`", change=change)


def the_backbone_does_not_learn(composed: Composition) -> None:
    """A backward pass leaves no gradient in the backbone, and training mode does not reach it."""
    stylizer, _ = composed.trained
    stylizer.train()
    learning = [name for name, parameter in stylizer.backbone.named_parameters() if parameter.grad is not None]
    awake = [name or "itself" for name, module in stylizer.backbone.named_modules() if module.training]
    stylizer.eval()
    expect(
        not learning and not awake,
        given=f"gradients in {learning[:3]}, and training mode in {awake[:3]}",
        change="share no parameter between the backbone and the copies",
    )


@torch.no_grad()
def style_matters_after_training(composed: Composition) -> None:
    """After a step, two styles give two scenes."""
    stylizer, _ = composed.trained
    one, other = (stylizer.restyle(composed.scene, stylizer.embed(text=text)) for text in TEXTS)
    ours, theirs = tensors_of(one), tensors_of(other)
    expect(
        any(not torch.equal(ours[name], theirs[name]) for name in theirs),
        given="the same Gaussians for two styles",
        change="let what is injected at the chosen sites reach the attributes",
    )


@torch.no_grad()
def what_is_not_styled_stays(composed: Composition) -> None:
    """With rotation and colour styled, means, scales and opacities stay the same bits, also after training."""
    stylizer, _ = composed.trained
    given = composed.stylizer()
    given.branch.load_state_dict(stylizer.branch.state_dict())
    styled = given.restyle(composed.scene, given.embed(text=TEXTS[0]))
    plain = given.unstyled(composed.scene)
    for name in ("means", "scales", "opacities"):
        expect_same(
            getattr(styled, name),
            getattr(plain, name),
            what=f"`{name}` of a scene whose rotations and colours are styled",
            change="let the adapter compute them from their own attributes alone",
        )


@torch.no_grad()
def encoding_once_is_the_single_pass(composed: Composition) -> None:
    """Restyling an encoded scene, after other styles too, gives the bits of the single pass; the scene stays."""
    stylizer, _ = composed.trained
    kept = composed.scene.map(Tensor.clone)
    embedding = stylizer.embed(text=TEXTS[0])
    stylizer.restyle(composed.scene, stylizer.embed(text=TEXTS[1]))
    expect_same(
        stylizer.restyle(composed.scene, embedding),
        stylizer(composed.scene.views, embedding),
        what="an encoded scene, restyled",
        change="keep no state between calls, and put all that does not depend on style into the scene",
    )
    expect_untouched(composed.scene, kept, "the scene after restyling")


@torch.no_grad()
def many_styles_are_one_batch(composed: Composition) -> None:
    """Many styles of one scene, or one style each of many scenes, give what one by one gives."""
    stylizer, _ = composed.trained
    embedding = stylizer.embed(text=list(TEXTS))
    alone = [stylizer.restyle(composed.scene, embedding.row(row)) for row in range(2)]
    for what, scene in (("two styles of one scene", composed.scene), ("two scenes", composed.scene.expand(2))):
        together = stylizer.restyle(scene, embedding)
        for row in range(2):
            one: Gaussians = together.row(row)
            expect_close(
                one,
                alone[row],
                what=f"style {row} of {what} against the same alone",
                change="look for a sum, mean or normalisation that runs over axis 0",
            )


@torch.no_grad()
def weights_name_their_sites(composed: Composition) -> None:
    """The state dict names every chosen site, copies only what style passes through, and is loaded strictly."""
    stylizer, _ = composed.trained
    state = stylizer.branch.state_dict()
    for site in composed.sites:
        keys = [key for key in state if key.startswith(f"injectors.{site.name}.")]
        expect(
            bool(keys),
            given=f"no weights under 'injectors.{site.name}.'",
            change="name sites with letters, digits and '/'",
        )
    parts = {site.name.partition("/")[0] for site in composed.sites}
    copies = {"aggregator": "aggregator" in parts, "gaussian_head": bool(parts & {"aggregator", "head"})}
    for name, styled in copies.items():
        expect(
            styled == any(key.startswith(f"{name}.") for key in state),
            given=f"{'no ' if styled else 'a '}copy of the {name} for style at {', '.join(sorted(parts))}",
            change="start the names of sites with the part they are in",
        )
    fresh = composed.stylizer(ATTRIBUTES, seed=1)
    load_strictly(fresh.branch, state, source="a trained branch")
    embedding = fresh.embed(text=TEXTS[0])
    expect_same(
        fresh.restyle(composed.scene, embedding),
        stylizer.restyle(composed.scene, embedding),
        what="Gaussians after loading the weights into a new branch",
        change="keep all that the parts compute with in parameters and persistent buffers",
    )


CHECKS: tuple[Check, ...] = (
    Check(nothing_changes_at_birth),
    Check(everything_learns_by_the_second_step),
    Check(the_backbone_does_not_learn),
    Check(style_matters_after_training),
    Check(what_is_not_styled_stays),
    Check(encoding_once_is_the_single_pass),
    Check(many_styles_are_one_batch),
    Check(weights_name_their_sites),
)


def checks(where: str) -> tuple[Check, ...]:
    """The checks, each with a note on what is composed."""
    return tuple(replace(check, where=where) for check in CHECKS)
