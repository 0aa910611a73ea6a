"""The words of ``anystyle stylize``: from its flags to a request, and back to the command line."""

import argparse
import hashlib
import json
import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from anystyle.cli.arguments import is_override
from anystyle.errors import UserError
from anystyle.pipeline.controls import Controls, Mask, combinations
from anystyle.pipeline.flags import parsed
from anystyle.pipeline.request import InMemory, Request, SavedScene, inputs_of
from anystyle.pipeline.styles import Mixture, Named, StyleInput, check_text

NUMBERS = ("strength", "preserve_color", "scale")
"""The controls that are numbers."""


def request(args: Sequence[str]) -> Request:
    """The request of a command line after ``anystyle stylize``; ``--out`` and ``--open`` do not belong to it.

    Raises:
        UserError: An argument is unknown, or does not go with another.

    Example:
        >>> asked = request(["photos/", "--text", "blue ink", "--strength", "0.5", "views.take=12"])
        >>> asked.views.take
        12
        >>> args_of(asked)
        ['photos', '--text', 'blue ink', '--strength', '0.5', 'views.take=12']
    """
    arguments, overrides = parsed(args)
    if foreign := [word for word in overrides if not is_override(word)]:
        raise UserError(f"{foreign[0]} is a flag of Hydra's, which only the command line takes")
    return request_of(arguments, overrides)


def request_of(arguments: argparse.Namespace, overrides: Sequence[str], composed: DictConfig | None = None) -> Request:
    """The request of what :func:`parsed` returns, with the configuration where Hydra has composed it already."""
    numbers = (_numbers(flag, getattr(arguments, flag)) for flag in NUMBERS)
    controls = tuple(combinations(*numbers, mask=[_mask(word) for word in arguments.mask]))
    return Request(inputs_of(arguments.inputs), _styles_of(arguments), controls, tuple(overrides), composed)


def args_of(request: Request) -> list[str]:
    """The arguments of the command line that ask for the same.

    Raises:
        UserError: Views or styles are in memory, or controls are not all combinations of their values.
    """
    match request.inputs:
        case InMemory():
            raise UserError("views in memory have no command line; give their files")
        case SavedScene(path):
            paths = [str(path)]
        case None:
            paths = []
        case photographs:
            paths = [str(path) for path in photographs.paths]
    inputs = [f"./{path}" if path.startswith("-") or is_override(path) else path for path in paths]
    return [*inputs, *_styles_as_args(request.styles), *_controls_as_args(request.controls), *request.overrides]


def recorded(request: Request) -> list[str] | None:
    """The arguments that make a result again, with the names of absolute paths; ``None`` if something is in memory."""
    try:
        args = args_of(request)
    except UserError:
        return None
    # A text that begins with a slash is no path.
    return [
        word if before == "--text" else re.sub(r"(^|[='])/(?:[^']*/)?(?=[^/'])", r"\1", word)
        for before, word in pairwise(["", *args])
    ]


def digest(request: Request) -> str | None:
    """By which the same request from the same folder is known again; ``None`` if something of it is in memory."""
    try:
        asked = [str(Path.cwd()), *args_of(replace(request, overrides=()))]
    except UserError:
        return None
    config = OmegaConf.to_yaml(request.config, resolve=True, sort_keys=True)
    return hashlib.sha256(json.dumps([*asked, config]).encode()).hexdigest()


def _styles_of(arguments: argparse.Namespace) -> tuple[StyleInput, ...]:
    """The styles in the order of their flags, or their mixtures."""
    styles: list[StyleInput] = []
    for kind, word, name in arguments.styles:
        if kind is str:
            check_text(word, "--text")
        styles.append(kind(word) if name is None else Named(kind(word), name))
    amounts = _numbers("mix", arguments.mix)
    if not all(0 <= amount <= 1 for amount in amounts):
        raise UserError(f"--mix takes numbers between 0 and 1, not {','.join(arguments.mix)}")
    if amounts and len(styles) != 2:
        raise UserError(f"--mix needs exactly two styles, and {len(styles)} are given; add or drop a --text or --image")
    return tuple(Mixture(styles[0], styles[1], amount) for amount in amounts) or tuple(styles)


def _mask(word: str) -> Mask:
    from anystyle.pipeline.masks import parsed

    return parsed(word)


def _numbers(flag: str, words: Sequence[str]) -> list[float]:
    try:
        return [float(word) for word in ",".join(words).split(",")] if words else []
    except ValueError:
        raise UserError(f"--{flag.replace('_', '-')} takes numbers, not {','.join(words)!r}") from None


def _styles_as_args(styles: Sequence[StyleInput]) -> list[str]:
    words: list[str] = []
    mixed = [style for style in styles if isinstance(style, Mixture)]
    if mixed:
        first, second = mixed[0].first, mixed[0].second
        if len(mixed) < len(styles) or any((style.first, style.second) != (first, second) for style in mixed):
            raise UserError("mixtures of several pairs of styles have no command line")
        return [*_styles_as_args([first, second]), "--mix", ",".join(f"{style.amount:g}" for style in mixed)]
    for style in styles:
        match style:
            case Named(style=plain, name=name):
                words += [*_styles_as_args([plain]), "--name", name]
            case str() | Path():
                name, value = "--text" if isinstance(style, str) else "--image", str(style)
                words += [f"{name}={value}"] if value.startswith("-") else [name, value]
            case _:
                raise UserError("styles in memory have no command line; give their files")
    return words


def _controls_as_args(controls: Sequence[Controls]) -> list[str]:
    values = {name: list(dict.fromkeys(getattr(one, name) for one in controls)) for name in (*NUMBERS, "mask")}
    masks = [mask for mask in values.pop("mask") if mask is not None]
    if tuple(combinations(*values.values(), mask=masks)) != tuple(controls):
        raise UserError("controls that are not all combinations of their values have no command line")
    words: list[str] = []
    for name, numbers in values.items():
        if numbers != [getattr(Controls(), name)]:
            words += [f"--{name.replace('_', '-')}", ",".join(f"{value:g}" for value in numbers)]
    return [*words, *(word for mask in masks for word in ("--mask", mask.text))]
