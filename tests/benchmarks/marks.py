"""How alike the marks of two paintings are: ``python -m tests.benchmarks.marks RESULTS`` of a benchmark.

For each method and scene the mean correlation of luminance above 3 pixels' blur of one view in two paintings, over all
pairs of paintings. Contours of the scene are in every painting, so that none is 0.
"""

import argparse
import sys
from itertools import combinations
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter

from anystyle.data.images import read_image
from anystyle.evaluation.tables import Table
from anystyle_benchmark.track import Inputs

SIGMA = 3.0  # pixels
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def marks(path: Path) -> np.ndarray:
    """Luminance without what is wider than a few pixels, standardised."""
    luminance = np.tensordot(LUMINANCE, read_image(path).numpy(), 1)
    high = luminance - gaussian_filter(luminance, SIGMA)
    return ((high - high.mean()) / high.std()).ravel()


def likeness(folder: Path, styles: list[str], views: list[str]) -> float:
    """The mean correlation over views and pairs of styles, whose images are ``STYLE/VIEW.png``."""
    found = []
    for view in views:
        standard = np.stack([marks(folder / style / f"{view}.png") for style in styles])
        correlations = standard @ standard.T / standard.shape[1]
        found += [correlations[pair] for pair in combinations(range(len(styles)), 2)]
    return float(np.mean(found))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("results", type=Path, help="what `anystyle benchmark run seeds=0` wrote")
    parser.add_argument("--track", default="open")
    words = parser.parse_args()
    inputs = Inputs(words.track, None)
    styles = [style.name for style in inputs.track.styles if style.guide == "image"]
    rows = []
    for method in sorted(path.parent for path in words.results.glob("*/method.json")):
        values = [likeness(method / "0" / s.name, styles, list(s.views)) for s in inputs.track.scenes]
        rows.append((method.name, *(f"{value:.2f}" for value in (*values, float(np.mean(values))))))
    scenes = (scene.name for scene in inputs.track.scenes)
    sys.stdout.write(Table(("method", *scenes, "mean"), tuple(rows)).markdown())


if __name__ == "__main__":
    main()
