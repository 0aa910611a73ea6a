"""The objective's terms against the published implementation."""

from collections.abc import Mapping
from typing import Any

import pytest
import torch
from torch import Tensor

from anystyle.testing.inputs import stylization
from anystyle.types import Stylization
from anystyle.vision.features import load_frozen
from anystyle.vision.networks import part_of
from anystyle.vision.vgg import AdainVGG
from anystyle_backbones.stylos.losses import AdainVoxels, DiagonalVariation
from tests.support import anysplat_reference, stylos_reference
from tests.support.oracle import fill_named
