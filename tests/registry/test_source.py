"""The catalog seen through Hydra."""

from itertools import count

import pytest
from hydra import compose, initialize_config_dir
from hydra.core.object_type import ObjectType
from hydra.errors import HydraException
from omegaconf import OmegaConf

from anystyle.contracts import Placement
from anystyle.errors import UserError
from anystyle.registry.build import build
from anystyle.registry.builtin import KINDS
from anystyle.registry.catalog import catalog
from anystyle.registry.compose import VERSION_BASE, choices
from anystyle.registry.compose import compose as compose_words
from anystyle.registry.packages import arguments, groups
from anystyle.registry.source import PluginSource, register
from anystyle.registry.untrusted import check_saved

PLACEMENTS = """
from typing import Literal
from anystyle.contracts import Placement
class Deep(Placement):
    def __init__(self, *, depth: int = 2, attention: Literal["sdpa", "math"] = "sdpa") -> None:
        self.depth, self.attention = depth, attention
    def select(self, sites):
        return tuple(sites)
"""
LOSSES = """
from anystyle.contracts import Loss
class One(Loss):
    def __init__(self, *, weight: float = 1.0, layers: tuple[int, ...] = (1, 2)) -> None:
        super().__init__()
        self.weight, self.layers = weight, layers
    def forward(self, result):
        return result.renders.color.mean()
class Two(One):
    pass
"""


@pytest.fixture
def composed(plugin_folder, tmp_path):
    """Compose a configuration of a made-up project: ``composed("placement=deep", ...)``."""
    plugin_folder(PLACEMENTS, deep="Deep")
    plugin_folder(LOSSES, "loss", one="One", two="Two")
    conf = tmp_path / "conf"
    (conf / "placement").mkdir(parents=True)
    (conf / "loss").mkdir()
    (conf / "config.yaml").write_text(
        "defaults: [{placement: deep}, {loss: [one]}, _self_]\nhydra: {searchpath: ['anystyle://']}\nseed: 0\n"
    )
    (conf / "placement" / "deeper.yaml").write_text("defaults: [deep, _self_]\ndepth: 9\n")
    (conf / "placement" / "typo.yaml").write_text("defaults: [deep, _self_]\ndpeth: 9\n")
    (conf / "loss" / "light.yaml").write_text("# @package loss.light\ndefaults: [one@_here_, _self_]\nweight: 0.5\n")
    register()
    register()

    def run(*overrides: str):
        with initialize_config_dir(str(conf), **VERSION_BASE):
            return compose("config", overrides=list(overrides))

    return run


def test_defaults_and_overrides(composed):
    assert composed().placement.depth == 2
    built = build(Placement, composed("placement.depth=3", "placement.attention=math").placement)
    assert (built.depth, built.attention) == (3, "math")
    assert composed("placement=head").placement._target_ == "anystyle.placements.Head"
    assert build(Placement, composed("placement=deeper", "placement.attention=math").placement).depth == 9


def test_many_stand_side_by_side(composed):
    config = composed("loss=[one,two]", "loss.two.weight=2")
    assert {name: loss.weight for name, loss in config.loss.items()} == {"one": 1.0, "two": 2.0}
    config = composed("loss=[one,light]", "loss.one.layers=[3]")
    assert (config.loss.light.weight, config.loss.one.layers) == (0.5, [3])
    assert config.loss.light._target_ == config.loss.one._target_


@pytest.mark.parametrize(
    ("saved", "message"),
    [
        ({"branch": {"_target_": "os.system"}}, r"file: branch\._target_ is 'os\.system', which is not a registered"),
        ({"placement": {"_target_": "anystyle.placements.AggregatorX"}}, "not a registered plugin"),
        ({"branch": [{"sh_degree": "${oc.env:HOME}"}]}, r"file: branch\.0\.sh_degree is .* no interpolations"),
    ],
)
def test_a_saved_configuration_is_checked_before_anything_is_built(saved, message):
    check_saved({"placement": {"_target_": catalog().find("placement", "head").path}, "branch": [1, "a"]}, "file")
    with pytest.raises(UserError, match=message):
        check_saved(saved, "file")


def test_source_lists_the_catalog(composed):
    source = PluginSource("test", "anystyle://")
    assert source.available() and source.list("", None) == source.list("", ObjectType.GROUP) == sorted(groups())
    assert set(KINDS) < set(groups())
    assert source.list("", ObjectType.CONFIG) == []
    assert set(catalog().names("placement")) <= set(source.list("placement", ObjectType.CONFIG))
    assert {*catalog().names("styles"), "procedural_112"} <= set(source.list("styles", ObjectType.CONFIG))
    assert source.list("placement", ObjectType.GROUP) == []
    assert source.is_group("loss") and not source.is_group("lost") and not source.is_group("loss/one")
    assert source.is_config("loss/one") and source.is_config("loss/one.yaml") and not source.is_config("loss")


@pytest.fixture
def package(plugin_folder):
    """A plugin package with a preset beside its module: ``package("placement/shallow.yaml", text)``."""
    numbers = count()

    def make(path: str, text: str) -> None:
        file = plugin_folder(PLACEMENTS, **{f"of_package_{next(numbers)}": "Deep"}) / "conf" / path
        file.parent.mkdir(parents=True)
        file.write_text(text)

    return make


def test_packages_serve_presets(composed, package):
    package("placement/shallow.yaml", "# One layer.\ndefaults: [deep, _self_]\ndepth: 1\n")
    assert build(Placement, composed("placement=shallow", "placement.attention=math").placement).depth == 1
    assert "shallow" in choices("placement") and "shallow" in PluginSource("x", "anystyle://").list("placement", None)


def test_a_preset_of_a_package_may_be_global_and_start_a_group(composed, package):
    package("flavour/sweet.yaml", "# @package _global_\ndefaults: [{override /placement: deeper}]\nseed: 7\n")
    config = composed("+flavour=sweet")
    assert (config.seed, config.placement.depth) == (7, 9)
    assert "flavour" in groups()


def test_a_preset_of_two_packages_is_refused_when_chosen(composed, package):
    for depth in (1, 2):
        package("placement/shallow.yaml", f"defaults: [deep, _self_]\ndepth: {depth}\n")
    with pytest.raises(HydraException, match="placement=shallow is declared more than once"):
        composed("placement=shallow")


def test_two_plugins_of_a_name_are_in_the_way_of_no_other(plugin_folder):
    for _ in range(2):
        plugin_folder(LOSSES, "loss", twin="One")
    assert "content" in compose_words("train", ["experiment=tiny_ablation", "loss=[content]"]).loss


def test_composed_configurations_can_be_written(composed):
    text = OmegaConf.to_yaml(composed("placement.attention=math"))
    assert "attention: math" in text
    assert build(Placement, OmegaConf.create(text).placement).attention == "math"


@pytest.mark.parametrize(
    ("kind", "name", "option", "known"),
    [
        ("protocol", "captures", "quality", "Literal['draft', 'good', 'best', 'full']"),
        ("backbone", "stylos", "style_order", "Literal['global', 'frame', 'hybrid']"),
        ("loss", "depth_consistency", "reference", "Literal['photograph', 'render']"),
    ],
)
def test_types_that_another_module_names_are_read_from_sources(kind, name, option, known):
    assert (arguments(catalog().find(kind, name)) or {})[option] == known


def test_a_module_with_a_mistake_among_those_that_are_imported_hinders_no_listing(plugin_folder):
    folder = plugin_folder(PLACEMENTS.replace("from typing import Literal", "from broken import Literal"), wrong="Deep")
    (folder / "broken.py").write_text("def (")
    assert (arguments(catalog().find("placement", "wrong")) or {})["depth"] == "int"
