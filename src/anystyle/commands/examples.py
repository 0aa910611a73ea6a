"""The photographs and paintings that come with the package, by the names that stand for them."""

from anystyle.cli.arguments import new_parser, parse
from anystyle.cli.run import run, words_of
from anystyle.examples import PREFIX, examples


def main() -> None:
    """Run ``anystyle examples``."""
    parse(new_parser("examples", "List the examples: example:NAME stands for one as input or --image."), words_of(None))
    for name, example in examples().items():
        print(f"{PREFIX}{name}\n  {example.title}\n  {example.author}, {example.year}; {example.license}")


if __name__ == "__main__":
    run(main)
