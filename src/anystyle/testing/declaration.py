"""What plugins of every kind promise: that it can be listed, and its options checked."""

from omegaconf import OmegaConf

from anystyle.registry.catalog import Plugin, base_of, catalog
from anystyle.registry.schema import node, plain
from anystyle.testing.subject import Subject


def test_options_can_be_checked(plugin: Subject) -> None:
    """It implements every method, its options have types and defaults, and ``example`` returns options of these."""
    missing = sorted(getattr(plugin.cls, "__abstractmethods__", ()))
    assert not missing, f"{plugin.cls.__name__} lacks {', '.join(missing)}"
    module, cls = plugin.cls.__module__, plugin.cls
    name = catalog().name_of(plugin.kind, cls)
    row = Plugin(plugin.kind, name, f"{module}:{cls.__qualname__}", module, defined=cls)
    OmegaConf.merge(node(row), plain(dict(plugin.options)))


def test_first_line_describes_it(plugin: Subject) -> None:
    """The class has a docstring of its own, whose first line `anystyle plugins` shows."""
    text = plugin.cls.__doc__ or ""
    own = bool(text.strip()) and text != (base_of(plugin.kind).__doc__ or "")
    assert own, f"{plugin.cls.__name__} without a docstring"
