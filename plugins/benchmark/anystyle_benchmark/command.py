"""``anystyle benchmark``: one of its commands."""

from collections.abc import Sequence
from importlib import import_module

from anystyle.cli.arguments import subcommand
from anystyle.contracts import Command
from anystyle.registry.catalog import catalog

SUBCOMMANDS = {
    "run": "render a track's scenes in its styles, each method in a process of its own",
    "judge": "compute the scores of results; --check verifies a folder of images without judging",
    "compare": "which methods differ significantly",
    "ladder": "how the metrics order known distortions of a method's results",
}


class Benchmark(Command):
    """Run, judge and show a benchmark of 3D stylization."""

    def __call__(self, words: Sequence[str]) -> None:
        if (name := subcommand("benchmark", self.__doc__, SUBCOMMANDS, words)) is not None:
            catalog().find("command", "study").load()  # where that package is not installed, this makes it importable
            import_module(f"anystyle_benchmark.command_{name}").main(words[1:])
