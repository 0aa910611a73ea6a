"""How well words that no text tower learnt are placed, a table of ``docs/styles.md``.

``python -m plugins.magenta.tests.unseen_words`` prints it.

A text is right when its style vector is nearer to that of its own meaning than to another's, by the cosine about the
mean; chance is 0.5. Where all other meanings of a list are compared with, a second row has those alone that are unlike
its own, of a cosine below 0. A third of ``meanings.txt`` is held out by looks (concepts) or by words of every look
(synonyms), and the regression is fitted anew without it; words are judged that hold none that the text tower knows.
What is in ``unseen_words.toml`` was never fitted to. ``--fit FILE`` writes the bundled regression and nothing else.
"""

import argparse
import sys
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path

import torch
import torch.nn.functional as F
from scipy.stats import binomtest
from torch import Tensor

import anystyle
from anystyle.io.checkpoint import save_tensors
from anystyle.nn.words import clean

UNSEEN = Path(__file__).with_suffix(".toml")
FOLD, FOLDS, LONGEST = 2, 3, 3
Embed = Callable[[Sequence[str]], Tensor]


@torch.no_grad()
def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fit", type=Path, metavar="FILE")
    file = parser.parse_args().fit
    encoder = anystyle.catalog().find("style_encoder", "magenta").load()().eval()
    from anystyle_magenta import phrases  # found once the plugin is loaded

    tower, known = encoder.text_tower, [text for text in encoder.descriptions.texts if len(clean(text)) <= LONGEST]
    pairs = phrases.meanings()
    texts = known + [word for word, _ in pairs]
    network = phrases.sentence_network()
    sentences, styles = network(texts), tower(known + [look for _, look in pairs])

    def fitted(keep: Sequence[bool]) -> phrases.Guesses:
        rows = torch.tensor([True] * len(known) + list(keep))
        return phrases.Guesses.fit(sentences[rows], styles[rows], tower.mean)

    if file is not None:
        guesses = fitted([True] * len(pairs))
        save_tensors(file, {name: tensor.half().contiguous() for name, tensor in vars(guesses).items()}, {})
        return

    def directions(embed: Embed, mean: Tensor = tower.mean) -> Embed:
        return lambda texts: F.normalize(embed(texts) - mean, dim=-1)

    plain, embeds = directions(tower), (directions(tower), directions(encoder.embed_texts))
    alone = directions(network, sentences.mean(0))
    unseen = tomllib.loads(UNSEEN.read_text(encoding="utf-8"))
    synonyms = [(word, look) for look, words in unseen["synonyms"].items() for word in words]
    synonyms = [pair for index, pair in enumerate(synonyms) if index % FOLDS]  # the others chose the settings
    show("phrases, their own of two meanings", *(two(embed, plain, unseen["phrases"]) for embed in embeds))
    compare("synonyms, unseen_words.toml", synonyms, plain, embeds)
    compare("synonyms, the sentence network itself", synonyms, alone, [alone])
    line = {look: index for index, look in enumerate(dict.fromkeys(look for _, look in pairs))}
    place = [sum(look == other for _, other in pairs[:index]) for index, (_, look) in enumerate(pairs)]
    for name, fold in (
        ("synonyms, a third of meanings.txt", [index % FOLDS for index in place]),
        ("concepts, a third of meanings.txt", [line[look] % FOLDS for _, look in pairs]),
    ):
        held_out = fitted([each != FOLD for each in fold])
        phrases.load_guesses = lambda guesses=held_out: guesses
        held = [pair for pair, each in zip(pairs, fold, strict=True)
                if each == FOLD and not set(clean(pair[0])) & encoder.descriptions.words]  # fmt: skip
        compare(name, held, plain, embeds)


def two(embed: Embed, known: Embed, cases: dict[str, list[str]]) -> list[float]:
    """Whether each phrase is nearer to the first of its two meanings."""
    own, other = (known([pair[index] for pair in cases.values()]) for index in (0, 1))
    return ((embed(list(cases)) * (own - other)).sum(1) > 0).float().tolist()


def compare(name: str, cases: Sequence[tuple[str, str]], known: Embed, embeds: Sequence[Embed]) -> None:
    """Rows of the mean share of other meanings that are farther from a word than its own: of all, of unlike ones."""
    words, looks = ([case[index] for case in cases] for index in (0, 1))
    meanings = known(looks)
    different = torch.tensor([[look != other for other in looks] for look in looks])
    cosines = [embed(words) @ meanings.T for embed in embeds]
    for suffix, others in (("", different), (", unlike", different & (meanings @ meanings.T < 0))):
        farther = [(each.diagonal()[:, None] > each) & others for each in cosines]
        show(name + suffix, *((each.sum(1) / others.sum(1)).tolist() for each in farther))


def show(name: str, *scores: list[float]) -> None:
    """A row: the number of texts, then for each tower the share that is right, and its interval (Wilson, 0.95)."""
    cells = [f"| {name} | {len(scores[0])} "]
    for score in scores:
        mean = sum(score) / len(score)
        low, high = binomtest(round(sum(score)), len(score)).proportion_ci(method="wilson")
        cells.append(f"| {mean:.2f} ({low:.2f} to {high:.2f}) ")
    sys.stdout.write("".join(cells) + "|\n")


if __name__ == "__main__":
    main()
