"""Check a plugin against the contract of its kind, and report what is wrong."""

from collections.abc import Sequence

from anystyle.cli.arguments import new_parser, parse
from anystyle.cli.run import FAILED
from anystyle.registry.catalog import catalog, kinds


def main(argv: Sequence[str]) -> int:
    """Run ``anystyle plugins check``; returns the exit status."""
    parser = new_parser(
        "plugins check",
        "Run the contract of a plugin, installed or not: one line per promise, and for each that is broken what "
        "was promised and what was found. Exit status 0 if all promises are kept, else 2.",
    )
    parser.add_argument("kind", metavar="KIND", help="one of: " + ", ".join(kinds()))
    parser.add_argument("name", metavar="NAME", help="a plugin of that kind")
    arguments = parse(parser, argv)
    plugin = catalog().find(arguments.kind, arguments.name)

    from anystyle.testing import check

    print(plugin)
    return 0 if check(plugin.kind, plugin.name) else FAILED
