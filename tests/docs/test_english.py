"""Some patterns of English that readers stumble over stay out of pages, configurations and code."""

import ast
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

_LINK = "and|as|by|for|from|in|is|of|on|over|than|that|to|with"
_NUMBER = rf"(?:one|two|three|four|half an?|\d+(?:[,.]\d+)*)(?: (?!(?:{_LINK})\b)[\w-]+)?"
_UNIT = r"(?:once|twice|bytes?|bits?|seconds?|(?<=\d )s|[KMG]i?B|times|lines?|rows?|files?|steps?)"
_EACH = (
    "batch|camera|capture|card|category|class|dimension|file|frame|Gaussian|image|job|kind|layer|line|method|module|"
    "name|pair|painting|participant|patch|person|photograph|picture|pixel|place|plugin|point|process|promise|row|scene|"
    "second|seed|set|side|site|step|style|text|token|training|vertex|view|voxel"
)
PATTERNS = {
    "is not a": r"(?<![Tt]here )\b(?:is|are|was|were|be) (?:none\b|no (?!longer\b|more\b|less\b|\w+er than\b|one\b))",
    "say what it is": r"^\s*(?:# |\*{0,2}\w+: )Of (?!course)",
    "per": rf"(?i:\b(?:{_NUMBER}|{_UNIT}) an? (?:{_EACH})\b(?! (?:is|was|has|to|that|which|in)\b))"
    rf"|^\s*\w+: [A-Z]\w+s an? (?:{_EACH})\b",
    "arguments, or overrides": r"\b(?:Hydra's|[Ff]urther|command(?:'s| line's)) words?\b"
    r"|\b[Ww]ords? (?:of|on) the command",
}
"""What to write instead, by what is found."""
FOLDERS = ("src/anystyle", "notebooks", "plugins")
"""What is held to it."""
TEXTS = sorted(
    path
    for pattern in ("*.md", "docs/*.md", "docs/reference/*.md", "plugins/*/*.md", "plugins/*/*/assets/*.md")
    for path in ROOT.glob(pattern)
    if path.name != "CHANGELOG.md"
)


def faults(text: str) -> list[str]:
    """What is found in a text, with what to write instead."""
    return [
        f"{found[0].strip()!r}: {better}"
        for better, pattern in PATTERNS.items()
        for found in re.finditer(pattern, text, re.MULTILINE)
    ]


def sentences(path: Path) -> Iterator[tuple[int, str]]:
    """The docstrings, messages and comments of a module, each with its line."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.JoinedStr):
            parts = (part.value if isinstance(part, ast.Constant) else "{}" for part in node.values)
            yield node.lineno, "".join(map(str, parts))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.lineno, node.value
    with path.open("rb") as file:
        comments = [token for token in tokenize.tokenize(file.readline) if token.type == tokenize.COMMENT]
    yield from ((token.start[0], token.string) for token in comments)


@pytest.mark.parametrize("page", TEXTS, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_pages(page):
    prose = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    assert not faults(re.sub(r"\s*\n(?=\S)", " ", prose))


def test_configurations():
    files = [*ROOT.glob("conf/**/*.yaml"), *ROOT.glob("plugins/*/*/conf/**/*.yaml")]
    comments = {path: re.findall(r"^.*#.*$", path.read_text(encoding="utf-8"), re.MULTILINE) for path in files}
    assert not {str(path): found for path, lines in comments.items() if (found := faults("\n".join(lines)))}


@pytest.mark.parametrize("folder", FOLDERS)
def test_code(folder):
    modules = [path for path in (ROOT / folder).rglob("*.py") if "tests" not in path.parts]
    assert not [
        f"{path.relative_to(ROOT)}:{line} {fault}"
        for path in modules
        for line, text in sentences(path)
        for fault in faults(text)
    ]


@pytest.mark.parametrize(
    "text",
    [
        "A photograph is no scene.",
        "Those that are none of these.",
        "    betas: Of AdamW.",
        "# Of those that are chosen.",
        "It takes 14 bytes a Gaussian.",
        "Once a scene; one file a command.",
        "Further words go to Hydra.",
        "The words of the command line.",
    ],
)
def test_what_is_wrong_is_found(text):
    assert faults(text)


@pytest.mark.parametrize(
    "text", ["There is no scene.", "It is no longer there.", "Once a scene is encoded, it stays.", "A list of words."]
)
def test_what_is_right_is_not(text):
    assert not faults(text)
