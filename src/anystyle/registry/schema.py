"""A constructor's signature as a configuration schema."""

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
from anystyle.registry.catalog import Plugin, PluginError, base_of, kind_named

if typing.TYPE_CHECKING:
    from omegaconf import DictConfig

REQUIRED: Any = inspect.Parameter.empty
_PLAIN = (int, float, bool, str)
_SEQUENCES = (list, tuple, Sequence)
_MAPPINGS = (dict, Mapping)


_kept = functools.lru_cache(maxsize=512)
"""Of what follows from a class and its constructor: a sweep, and a process with many, describes each plugin once."""


class _Choice(Enum):
    """The values of a ``Literal``; what Hydra read as a number may stand for the text of it."""

    @classmethod
    def _missing_(cls, value: object) -> "_Choice | None":
        return cls.__members__.get(str(value))


@dataclass(frozen=True)
class Option:
    """One constructor argument that a configuration may set.

    Args:
        name: As in the signature.
        hint: The annotation, evaluated.
        default: The value where it is not set; ``REQUIRED`` where there is none.
    """

    name: str
    hint: Any
    default: Any = REQUIRED

    @property
    def required(self) -> bool:
        """Whether a configuration has to give it."""
        return self.default is REQUIRED


def _constructor(plugin: Plugin) -> tuple[list[inspect.Parameter], dict[str, Any]]:
    """Parameters and evaluated annotations of a plugin's own constructor; none where it only inherits one."""
    cls = plugin.load()
    if cls.__init__ is base_of(plugin.kind).__init__:
        return [], {}
    return _signature(plugin, cls.__init__)


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
    runtime = kind_named(plugin.kind).runtime
    known: list[Option] = []
    for parameter in parameters:
        if parameter.kind in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL, parameter.POSITIONAL_ONLY):
            raise PluginError(
                f"{plugin} takes '{parameter}'; name and annotate every option so that a config can be checked"
            )
        if parameter.name in runtime:
            continue
        if parameter.annotation is parameter.empty:
            raise PluginError(
                f"{plugin} does not annotate '{parameter.name}'; give it a type, as in '{parameter.name}: int = 2', by "
                "which a config is checked"
            )
        known.append(Option(parameter.name, hints[parameter.name], parameter.default))
    return tuple(known)


def runtime_arguments(plugin: Plugin) -> dict[str, bool]:
    """The runtime arguments of its kind that a plugin's constructor names, and whether it requires each."""
    parameters, _ = _constructor(plugin)
    runtime = kind_named(plugin.kind).runtime
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
            fields.append((item.name, option(item.hint), _field(default)))
        return OmegaConf.structured(make_dataclass(cls.__name__, fields))
    except (OmegaConfBaseException, TypeError, ValueError) as error:
        message = str(error).partition("\n")[0]
        raise PluginError(f"{plugin} has an option that a config cannot hold: {message}") from error


def _field(default: Any) -> Any:
    if isinstance(default, (list, dict)):
        return field(default_factory=default.copy)
    return field(default=default)


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
        inner = tuple(item for item in arguments if item is not type(None))
        optional = len(inner) < len(arguments)
        checked = option(inner[0]) if len(inner) == 1 else _union(inner)
        return typing.Optional[checked] if optional else checked  # noqa: UP045 (of a value)
    if origin is typing.Literal:
        return _choices(arguments)
    if origin in _SEQUENCES or hint in _SEQUENCES:
        return list[_element(arguments)]
    if origin in _MAPPINGS and arguments[0] in _PLAIN:
        return dict[arguments[0], option(arguments[1])]
    return Any


def _union(members: tuple[Any, ...]) -> Any:
    bare = tuple(map(_bare, members))
    return typing.Union[bare] if all(item in _PLAIN for item in bare) else Any  # noqa: UP007 (of a value)


def _bare(hint: Any) -> Any:
    return typing.get_args(hint)[0] if typing.get_origin(hint) is Annotated else hint


def _element(arguments: tuple[Any, ...]) -> Any:
    kinds = {item for item in arguments if item is not Ellipsis}
    return option(kinds.pop()) if len(kinds) == 1 else Any


def _choices(values: tuple[Any, ...]) -> Any:
    inner = tuple(value for value in values if value is not None)
    if not all(type(value) in (str, int) for value in inner):
        return Any
    enumeration = _Choice("Choice", {str(value): value for value in inner})
    return typing.Optional[enumeration] if len(inner) < len(values) else enumeration  # noqa: UP045


def literal(text: str) -> str:
    """A text as a configuration holds it: ``${`` escaped, for it would be read as an interpolation."""
    return re.sub(r"(\\*)\$\{", lambda match: match[1] * 2 + r"\${", text)


def plain(value: Any) -> Any:
    """A Python value as a configuration holds it: sequences as lists, texts as :func:`literal`."""
    if isinstance(value, str):
        return literal(value)
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    return value


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
        if value is None:
            return None
        inner = [item for item in arguments if item is not type(None)]
        sequences = [item for item in inner if typing.get_origin(item) in _SEQUENCES]
        same = [item for item in inner if _bare(item) is type(value)]
        best = inner if len(inner) == 1 else sequences[:1] if isinstance(value, list) else same
        return fitted(value, best[0]) if best else value
    if isinstance(value, list):
        return _fitted_sequence(value, origin or hint, arguments)
    if isinstance(value, dict) and arguments:
        return {key: fitted(item, arguments[-1]) for key, item in value.items()}
    return value


def _fitted_sequence(value: list[Any], origin: Any, arguments: tuple[Any, ...]) -> Any:
    if origin is tuple and arguments and arguments[-1] is not Ellipsis:
        if len(value) != len(arguments):
            raise ValueError(f"{len(arguments)} values are expected, and {len(value)} are given: {value}")
        return tuple(fitted(item, hint) for item, hint in zip(value, arguments, strict=True))
    items = [fitted(item, arguments[0] if arguments else Any) for item in value]
    return items if origin is list else tuple(items)


def check(value: Any, hint: Any) -> None:
    """Refuse a value of another type than ``hint``, out of its range, or not finite where there is a range.

    Raises:
        ValueError: It says what is expected, and the ``description`` of a range if it has one.
    """
    try:
        msgspec.convert(value, hint)
        valid = not isinstance(value, float) or math.isfinite(value)
    except msgspec.ValidationError:
        valid = False
    if not valid:
        remedies = [f"; {meta.description}" for meta in _metas(hint) if meta.description]
        raise ValueError(f"expected {shown(hint)}{''.join(remedies)}")


def check_fields(options: Any, group: str) -> None:
    """Refuse fields of a dataclass of options that are out of the range of their annotations.

    Raises:
        UserError: It names the option as ``group.field``.
    """
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
