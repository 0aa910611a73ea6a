"""Which perceptual network sees patterns: the pixels of a picture, optimised against each candidate."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle import perception
from anystyle.data.procedural.patterns import PATTERNS
from anystyle.data.procedural.scenes import ProceduralScenes
from anystyle.data.procedural.styles import ProceduralStyles
from anystyle.evaluation.contract import Evaluation, Progress, Protocol, Row
from anystyle.files import atomic_path
from anystyle.perception.features import FeatureNetwork, freeze
from anystyle.perception.pixels import coarse_luma, optimise_pixels, patch_distance
from anystyle.sheet import contact_sheet, to_pil

UNTRAINED = "untrained"
"""The texture network as it was before it learnt anything: what the architecture alone can do."""


class _Pairs(NamedTuple):
    """Contents and styles, one of each a row, with the pattern that the style shows."""

    content: Float[Tensor, "M 3 H W"]
    style: Float[Tensor, "M 3 H W"]
    patterns: tuple[str, ...]


class Pixels(Protocol):
    """The test by which the network of the style losses is chosen; a sheet to look at, and two figures a candidate.

    ``sheet.png`` in ``sheets`` shows styles, contents and what each candidate made of them. The one whose column shows
    the patterns with the content kept, wins. The figures help to look: ``texture_NAME`` is the distance of raw patches
    to the style's as a share of the content's own (noise lowers it too), ``content_NAME`` the correlation of the coarse
    luma with the content's.

    Args:
        networks: Candidates: ``untrained``, or names of :data:`anystyle.perception.NETWORKS` whose weights are there.
        patterns: Of the styles, of which the first held-out one with two colours or more is taken.
        steps: Of the optimisation.
        size: Side of the pictures in pixels.
        seed: Of the scenes, the styles and the untrained network.

    Raises:
        ValueError: A candidate or a pattern is unknown.
    """

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        """A few steps on two small pictures."""
        return {"networks": ("untrained",), "patterns": ("stripes", "dots"), "steps": 2, "size": 32}

    def __init__(
        self,
        *,
        networks: Sequence[str] = ("texture", "untrained"),
        patterns: Sequence[str] = ("stripes", "dots", "mosaic", "hatching", "strokes"),
        steps: int = 120,
        size: int = 112,
        seed: int = 0,
    ) -> None:
        known = (UNTRAINED, *perception.NETWORKS)
        for what, given, choices in (("networks", networks, known), ("patterns", patterns, PATTERNS)):
            unknown = [name for name in given if name not in choices]
            if unknown or not given:
                raise ValueError(f"{what} are {list(given)}; choose from {', '.join(choices)}")
        if steps < 1:
            raise ValueError(f"steps={steps}: give at least 1")
        self.networks, self.patterns, self.steps, self.size, self.seed = networks, patterns, steps, size, seed

    def run(self, out: Path, progress: Progress) -> Evaluation:
        """See :meth:`anystyle.evaluation.contract.Protocol.run`."""
        pairs = self._pairs()
        done = {name: self._candidate(name, pairs, out, progress) for name in self.networks}
        figures: dict[str, float] = {}
        rows: list[Row] = []
        own = patch_distance(pairs.content, pairs.style).clamp_min(1e-12)
        luma = coarse_luma(pairs.content)
        for name, images in done.items():
            texture = patch_distance(images, pairs.style) / own
            content = (coarse_luma(images) * luma).mean((1, 2, 3))
            figures |= {f"texture_{name}": float(texture.mean()), f"content_{name}": float(content.mean())}
            rows += [
                Row("", pattern, {f"texture_{name}": float(texture[place]), f"content_{name}": float(content[place])})
                for place, pattern in enumerate(pairs.patterns)
            ]
        self._sheet(out, pairs, done)
        better = {name: "lower" if name.startswith("texture_") else "higher" for name in figures}
        return Evaluation(
            figures=figures,
            n=len(pairs.patterns) * len(done),
            better=better,
            rows=tuple(rows),
            provenance={"steps": self.steps, "size": self.size, "seed": self.seed, "sheet": "sheets/sheet.png"},
        )

    def _candidate(self, name: str, pairs: _Pairs, out: Path, progress: Progress) -> Float[Tensor, "M 3 H W"]:
        """What one candidate made of all pairs: from disk, or made now."""
        setting = {"steps": self.steps, "size": self.size, "seed": self.seed, "patterns": list(self.patterns)}
        file, record = out / "parts" / f"{name}.pt", out / "parts" / f"{name}.json"
        if file.is_file() and record.is_file() and json.loads(record.read_text(encoding="utf-8")) == setting:
            progress(name, self.steps, self.steps)
            return torch.load(file, weights_only=True)
        progress(name, 0, self.steps)
        images = optimise_pixels(
            pairs.content,
            pairs.style,
            self._network(name),
            steps=self.steps,
            told=lambda step: progress(name, step, self.steps),
        )
        record.unlink(missing_ok=True)
        with atomic_path(file) as temporary:
            torch.save(images, temporary)
        with atomic_path(record) as temporary:
            temporary.write_text(json.dumps(setting) + "\n", encoding="utf-8")
        return images

    def _network(self, name: str) -> FeatureNetwork:
        if name != UNTRAINED:
            return perception.load(name)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.seed)
            network = perception.Texture()
        network.train(False)
        return freeze(network)

    def _pairs(self) -> _Pairs:
        scenes = ProceduralScenes(size=self.size, num_scenes=len(self.patterns), seed=self.seed, split="heldout")
        source = ProceduralStyles(size=self.size, num_styles=2000, seed=self.seed, split="heldout")
        styles: list[Tensor] = []
        for pattern in self.patterns:
            wanted = PATTERNS.index(pattern)
            traits = ((place, source.traits(place)) for place in range(len(source)))
            found = next(place for place, made in traits if made.pattern == wanted and len(made.colors) > 1)
            image = source.read(found).image
            assert image is not None
            styles.append(image)
        content = torch.cat([scenes.read(place, [0]).images[0] for place in range(len(self.patterns))])
        return _Pairs(content, torch.cat(styles), tuple(self.patterns))

    def _sheet(self, out: Path, pairs: _Pairs, done: dict[str, Tensor]) -> None:
        sheet = contact_sheet(
            [[to_pil(image) for image in row] for row in zip(pairs.style, pairs.content, *done.values(), strict=True)],
            column_titles=["style", "content", *done],
            row_titles=pairs.patterns,
            footer=f"pixels after {self.steps} steps against each network's Gram matrices",
        )
        with atomic_path(out / "sheets" / "sheet.png") as temporary:
            sheet.save(temporary)
