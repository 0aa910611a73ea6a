"""What a backbone, a placement and an injector promise together, whichever they are."""

from dataclasses import dataclass, replace
from functools import cached_property

import pytest
import torch
from torch import Tensor

from anystyle.branch import ATTRIBUTES, StyleBranch, sites_of
from anystyle.contracts import Backbone, Injector, Placement
from anystyle.io.checkpoint import load_strictly
from anystyle.registry.catalog import catalog
from anystyle.stylizer import Stylizer
from anystyle.testing import asserts
from anystyle.testing.inputs import generator, noise, views_of
from anystyle.testing.subject import Subject, subject
from anystyle.testing.toy.backbone import ToyBackbone
from anystyle.testing.toy.injector import ToyInjector
from anystyle.testing.toy.renderer import ToyRenderer
from anystyle.testing.toy.style_encoder import ToyStyleEncoder
from anystyle.types import Scene, Site, StyleEmbedding, Tokens

TEXTS = ["deep red", "blue and white"]


@dataclass(frozen=True)
class Composition:
    """One backbone, whose instance is shared, one placement, and one injector or two that take turns."""

    backbone: Subject[Backbone]
    placement: Subject[Placement]
    injector: Subject[Injector]
    other: Subject[Injector] | None = None

    @cached_property
    def sites(self) -> tuple[Site, ...]:
        """What the placement selects; skips the test where it needs sites that the backbone does not offer."""
        try:
            return self.placement.instance.select(sites_of(self.backbone.instance.freeze()))
        except ValueError as error:
            pytest.skip(f"the two do not go together: {error}")

    @cached_property
    def scene(self) -> Scene:
        """Two views, encoded."""
        return self.stylizer().encode(views_of(self.backbone.instance, 1, 2, (2, 3)))

    def stylizer(self, styled: tuple[str, ...] = ("rotation", "color"), seed: int = 0) -> Stylizer:
        """A stylizer with an untrained branch, which replaces the ``styled`` attributes."""
        backbone, encoder = self.backbone.instance, ToyStyleEncoder()

        def make_injector(site: Site) -> Injector:
            second = self.sites.index(site) % 2 == 1
            injector = self.other if second and self.other is not None else self.injector
            return injector.build(seed=seed, dim=site.dim, style_dim=encoder.dim, site=site)

        branch = StyleBranch(backbone, sites=self.sites, make_injector=make_injector, styled=styled)
        return Stylizer(backbone=backbone, style_encoder=encoder, branch=branch, renderer=ToyRenderer()).eval()

    def embed(self, stylizer: Stylizer, *texts: str) -> StyleEmbedding:
        """Texts as an embedding, with the tokens that an image might have."""
        rows = [torch.randn(1, 1, 6, stylizer.style_encoder.dim, generator=generator(len(text))) for text in texts]
        return replace(stylizer.embed(text=texts), tokens=Tokens(torch.cat(rows), grid=(2, 3)))

    @cached_property
    @torch.enable_grad()
    def trained(self) -> Stylizer:
        """A stylizer after one step towards random Gaussians, with the gradients of the second."""
        stylizer = self.stylizer(ATTRIBUTES)
        embedding = self.embed(stylizer, *TEXTS)
        optimizer = torch.optim.Adam(stylizer.branch.parameters(), lr=1e-2)
        for step in range(2):
            optimizer.zero_grad()
            styled = vars(stylizer.restyle(self.scene, embedding)).values()
            sizes = [tensor.detach().abs().mean().clamp_min(1e-6) for tensor in styled]
            losses = [(t / size * noise(t, n)).mean() for n, (t, size) in enumerate(zip(styled, sizes, strict=True))]
            torch.stack(losses).sum().backward()
            if step == 0:
                optimizer.step()
        return stylizer


def compositions(tested: Subject) -> dict[str, Composition]:
    """What a backbone, placement or injector is checked together with, by name; empty for other kinds."""
    parts = {"backbone": ToyBackbone, "injector": ToyInjector}
    if tested.kind not in (*parts, "placement"):
        return {}
    given = {kind: tested if kind == tested.kind else subject(kind, cls) for kind, cls in parts.items()}
    if tested.kind == "placement":
        return {"with a small backbone": Composition(placement=tested, **given)}
    built_in = [row for row in catalog() if row.kind == "placement" and row.origin == "anystyle"]
    composed = {row.name: Composition(placement=subject("placement", row.load()), **given) for row in built_in}
    if tested.kind == "injector":
        beside: type[Injector] = ToyInjector
        composed["full, beside another injector"] = replace(composed["full"], other=subject("injector", beside))
    return composed


@torch.no_grad()
def test_nothing_changes_at_initialisation(composition: Composition) -> None:
    """Before any training the stylized scene is the unstyled one, bit for bit, whichever attributes are styled."""
    for styled in (("rotation", "color"), ATTRIBUTES):
        stylizer, what = composition.stylizer(styled), f"Gaussians of an untrained branch for {', '.join(styled)}"
        result = stylizer.restyle(composition.scene, composition.embed(stylizer, TEXTS[0]))
        asserts.same(result, stylizer.unstyled(composition.scene), what)


def test_everything_learns_by_the_second_step(composition: Composition) -> None:
    """Every trainable parameter of the branch has a finite gradient, not all 0, by the second step."""
    for name, parameter in composition.trained.branch.named_parameters():
        asserts.gradient(parameter.grad, f"`{name}`")


def test_the_backbone_does_not_learn(composition: Composition) -> None:
    """A backward pass leaves no gradient in the backbone, and training mode does not reach it."""
    stylizer = composition.trained.train()
    active = [name for name, parameter in stylizer.backbone.named_parameters() if parameter.grad is not None]
    active += [name for name, module in stylizer.backbone.named_modules() if module.training]
    stylizer.eval()
    assert not active, f"gradients or training mode in the backbone's {active[:3]}; does the branch share them?"


@torch.no_grad()
def test_what_is_not_styled_stays(composition: Composition) -> None:
    """After training, two styles give two scenes; with colour styled alone, the rest stays the same bits."""
    trained = composition.trained
    one, other = (trained.restyle(composition.scene, composition.embed(trained, text)) for text in TEXTS)
    differ = any(not torch.equal(tensor, getattr(other, name)) for name, tensor in vars(one).items())
    assert differ, "the same Gaussians for two styles"
    stylizer = composition.stylizer()
    stylizer.branch.load_state_dict(composition.trained.branch.state_dict())
    styled = stylizer.restyle(composition.scene, composition.embed(stylizer, TEXTS[0]))
    unstyled = stylizer.unstyled(composition.scene)
    for name in ("means", "scales", "opacities"):
        asserts.same(getattr(styled, name), getattr(unstyled, name), f"`{name}` where rotation and colour are styled")


@torch.no_grad()
def test_encoding_once_is_the_single_pass(composition: Composition) -> None:
    """Restyling an encoded scene, after other styles too, gives the bits of the single pass; the scene stays."""
    stylizer, scene = composition.trained, composition.scene
    before, embedding = scene.map(Tensor.clone), composition.embed(stylizer, TEXTS[0])
    stylizer.restyle(scene, composition.embed(stylizer, TEXTS[1]))
    asserts.same(stylizer.restyle(scene, embedding), stylizer(scene.views, embedding), "an encoded scene, restyled")
    asserts.same(scene, before, "the scene after restyling")


@torch.no_grad()
def test_many_styles_are_one_batch(composition: Composition) -> None:
    """Many styles of one scene, or one style each of many scenes, give what one by one gives."""
    stylizer, scene = composition.trained, composition.scene
    embedding = composition.embed(stylizer, *TEXTS)
    for what, scenes in (("two styles of one scene", scene), ("two scenes", scene.expand(2))):
        together = stylizer.restyle(scenes, embedding)
        for row in range(2):
            alone = stylizer.restyle(scene, embedding.row(row))
            asserts.close(together.row(row), alone, f"style {row} of {what} against the same alone")


@torch.no_grad()
def test_weights_can_be_loaded(composition: Composition) -> None:
    """The state dict names every chosen site, and a new branch that loads it gives the same bits."""
    state = composition.trained.branch.state_dict()
    for site in composition.sites:
        assert any(key.startswith(f"injectors.{site.name}.") for key in state), f"no weights name the site {site.name}"
    fresh = composition.stylizer(ATTRIBUTES, seed=1)
    load_strictly(fresh.branch, state, source="a trained branch")
    embedding = composition.embed(fresh, TEXTS[0])
    ours, theirs = (each.restyle(composition.scene, embedding) for each in (fresh, composition.trained))
    asserts.same(ours, theirs, "Gaussians after loading the weights into a new branch")
