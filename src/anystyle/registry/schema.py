"""A constructor's signature as a configuration schema."""

import contextlib
import copy
import functools
import inspect
import math
import re
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, make_dataclass
from enum import Enum
from pathlib import Path
from typing import Annotated, Any

import msgspec

from anystyle.errors import UserError, one_line
from anystyle.io.documents import mapped
from anystyle.registry.catalog import Plugin, PluginError, base_of

if typing.TYPE_CHECKING:
    from omegaconf import DictConfig

_PLAIN = (int, float, bool, str)
_SEQUENCES = (list, tuple, Sequence)
_kept = functools.lru_cache(maxsize=512)
"""Of what follows from a class and its constructor: a sweep, and a process with many, describes each plugin once."""


class _Choice(Enum):
    """The values of a ``Literal``; what Hydra read as a number may stand for the text of it."""

    @classmethod
    def _missing_(cls, value: object) -> "_Choice | None":
        return cls.__members__.get(str(value))


@dataclass(frozen=True)
class Option:
    """One constructor argument that a configuration may set, its annotation evaluated, its default or ``empty``."""

    name: str
    hint: Any
    default: Any = inspect.Parameter.empty

    @property
    def required(self) -> bool:
        """Whether a configuration has to give it."""
        return self.default is inspect.Parameter.empty


def _constructor(plugin: Plugin) -> tuple[list[inspect.Parameter], dict[str, Any]]:
    """Parameters and evaluated annotations of a plugin's own constructor; none where it only inherits one."""
    cls = plugin.load()
    return ([], {}) if cls.__init__ is base_of(plugin.kind).__init__ else _signature(plugin, cls.__init__)


@_kept
def _signature(plugin: Plugin, constructor: Callable[..., None]) -> tuple[list[inspect.Parameter], dict[str, Any]]:
    parameters = list(inspect.signature(constructor).parameters.values())[1:]
    try:
        hints = typing.get_type_hints(constructor, include_extras=True)
    except Exception as error:
        raise PluginError(f"{plugin} has an annotation that cannot be evaluated: {one_line(error)}") from error
    return parameters, hints


def options(plugin: Plugin) -> tuple[Option, ...]:
    """What a configuration may set of a plugin, in the order of the signature."""
    parameters, hints = _constructor(plugin)
    runtime = base_of(plugin.kind).runtime
    known: list[Option] = []
    for parameter in parameters:
        name = parameter.name
        if parameter.kind in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL, parameter.POSITIONAL_ONLY):
            remedy = "name and annotate every option so that a config can be checked"
            raise PluginError(f"{plugin} takes '{parameter}'; {remedy}")
        if name not in runtime and name not in hints:
            remedy = f"give it a type, as in '{name}: int = 2', by which a config is checked"
            raise PluginError(f"{plugin} does not annotate '{name}'; {remedy}")
        if name not in runtime:
            known.append(Option(name, hints[name], parameter.default))
    return tuple(known)


def runtime_arguments(plugin: Plugin) -> dict[str, bool]:
    """The runtime arguments of its kind that a plugin's constructor names, and whether it requires each."""
    parameters, _ = _constructor(plugin)
    runtime = base_of(plugin.kind).runtime
    return {item.name: item.default is item.empty for item in parameters if item.name in runtime}


def node(plugin: Plugin) -> "DictConfig":
    """A typed configuration node with a plugin's options and defaults, and its class as ``_target_``."""
    cls = plugin.load()
    return copy.deepcopy(_prototype(plugin, cls, cls.__init__))


@_kept
def _prototype(plugin: Plugin, cls: type, _: Callable[..., None]) -> "DictConfig":
    from omegaconf import MISSING, OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    known = options(plugin)
    fields: list[Any] = [("_target_", str, field(default=plugin.path))]
    try:
        for item in known:
            default = MISSING if item.required else plain(item.default)
            copied = isinstance(default, (list, dict))
            value = field(default_factory=default.copy) if copied else field(default=default)
            fields.append((item.name, option(item.hint), value))
        return OmegaConf.structured(make_dataclass(cls.__name__, fields))
    except (OmegaConfBaseException, TypeError, ValueError) as error:
        message = str(error).partition("\n")[0]
        raise PluginError(f"{plugin} has an option that a config cannot hold: {message}") from error


def option(hint: Any) -> Any:
    """The type by which OmegaConf checks an option annotated with ``hint``; ``Any`` where it cannot.

    ``int``, ``float``, ``bool``, ``str`` and paths stand for themselves, as do unions of them; sequences become lists,
    ``Literal`` of texts or of numbers an enumeration, so that an error lists the choices. The range of an
    ``Annotated[int, msgspec.Meta(ge=1)]``, such as those of :mod:`anystyle.ranges`, is checked by :func:`fitted`.
    """
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is Annotated:
        return option(arguments[0])
    if hint in _PLAIN or hint is Path:
        return hint
    if origin in (typing.Union, types.UnionType):
        inner = tuple(_bare(item) for item in arguments if item is not type(None))
        plain = all(item in _PLAIN for item in inner)
        checked = option(inner[0]) if len(inner) == 1 else typing.Union[inner] if plain else Any  # noqa: UP007
        return typing.Optional[checked] if type(None) in arguments else checked  # noqa: UP045 (of a value)
    if origin is typing.Literal:
        values = {str(value): value for value in arguments if value is not None}
        known = all(type(value) in (str, int) for value in values.values())
        choices = _Choice("Choice", values) if known else Any
        return typing.Optional[choices] if known and None in arguments else choices  # noqa: UP045
    if origin in _SEQUENCES or hint in _SEQUENCES:
        kinds = {item for item in arguments if item is not Ellipsis}
        return list[option(kinds.pop()) if len(kinds) == 1 else Any]
    if origin in (dict, Mapping) and arguments[0] in _PLAIN:
        return dict[arguments[0], option(arguments[1])]
    return Any


def _bare(hint: Any) -> Any:
    return typing.get_args(hint)[0] if typing.get_origin(hint) is Annotated else hint


def literal(text: str) -> str:
    """A text as a configuration holds it: ``${`` escaped, for it would be read as an interpolation."""
    return re.sub(r"(\\*)\$\{", lambda match: match[1] * 2 + r"\${", text)


def plain(value: Any) -> Any:
    """A Python value as a configuration holds it: sequences as lists, texts as :func:`literal`."""
    return mapped(value, lambda item: literal(item) if isinstance(item, str) else item)


def fitted(value: Any, hint: Any) -> Any:
    """A checked value as a constructor expects it: sequences as tuples unless ``hint`` says list, choices as given.

    Raises:
        ValueError: A number is out of its range, or a tuple has another length.
    """
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if isinstance(value, Enum):
        return value.value
    if origin is Annotated:
        check(value, hint)
        return fitted(value, arguments[0])
    if origin in (typing.Union, types.UnionType):
        inner = [item for item in arguments if item is not type(None)]
        sequences = [item for item in inner if typing.get_origin(item) in _SEQUENCES]
        same = [item for item in inner if _bare(item) is type(value)]
        best = inner if len(inner) == 1 else sequences[:1] if isinstance(value, list) else same
        return fitted(value, best[0]) if best and value is not None else value
    if isinstance(value, dict) and arguments:
        return {key: fitted(item, arguments[-1]) for key, item in value.items()}
    if not isinstance(value, list):
        return value
    hints = [arguments[0] if arguments else Any] * len(value)
    if origin is tuple and arguments[-1] is not Ellipsis:
        hints = arguments
        if len(value) != len(hints):
            raise ValueError(f"{len(hints)} values are expected, and {len(value)} are given: {value}")
    items = map(fitted, value, hints)
    return list(items) if list in (origin, hint) else tuple(items)


def check(value: Any, hint: Any) -> None:
    """Refuse a value of another type than ``hint``, out of its range, or not finite where there is a range.

    The ValueError says what is expected, and the ``description`` of a range if it has one.
    """
    with contextlib.suppress(msgspec.ValidationError):
        msgspec.convert(value, hint)
        if not isinstance(value, float) or math.isfinite(value):
            return
    remedies = [f"; {meta.description}" for meta in _metas(hint) if meta.description]
    raise ValueError(f"expected {shown(hint)}{''.join(remedies)}")


def check_fields(options: Any, group: str) -> None:
    """Refuse fields of a dataclass of options out of the range of their annotations; the UserError names them."""
    for name, hint in typing.get_type_hints(type(options), include_extras=True).items():
        value = getattr(options, name)
        try:
            fitted(value, hint)
        except ValueError as error:
            raise UserError(f"{group}.{name}={value}: {error}") from None


def _metas(hint: Any) -> list[msgspec.Meta]:
    own = [hint] if isinstance(hint, msgspec.Meta) else []
    return own + [meta for part in typing.get_args(hint) for meta in _metas(part)]


def shown(hint: Any) -> str:
    """An annotation as a reader would write it: ``int >= 1``, ``0 <= float <= 1 | None``."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is Annotated:
        name, meta = shown(arguments[0]), next(iter(_metas(hint)), msgspec.Meta())
        low = [f"{bound} {sign}" for bound, sign in ((meta.ge, "<="), (meta.gt, "<")) if bound is not None]
        high = [f"{sign} {bound}" for bound, sign in ((meta.le, "<="), (meta.lt, "<")) if bound is not None]
        if low and not high:
            bound, sign = low[0].split()
            return f"{name} {sign.replace('<', '>')} {bound}"
        return " ".join([*low, name, *high])
    if origin in (typing.Union, types.UnionType):
        return " | ".join(map(shown, arguments))
    if origin is typing.Literal:
        return " | ".join(map(repr, arguments))
    if arguments and isinstance(origin, type):
        return f"{origin.__name__}[{', '.join(map(shown, arguments))}]"
    if hint is Ellipsis:
        return "..."
    return "None" if hint is type(None) else getattr(hint, "__name__", str(hint))
