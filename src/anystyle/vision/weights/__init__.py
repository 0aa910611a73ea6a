"""Files of weights by name: where each comes from, where it is searched, under what licence, and reading them.

A missing file raises, and nothing is downloaded unless ``anystyle weights download`` is run. The rows are those of
``weights.toml`` in this folder and beside the top-level module of each plugin package, whose bundled files are in its
folder ``assets``.
"""

from anystyle.types.network import checksums, stand_ins
from anystyle.vision.weights.licenses import License, binding, license_lines, license_meaning, licenses
from anystyle.vision.weights.reading import read
from anystyle.vision.weights.search import (
    FOLDERS,
    MissingWeights,
    candidates,
    download,
    find,
    folders,
    has_hub,
    verified,
)
from anystyle.vision.weights.sources import Weights, bundled, locate, published
from anystyle.vision.weights.table import WeightsFile, files, row

__all__ = [
    "FOLDERS",
    "License",
    "MissingWeights",
    "Weights",
    "WeightsFile",
    "binding",
    "bundled",
    "candidates",
    "checksums",
    "download",
    "files",
    "find",
    "folders",
    "has_hub",
    "license_lines",
    "license_meaning",
    "licenses",
    "locate",
    "published",
    "read",
    "row",
    "stand_ins",
    "verified",
]
