"""Building plugins from configuration nodes; only classes of the catalog are built."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar

from anystyle.errors import UserError, did_you_mean
from anystyle.registry.builtin import KINDS
from anystyle.registry.catalog import Plugin, PluginError, base_of, catalog
from anystyle.registry.schema import fitted, node, options, plain, runtime_arguments

if TYPE_CHECKING:
    from omegaconf import DictConfig

T = TypeVar("T")


def kind_of(base: type) -> str:
    """The kind of plugin whose contract a class is."""
    name = f"{base.__module__}:{base.__qualname__}"
    known = {target: kind for kind, target in KINDS.items()}
    known |= {row.target: row.name for row in catalog() if row.kind == "kind"}
    if name not in known:
        raise PluginError(f"{name} is not the contract of any kind of plugin")
    return known[name]


def build(base: type[T], config: "DictConfig | Mapping[str, Any] | str", /, **runtime: Any) -> T:
    """Construct the plugin that a configuration node describes.

    Every value is checked against the constructor's signature, whether or not the node was composed by Hydra; the
    constructor receives plain Python values.

    Args:
        base: The contract that the plugin fulfils, such as :class:`anystyle.contracts.Backbone`.
        config: A node with the plugin's class as ``_target_``; or a plugin's name, for its defaults.
        runtime: What the framework injects by name; a constructor that does not name it does not get it.

    Raises:
        PluginError: The catalog does not list the class, or the plugin is broken.
        UserError: An option is unknown, missing or of the wrong type, or the constructor refuses it.

    Example:
        >>> from anystyle.contracts import Loss
        >>> build(Loss, "depth_consistency").weight
        0.1
        >>> build(Loss, {"_target_": "anystyle.losses.depth_consistency.DepthConsistency", "weight": 0.5}).weight
        0.5
    """
    kind = kind_of(base)
    strange = [name for name in runtime if name not in base_of(kind).runtime]
    assert not strange, f"{strange[0]!r} is not a runtime argument of a {kind}"
    plugin, values = plugin_of(base, config)
    named = runtime_arguments(plugin)
    for name, required in named.items():
        if required and name not in runtime:
            raise PluginError(f"{plugin} needs '{name}', which is not available here")
    # Checked above against the constructor itself, which the contract's signature does not show.
    constructor: Any = plugin.load()
    if missing := sorted(getattr(constructor, "__abstractmethods__", ())):
        raise PluginError(f"{plugin} lacks {', '.join(missing)}, which every {kind} has")
    return constructor(**values, **{name: runtime[name] for name in named if name in runtime})


def plugin_of(base: type, config: "DictConfig | Mapping[str, Any] | str") -> tuple[Plugin, dict[str, Any]]:
    """The plugin that a configuration node describes, and all its options as :func:`build` passes them."""
    if isinstance(config, str):
        plugin = catalog().find(kind_of(base), config)
        return plugin, _checked(plugin, {})
    given, key = _container(config)
    plugin = catalog().owner(kind_of(base), str(given.pop("_target_", None)))
    return plugin, _checked(plugin, given, key)


def choice(base: type, value: Any) -> dict[str, Any]:
    """The node of a plugin that an option names, ``film`` or ``{film: {hidden: 64}}``; checked as by :func:`build`."""
    kind, named = kind_of(base), {value: {}} if isinstance(value, str) else value
    if not isinstance(named, Mapping) or len(named) != 1 or not isinstance(next(iter(named.values())), Mapping):
        raise UserError(f"{value!r} is not one {kind}; give its name, or {{NAME: {{option: value}}}}")
    ((name, given),) = named.items()
    plugin = catalog().find(kind, name)
    _checked(plugin, given)
    return {"_target_": plugin.path, **given}


def build_all(base: type[T], configs: "Mapping[str, Any] | None", /, **runtime: Any) -> dict[str, T]:
    """Construct every plugin of a group that holds several at once, by the names the group gives them."""
    return {} if configs is None else {name: build(base, configs[name], **runtime) for name in configs}


def _container(config: Any) -> tuple[dict[str, Any], str]:
    """A node as plain Python, interpolations resolved, and where it stands in the whole configuration, if in one."""
    from omegaconf import OmegaConf

    composed = OmegaConf.is_config(config)
    container = OmegaConf.to_container(config, resolve=True, enum_to_str=True) if composed else config
    if not isinstance(container, Mapping):
        raise PluginError(f"expected the options of a plugin with its _target_, and got {container!r}")
    key = str(config._get_full_key(None) or "") if composed else ""
    return {str(name): value for name, value in container.items()}, key


def _checked(plugin: Plugin, given: Mapping[str, Any], key: str = "") -> dict[str, Any]:
    """The values of all options, as the constructor expects them; ``key`` is where a user gives them."""
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    known = options(plugin)
    names = [item.name for item in known]
    for name in given:
        if name not in names:
            raise UserError(f"{plugin} has no option '{name}'.{did_you_mean(name, names)} Options: {', '.join(names)}")
    merged = node(plugin)
    key = key or (f"{plugin.kind}.{plugin.name}" if base_of(plugin.kind).many else plugin.kind)
    values: dict[str, Any] = {}
    for item in known:
        try:
            if item.name in given:
                OmegaConf.update(merged, item.name, plain(given[item.name]))
            if OmegaConf.is_missing(merged, item.name):
                raise UserError("it has no default; give it one")
            value = merged[item.name]
            plain_value = OmegaConf.to_container(value, resolve=True) if OmegaConf.is_config(value) else value
            values[item.name] = fitted(plain_value, item.hint)
            if values[item.name] != values[item.name]:
                raise UserError("nan is not a valid value")
        except (OmegaConfBaseException, ValueError) as error:
            message, value = str(error).partition("\n")[0], given.get(item.name, "...")
            raise UserError(
                f"{key}.{item.name}={value}: {message}; see anystyle plugins {plugin.kind} {plugin.name}"
            ) from error
    return values
