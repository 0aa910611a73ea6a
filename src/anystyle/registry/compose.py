"""Composing a configuration: ``conf/`` and the catalog through Hydra's compose API, with errors in one line."""

import re
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import hydra
from hydra import compose as hydra_compose
from hydra import initialize_config_dir
from hydra.core.override_parser.types import Quote, QuotedString
from hydra.errors import HydraException, MissingConfigException, OverrideParseException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from anystyle import paths, ranges
from anystyle.errors import UserError, did_you_mean, one_line
from anystyle.registry.builtin import MANY, OPTIONS
from anystyle.registry.catalog import Plugin, catalog, kinds
from anystyle.registry.packages import arguments, groups, preset_folders, presets
from anystyle.registry.schema import literal
from anystyle.registry.source import register

VERSION_BASE: dict[str, Any] = {"version_base": "1.3"} if hydra.__version__.startswith("1.3.") else {}
"""Hydra 1.3 takes the defaults of 1.1 where it is not told otherwise; Hydra 1.4 warns where it is told."""
ERRORS = (HydraException, OmegaConfBaseException, YAMLError)
"""What Hydra and OmegaConf raise."""

UNCHOSEN = ("reconstruction",)
"""Groups of which no configuration chooses a plugin."""

_UNKNOWN = re.compile(r"In '[^']*': Could not load '(?P<group>[^']*)/(?P<name>[^'/]*)'")
"""How Hydra says that one of several choices of a group is not there; of the only choice it raises what has options."""

_DELETED = re.compile(r"Error resolving interpolation '\$\{recipe\}/\$\{(?P<group>\w+)\}'")
"""How Hydra says that a group is deleted whose choice names another, as a recipe does."""

_NULL = re.compile(r"(?P<group>\w+)(@\w+)?=null")
"""A word that sets what may be a group to nothing."""

ELSEWHERE: dict[str, dict[str, Any]] = tomllib.loads(Path(__file__).with_name("elsewhere.toml").read_text("utf-8"))
"""Words of other programs and what to write here, by the command that they are given to."""

_NUMERIC = {"int", "float", "None", "Annotated", "Optional", "Union", "ge", "le", "gt", "lt", *ranges.__all__}
"""What annotations of numbers are made of."""

_LITERAL = re.compile(r"Literal\[(.+)\]( \| None)?")
"""The annotation of a choice."""

_WORD = re.compile(r"(?!null$)[\w-]+", re.IGNORECASE)
"""A value that is one word, and no interpolation or sweep."""

_TEXT = re.compile(r"(?!(null|none|true|false|inf|nan|yes|no|on|off)$)[a-z]\w*", re.IGNORECASE)
"""A value that is no number, and in no way a sweep or an interpolation."""

_DATE = re.compile(r"(?<=[=,\[])(?!\d{1,3}(_\d{3})+\b)\d+(_\d+)+(?=[,\]]|$)")
"""A value of digits that Hydra reads as one number, 20241005 of 2024_10_05, and that is not in thousands as one is."""

_NOISE = re.compile(r"\s*(full_key:|object_type=|reference_type=|To append to your config|Search path:|See https)")


def compose(config_name: str, overrides: Sequence[str] = (), *, conf: Path | None = None) -> DictConfig:
    """Compose a configuration, as a command does: a file of ``conf``, or of the folder that comes with the package.

    The overrides are in Hydra's grammar, such as ``backbone=anysplat_tiny``; see :func:`override`.
    """
    register()
    check_words(config_name, overrides)
    try:
        with initialize_config_dir(str((conf or paths.CONF).absolute()), job_name=config_name, **VERSION_BASE):
            return hydra_compose(config_name, overrides=completed(overrides))
    except Exception as error:
        raise refused(error) from error


def options(config: DictConfig, key: str) -> Any:
    """The dataclass of options at a key of :data:`~anystyle.registry.builtin.OPTIONS`, its values checked."""
    try:
        return OmegaConf.to_object(config[key])
    except OmegaConfBaseException as error:
        raise UserError(explain(error)) from error


def only_options(key: str, words: Sequence[str]) -> Any:
    """The dataclass of options at a key for a command whose overrides can set nothing else."""
    for word in words:
        if not word.startswith(f"{key}."):
            raise UserError(f"{word}: of Hydra's overrides only {key}.OPTION=VALUE has an effect here; leave it out")
    return options(compose("stylize", words), key)


def check_words(config_name: str, words: Sequence[str]) -> None:
    """Refuse a group that is set to null, for which Hydra's own line names neither the group nor a way out.

    And options of which one is chosen as if they were a group, and with a + words that nothing here reads, which Hydra
    lets pass.
    """
    answers = ELSEWHERE["all"] | ELSEWHERE.get(config_name, {})
    for word in words:
        key, _, value = word.lstrip("+").partition("=")
        asked = f"{key}.{value.strip('[]')}."  # a key of that file may end in a value
        is_own = any(f"${{{key}}}" in other for other in words)  # training.learning_rate=${lr} reads +lr=1e-4
        for other, answer in answers.items():
            if asked.startswith(f"{other}.") and not is_own:
                raise UserError(f"{word}: {answer}")
        if key in (*OPTIONS, "weights") and key not in groups() and not value.startswith(("{", "$")):
            raise UserError(f"{word}: '{key}' has options and no choices; set one of them as {key}.OPTION=VALUE")
        if (match := _NULL.fullmatch(word)) and (group := match["group"]) in groups():
            way = f"{group}=[]" if group in (*MANY, "callbacks") else f"~{word.removesuffix('=null')}"
            remedy = f"to leave it out, write '{way}'; there are: {', '.join(choices(group))}"
            raise UserError(f"{word}: a group takes a name; {remedy}")


def idle(config: DictConfig) -> set[str]:
    """The losses that take no part: those that ``without`` names, and those of which only options are left."""
    # One name needs no brackets, so that a sweep may leave out one term per job: `without=style,content`.
    without = config.get("without") or ()
    names = {without} if isinstance(without, str) else {*without}
    return {name for name, term in (config.get("loss") or {}).items() if name in names or "_target_" not in term}


def completed(words: Sequence[str]) -> list[str]:
    """The same words with what goes without saying.

    A search path of the user's, which replaces a configuration's own, also has the plugins. A date is a text. Options
    of a group of :data:`UNCHOSEN` choose the one plugin that has them.
    """
    words = [re.sub(r"^(\+*hydra\.searchpath=\[(?!.*anystyle://).+)\]$", r"\1,anystyle://]", word) for word in words]
    words = [word if word.startswith("-") else _DATE.sub(r'"\g<0>"', word) for word in words]
    keys = [word.partition("=")[0] for word in words]
    for group in (group for group in UNCHOSEN if group not in keys):
        given = {key.split(".")[1] for key in keys if key.startswith(f"{group}.")}
        having = [name for name in catalog().names(group) if given <= {*(arguments(catalog().find(group, name)) or ())}]
        words += [f"{group}={having[0]}"] if given and len(having) == 1 else []
    return words


def check_choices(words: Sequence[str], root: Path = paths.CONF) -> None:
    """Refuse a choice that a group does not have, and a key that nothing has, before anything is imported for them.

    ``root`` holds the configurations that commands start from.
    Folders of one's own are read; where another root is given, or a package of configurations, it is left to Hydra.
    """
    words = completed(words)
    lines = "\n".join(words)
    own = [Path(each) for each in (*config_folders(words), *re.findall(r"file://([^,\]'\"\n]+)", lines))]
    other = re.search(r"(?m)^(-cp|-cn|-sc|--config-path|--config-name|--shell-)|^hydra.searchpath=.*pkg:", lines)
    if other or not all(map(Path.is_dir, own)):
        return
    files = [file for folder in (root, *preset_folders(), *own) for file in folder.rglob("*.yaml")]
    roots = "".join(file.read_text("utf-8") for file in root.glob("*.yaml"))
    chosen = {*groups()} - {*re.findall(r"^\w+(?=:)", roots, re.MULTILINE)}  # a root's own key may have a group's name
    written = re.sub("#.*", "", "\n".join((lines, *(file.read_text("utf-8", "replace") for file in files))))
    top = {*re.findall(r"^\w+(?=:)", written, re.MULTILINE), *groups(), *OPTIONS, "hydra"}
    named = top | {*re.findall(r"\w+(?=:)|(?<=@)\w+", written), *(file.parent.name for file in files)}
    for key, _, value in (word.partition("=") for word in words if "=" in word):
        names = re.fullmatch(r"\[?([\w,-]+)\]?", value)
        known = {*choices(key), *(file.stem for file in files if file.parent.name == key)} if key in chosen else {}
        for name in names[1].split(",") if names and known else ():
            if name and name not in known:
                raise UserError(_no_such(key, name, sorted(known)))
        first, *inner = bare.split(".") if re.fullmatch(r"\w[\w.]*", bare := key.lstrip("+")) else ("hydra",)
        if first not in named and not re.search(rf"\${{[^}}]*\b{first}\b", written):
            near = did_you_mean(first, top) or " --cfg job shows all there are"
            raise UserError(f"Could not override '{key}': Key '{first}' is unknown.{near}")
        depth = 1 + (first in MANY)
        takes, asked = _takes(first, inner, words), "".join(inner[depth - 1 : depth])
        if takes and asked and asked not in {*takes, *named}:
            near = did_you_mean(asked, takes) or f" There are: {', '.join(sorted(takes))}"
            raise UserError(f"Could not override '{key}': Key '{asked}' is no option of {first}.{near}")
        allowed, is_number = ELSEWHERE["choices"].get(key), not inner and re.search(rf"(?m)^{first}: [\d.]+$", roots)
        if len(inner) == depth and asked in takes:
            is_number = {*re.findall(r"[A-Za-z]\w*", takes[asked])} <= _NUMERIC
            if choice := _LITERAL.fullmatch(takes[asked]):
                allowed = re.findall(r"[\w-]+", choice[1])
        if allowed and _WORD.fullmatch(value) and value.lower() not in map(str.lower, allowed):
            raise UserError(f"{key}={value}: choose one of {', '.join(allowed)}")
        if is_number and _TEXT.fullmatch(value):
            raise UserError(f"{key}={value}: expected a number")


def config_folders(words: Sequence[str]) -> list[str]:
    """The folders of configurations that words add: ``-cd DIR`` or ``--config-dir=DIR``."""
    return re.findall(r"(?:^|\n)(?:-cd|--config-dir)[=\n](.+)", "\n".join(words))


def _takes(key: str, inner: Sequence[str], words: Sequence[str]) -> dict[str, str]:
    """The options of plugins that words choose for a key, or of all of the kind, with their annotations.

    Empty where sources do not tell.
    """
    if key in OPTIONS:
        target = "lightning.pytorch.trainer.trainer:Trainer" if key == "trainer" else OPTIONS[key]
        return arguments(Plugin(key, key, target, "anystyle")) or {}
    known = catalog().names(key) if key in kinds() else []
    chosen = inner[:1] if key in MANY else [word.partition("=")[2] for word in words if word.startswith(f"{key}=")]
    among = [name for name in known if name in chosen or not {*chosen} & {*known}]
    taken = [arguments(plugin) for name in among for plugin in catalog().declarations(key, name)]
    items = [item for options in taken for item in (options or {}).items() if None not in taken]
    return {name: " | ".join(kind for each, kind in items if each == name) for name, _ in items}


def override(key: str, value: object) -> str:
    """``key=value`` in Hydra's grammar; the value is a text, number, truth value, ``None``, or a sequence of these."""
    return f"{key}={_written(value)}"


def _written(value: object) -> str:
    if value is None or isinstance(value, bool):
        return "null" if value is None else str(value).lower()
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, (list, tuple)):
        return f"[{','.join(map(_written, value))}]"
    return QuotedString(literal(str(value)), Quote.single).with_quotes()


def explain(error: Exception) -> str:
    """One line for an error of Hydra or OmegaConf: what was given, and what there is."""
    if isinstance(error, MissingConfigException) and error.missing_cfg_file and error.options is not None:
        group, _, name = error.missing_cfg_file.rpartition("/")
        return _no_such(group, name, [option for option in error.options if not option.startswith("_")])
    if isinstance(error, MissingConfigException) and (unknown := _UNKNOWN.match(str(error))):
        return _no_such(unknown["group"], unknown["name"], choices(unknown["group"]))
    if deleted := _DELETED.match(str(error)):
        return f"this configuration needs {deleted['group']}; add {deleted['group']}=NAME"
    if isinstance(error, OverrideParseException):
        reason = error.message.splitlines()[0] if error.message else "no such syntax"
        hint = "quote special characters twice: 'key=\"a, b\"'"
        return f"cannot read the override '{one_line(error.override)}': {reason}; {hint}"
    cause = error.__cause__
    key = error.full_key if isinstance(error, OmegaConfBaseException) else None
    parts = [key if key and key not in str(error).partition("\n")[0] else "", _message(error)]
    if isinstance(cause, OmegaConfBaseException):
        parts.append(_message(cause))
    return ": ".join(part.rstrip(".:") for part in parts if part) + _nearest(error, cause)


def refused(error: Exception) -> Exception:
    """What Hydra raises while it composes, of nearly any type for words and files that it did not expect."""
    if isinstance(error, ERRORS):  # first: a configuration that is missing is an OSError, too
        return UserError(explain(error))
    if isinstance(error, (UserError, MemoryError, OSError)):
        return error
    reason = one_line(error)[:300] or type(error).__name__
    return UserError(f"Hydra cannot run these arguments ({reason}); give GROUP=NAME and KEY=VALUE, as --help says")


def _no_such(group: str, name: str, known: Sequence[str]) -> str:
    listing = f" Available in '{group}': {', '.join(known) or 'nothing'}"
    return f"Could not find '{group}/{name}'.{did_you_mean(name, known)}{listing}"


def choices(group: str) -> list[str]:
    """What a configuration group has to choose from: plugins and presets."""
    return sorted({*presets(group), *(catalog().names(group) if group in kinds() else ())})


def _with_option(group: str, message: str) -> list[str]:
    """The choices of a group that have the option of which Hydra says that it could not be overridden, or all."""
    option = re.search(rf"'{group}\.(\w+)", message)
    names = catalog().names(group) if group in kinds() and option else ()
    plugins = {name: catalog().declarations(group, name)[0] for name in names}
    return [name for name in plugins if option and option[1] in (arguments(plugins[name]) or ())] or choices(group)


def _message(error: BaseException) -> str:
    text = "\n".join(line for line in str(error).splitlines() if not _NOISE.match(line))
    # OmegaConf 2.4 guesses too; :func:`_nearest` knows groups.
    return re.sub(r"\. Did you mean: .*\?", "", one_line(text)).replace("is not in struct", "is unknown")


def _nearest(*errors: BaseException | None) -> str:
    """The key that may have been meant, where a key was not found."""
    for error in errors:
        if isinstance(error, OmegaConfBaseException) and isinstance(error.parent_node, DictConfig):
            keys = [str(key) for key in error.parent_node if key not in ("_target_", "hydra")]
            group = str(error.key if error.parent_node else error.parent_node._key())
            if group in groups() and group not in keys:
                return f"; choose one first: {group}={'|'.join(_with_option(group, str(errors[0])))}"
            if error.key is not None and error.key not in keys:
                nodes = {name: error.parent_node._get_node(name) for name in keys}
                inside = [n for n, node in nodes.items() if isinstance(node, DictConfig) and error.key in node]
                near = f" Did you mean '{inside[0]}.{error.key}'?" if inside else did_you_mean(str(error.key), keys)
                return f".{near}" if near else f". There are: {', '.join(keys) or 'none'}"
    return ""
