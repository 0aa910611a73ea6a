"""A signature becomes a schema, and a node becomes an object."""

import math
import re
from collections.abc import Mapping
from typing import Annotated, Literal

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from anystyle.contracts import Injector, Placement, Renderer
from anystyle.errors import UserError
from anystyle.ranges import AtLeastOne, Fraction, Range
from anystyle.registry.build import build, build_all, plugin_of
from anystyle.registry.catalog import PluginError, base_of, catalog
from anystyle.registry.schema import literal, node, options, shown

EVERYTHING = """
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal
from anystyle.contracts import Placement
from anystyle.ranges import AtLeastOne, Fraction, Positive

class Everything(Placement):
    def __init__(
        self,
        *,
        whole: int = 2,
        real: float = 1,
        yes: bool = True,
        word: str = "a, b = 'c' ${x}",
        folder: Path | None = None,
        maybe: int | None = None,
        either: int | str = "x",
        several: Sequence[int] = (1, 2),
        kept: list[str] = ["a"],
        three: tuple[float, float, float] = (1.0, 1.0, 1.0),
        grid: tuple[tuple[int, int], ...] = ((1, 2), (3, 4)),
        some: Sequence[int] | None = None,
        one_or_more: int | Sequence[int] = 1,
        choice: Literal["sdpa", "math"] = "sdpa",
        bits: Literal["16", "32"] = "16",
        number: Literal[0, 1, 2] = 0,
        choices: tuple[Literal["a", "b"], ...] = ("a",),
        choice_or_none: Literal["a", None] = None,
        weights: Mapping[str, float] = {"a": 1.0},
        anything: Any = None,
        counted: AtLeastOne | None = None,
        count_or_word: AtLeastOne | str = "auto",
        pair: tuple[Fraction, Fraction] = (0.0, 1.0),
        levels: Sequence[AtLeastOne] = (1,),
        rates: Mapping[str, Positive] = {"a": 1.0},
    ) -> None:
        self.given = {name: value for name, value in locals().items() if name not in ("self", "__class__")}

    def select(self, sites):
        return tuple(sites)
"""


@pytest.fixture
def everything(plugin_folder):
    plugin_folder(EVERYTHING, everything="Everything")
    return catalog().find("placement", "everything")


def test_defaults_arrive_as_the_constructor_has_them(everything):
    config = OmegaConf.create({"word": "unrelated", "placement": {}})
    config.placement = node(everything)
    built = build(Placement, {"_target_": everything.path})
    plainly = everything.load()().given
    assert {**built.given, "kept": tuple(built.given["kept"])} == {**plainly, "kept": tuple(plainly["kept"])}
    assert isinstance(built.given["kept"], list) and isinstance(built.given["real"], float)
    for name in ("several", "three", "choices"):
        assert type(built.given[name]) is tuple
    assert built.given["grid"] == ((1, 2), (3, 4))


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("whole", "7", 7),
        ("real", 3, 3.0),
        ("word", 12, "12"),
        ("word", r"\\\${x} \${y}", r"\${x} ${y}"),
        ("maybe", None, None),
        ("either", 3, 3),
        ("several", [4], (4,)),
        ("three", [0, 0.5, 1], (0.0, 0.5, 1.0)),
        ("grid", [[5, 6]], ((5, 6),)),
        ("some", [1], (1,)),
        ("one_or_more", [1, 2], (1, 2)),
        ("choice", "math", "math"),
        ("bits", 32, "32"),
        ("number", 2, 2),
        ("choices", ["b", "a"], ("b", "a")),
        ("choice_or_none", "a", "a"),
        ("weights", {"b": 2}, {"a": 1.0, "b": 2.0}),
        ("anything", [{"x": 1}], ({"x": 1},)),
        ("counted", 3, 3),
        ("count_or_word", 3, 3),
        ("count_or_word", "all", "all"),
        ("pair", [0.5, 1], (0.5, 1.0)),
        ("levels", [1, 2], (1, 2)),
    ],
)
def test_values_are_converted(everything, name, value, expected):
    config = node(everything)
    OmegaConf.update(config, name, value)
    literally = expected if name == "word" else value
    for source in (config, {"_target_": everything.path, name: literally}):
        result = build(Placement, source).given[name]
        assert result == expected and type(result) is type(expected)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("whole", "deep", "Value 'deep' of type 'str' could not be converted to Integer"),
        ("whole", 1.5, "could not be converted to Integer"),
        ("whole", None, "field 'whole' is not Optional"),
        ("yes", "perhaps", "not a valid bool"),
        ("choice", "maths", r"Invalid value 'maths', expected one of [sdpa, math]"),
        ("number", 7, "expected one of [0, 1, 2]"),
        ("choices", ["c"], "Invalid value 'c', expected one of [a, b]"),
        ("several", ["x"], "could not be converted to Integer"),
    ],
)
def test_wrong_values_are_refused_at_composition_and_by_build(everything, name, value, message):
    with pytest.raises(OmegaConfBaseException, match=re.escape(message)):
        OmegaConf.update(node(everything), name, value)
    with pytest.raises(ValueError, match=re.escape(message)) as caught:
        build(Placement, {"_target_": everything.path, name: value})
    assert str(caught.value).startswith(f"placement.{name}={value}: ")
    assert str(caught.value).endswith("; see anystyle plugins placement everything") and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("counted", 0, "expected int >= 1"),
        ("count_or_word", 0, "expected int >= 1"),
        ("pair", [0.5, 1.5], "expected 0 <= float <= 1"),
        ("levels", [2, 0], "expected int >= 1"),
        ("rates", {"b": 0.0}, "expected float > 0"),
        ("rates", {"b": math.inf}, "expected float > 0"),
        ("three", [1, 2], "3 values are expected, and 2 are given: [1.0, 2.0]"),
    ],
)
def test_numbers_out_of_range_are_refused_under_the_name_that_a_user_typed(everything, name, value, expected):
    with pytest.raises(UserError, match=re.escape(f"placement.{name}={value}: {expected}; see")):
        build(Placement, {"_target_": everything.path, name: value})
    config = OmegaConf.create({"inner": {"_target_": everything.path, name: value}})
    with pytest.raises(UserError, match=re.escape(f"inner.{name}=")):
        build(Placement, config.inner)


@pytest.mark.parametrize(
    ("named", "value"),
    [
        ("injector lora rank", 0),
        ("injector cross_attention num_tokens", 1),
        ("loss clip_patch distortion", 1.5),
        ("metric kid size", 74),
        ("metric psnr most", 0.0),
        ("correspondence rendered_depth tolerance", -1.0),
        ("method branch coverage", 0.0),
        ("renderer torch near", 0.0),
        ("protocol paper frames", 0),
        ("protocol paper num_styles", 0),
        ("styles folder size", 0),
        ("training stylization betas", [0.9, 1.0]),
    ],
)
def test_ranges_of_the_core(named, value):
    kind, name, option = named.split()
    with pytest.raises(UserError, match=re.escape(f".{option}={value}: expected ")):
        plugin_of(base_of(kind), {"_target_": catalog().find(kind, name).path, option: value})


@pytest.mark.parametrize(
    ("hint", "text"),
    [
        (AtLeastOne | None, "int >= 1 | None"),
        (Annotated[float, Range(gt=0, lt=1)], "0 < float < 1"),
        (tuple[Fraction, ...], "tuple[0 <= float <= 1, ...]"),
        (Annotated[int, Range(le=4)], "int <= 4"),
        (Mapping[str, Literal["a", 2]], "Mapping[str, 'a' | 2]"),
    ],
)
def test_types_are_shown_as_a_reader_writes_them(hint, text):
    assert shown(hint) == text


def test_unknown_option(everything):
    with pytest.raises(OmegaConfBaseException, match="Key 'wohle' not in 'Everything'"):
        OmegaConf.update(node(everything), "wohle", 3)
    with pytest.raises(ValueError, match=r"has no option 'wohle'\. Did you mean 'whole'\?"):
        build(Placement, {"_target_": everything.path, "wohle": 3})


@given(st.text(alphabet=st.sampled_from("a\\${}:\n'\",=x ")))
def test_literal_texts_survive(text):
    assume(text != "???")
    assert OmegaConf.create({"x": literal(text)}).x == text


def test_interpolations_are_resolved_in_the_whole_configuration(everything):
    config = OmegaConf.create({"size": 5, "placement": {}})
    config.placement = node(everything)
    config.placement.whole = "${size}"
    assert build(Placement, config.placement).given["whole"] == 5


@pytest.mark.parametrize(
    ("signature", "message"),
    [
        ("self, **kw", r"takes '\*\*kw'; name and annotate every option"),
        ("self, *args: int", r"takes '\*args: int'"),
        ("self, x: int, /", "takes 'x: int'"),
        ("self, *, depth=3", "does not annotate 'depth'"),
        ("self, *, depth: 'Nowhere' = 3", "annotation that cannot be evaluated: name 'Nowhere'"),
        ("self, *, depth: int = 'deep'", "option that a config cannot hold: Value 'deep'"),
        ("self, *, what: object = object()", "option that a config cannot hold"),
    ],
)
def test_signatures_that_are_no_schema(plugin_folder, signature, message):
    body = f"    def __init__({signature}): pass\n    def select(self, sites): return tuple(sites)\n"
    plugin_folder(f"from anystyle.contracts import Placement\nclass Bad(Placement):\n{body}", bad="Bad")
    with pytest.raises(PluginError, match=message):
        node(catalog().find("placement", "bad"))


def test_required_option(plugin_folder):
    code = """
    from anystyle.contracts import Placement
    class Needs(Placement):
        def __init__(self, *, root: str) -> None:
            self.root = root
        def select(self, sites):
            return tuple(sites)
    """
    plugin_folder(code, needs="Needs")
    row = catalog().find("placement", "needs")
    assert OmegaConf.is_missing(node(row), "root")
    with pytest.raises(ValueError, match=r"placement\.root=.*: it has no default; give it one"):
        build(Placement, node(row))
    assert build(Placement, {"_target_": row.path, "root": "here"}).root == "here"


def test_runtime_arguments(plugin_folder):
    code = """
    from torch import nn
    from anystyle.contracts import Injector
    class Plain(Injector):
        def __init__(self, dim: int, style_dim: int, *, rank: int = 4) -> None:
            super().__init__()
            self.sizes = dim, style_dim, rank
        def forward(self, tokens, style):
            return tokens
    class NoStyle(Injector):
        def __init__(self, dim: int) -> None:
            super().__init__()
            self.sizes = (dim,)
        def forward(self, tokens, style):
            return tokens
    class Inherits(Injector):
        def forward(self, tokens, style):
            return tokens
    """
    plugin_folder(code, "injector", plain="Plain", no_style="NoStyle", inherits="Inherits")
    plain = catalog().find("injector", "plain")
    assert [item.name for item in options(plain)] == ["rank"]
    assert build(Injector, node(plain), dim=8, style_dim=2).sizes == (8, 2, 4)
    assert build(Injector, "no_style", dim=8, style_dim=2).sizes == (8,)
    assert isinstance(build(Injector, "inherits", dim=8, style_dim=2), Injector)
    with pytest.raises(PluginError, match="needs 'style_dim', which is not available here"):
        build(Injector, node(plain), dim=8)
    with pytest.raises(AssertionError, match="'dims' is not a runtime argument of a injector"):
        build(Injector, node(plain), dims=8)


def test_a_configuration_builds_only_what_the_catalog_lists():
    for target in ("os.system", "subprocess.Popen", "anystyle.placements.os", None):
        with pytest.raises(PluginError, match="is not a plugin"):
            build(Placement, {"_target_": target})
    with pytest.raises(PluginError, match="is a placement, and a renderer is expected"):
        build(Renderer, {"_target_": "anystyle.placements.Head"})
    with pytest.raises(PluginError, match="is not the contract of any kind"):
        build(int, {"_target_": "builtins.int"})


def test_build_all_keeps_names(everything):
    one = {"_target_": everything.path, "whole": 1}
    built = build_all(Placement, {"a": one, "b": {**one, "whole": 2}})
    assert {name: item.given["whole"] for name, item in built.items()} == {"a": 1, "b": 2}
    assert build_all(Placement, None) == {}
    with pytest.raises(ValueError, match="expected the options of a plugin with its _target_, and got 3"):
        build_all(Placement, {"a": 3})
