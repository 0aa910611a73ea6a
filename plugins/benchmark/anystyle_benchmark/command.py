"""``anystyle benchmark``: one of its commands."""

from collections.abc import Sequence
from importlib import import_module

from anystyle.cli.arguments import subcommand
from anystyle.contracts import Command
from anystyle.registry.catalog import catalog

SUBCOMMANDS = {
    "run": "render a track's scenes in its styles, each method in a process of its own",
    "geometry": "depth and cameras of your own track's scenes, and the hashes of its inputs",
    "judge": "compute the figures of results; --check verifies a folder of images without judging",
    "verify": "make cells of a table again, and compare every figure",
    "compare": "which methods differ significantly; --with-people makes a user study of them",
    "people": "which metrics order methods as the participants of such a study do",
    "ladder": "how the metrics order known distortions of a method's results",
    "site": "a static site of tables and pictures",
}


class Benchmark(Command):
    """Run, judge and show a benchmark of 3D stylization."""

    def __call__(self, words: Sequence[str]) -> None:
        name = subcommand("benchmark", self.__doc__, SUBCOMMANDS, words)
        if name is not None:
            catalog().find("command", "study").load()  # where that package is not installed, this makes it importable
            import_module(f"anystyle_benchmark.command_{name}").main(words[1:])
