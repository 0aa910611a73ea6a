"""CPU seconds and memory of restyling a large splat: ``python -m tests.benchmarks.large_splats SCENE.ply 1000000``.

Each Gaussian of a scene, such as a fit's, is split into smaller ones that lie within it, with harmonics of degree 3;
``anystyle stylize`` restyles the file, without cameras beside it. Further words are passed on, such as
``video.frames=2``.
"""

import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.types import Gaussians


def split(scene: Gaussians, count: int) -> Gaussians:
    """A batch of one scene of ``count`` Gaussians that cover what those of another do."""
    draw, gaussians = torch.Generator().manual_seed(0), scene.row(0)
    areas = (gaussians.scales.sort(-1).values[0, :, 1:].prod(-1) * gaussians.opacities[0]).double()
    areas = areas.clamp_max(float(np.quantile(areas.numpy(), 0.99)))
    number = len(areas)
    drawn = torch.searchsorted(areas.cumsum(0) / areas.sum(), torch.rand(count - number, generator=draw).double())
    index = torch.cat([torch.arange(number), drawn.clamp_max(number - 1)]).sort().values
    parts = torch.bincount(index, minlength=number)[index]
    chosen: Gaussians = gaussians.map(lambda tensor: tensor[:, index])

    def normal(*shape: int) -> Float[Tensor, "..."]:
        return torch.randn(*shape, generator=draw)

    within = 0.8 * normal(count, 3) * chosen.scales[0] * (parts > 1)[:, None]
    unit = torch.nn.functional.normalize(chosen.rotations[0], dim=-1)
    axis, real = unit[:, 1:], unit[:, :1]
    across = 2 * torch.linalg.cross(axis, within)
    moved = within + real * across + torch.linalg.cross(axis, across)
    smaller = (1.3 * parts**-0.5).clamp_max(1)[:, None] * (0.2 * normal(count, 3)).exp()
    harmonics = 0.03 * normal(count, 16, 3)
    harmonics[:, 0] += chosen.harmonics[0, :, 0]
    means, scales, opacities = chosen.means + moved, chosen.scales * smaller, chosen.opacities.clamp(0.02, 0.995)
    return Gaussians(means, chosen.rotations, scales, opacities, harmonics[None])


def main(source: str, count: str, *words: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "large", "scene.ply")
        file.parent.mkdir()
        split(Gaussians.load(source), int(count)).save(file)
        command = [sys.executable, "-m", "anystyle", "stylize", str(file), "--text", "charcoal drawing", *words]
        subprocess.run([*command, "--out", f"{folder}/out"], check=True, env=os.environ | {"OMP_NUM_THREADS": "1"})
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    sys.stdout.write(f"{used.ru_utime + used.ru_stime:.1f} CPU seconds, {used.ru_maxrss / 2**20:.2f} GiB at most\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
