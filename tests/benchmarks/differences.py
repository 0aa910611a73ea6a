"""What some differences between the paper, its code and this project amount to: figures of ``docs/paper_vs_code.md``.

``python tests/benchmarks/differences.py FRAMES`` takes a folder of stylized frames of one scene in their order, the
photographs of the example ``street`` and the painting ``wave``. Networks are those in packages, in place of the
published ones.
"""

import sys
from pathlib import Path

import numpy as np
import scipy.linalg
import torch
import torch.nn.functional as F
from PIL import Image
from torch import Tensor

from anystyle.data.images import read_image, to_tensor
from anystyle.examples import resolved
from anystyle.io.sheet import to_pil
from anystyle.losses.features import resized
from anystyle.metrics.art_fid import frechet_distance
from anystyle.metrics.warp_consistency import WarpConsistency
from anystyle.types import Comparison
from anystyle.vision import networks
from anystyle.vision.statistics import mean_std
from anystyle_magenta.teacher import Teacher
from anystyle_metrics.optical_flow.dis import DIS

LAYERS = ("expand1", "expand3", "expand5", "expand8")
SIZE = (336, 448)


@torch.no_grad()
def main(folder: Path) -> None:
    files = sorted(folder.iterdir())[:16]
    frames = torch.stack([read_image(file) for file in files])[None]
    for name, order in {"t to t + 1": frames, "t to t - 1": frames.flip(1)}.items():
        metric = WarpConsistency(correspondence=DIS())
        metric.update(Comparison(content=order, stylized=order))
        figures = metric.compute()
        say(f"{name}: short {figures['warp_rmse_short']:.5f}, long {figures['warp_rmse_long']:.5f}")

    photographs = sorted(file for file in resolved(Path("example:street")).iterdir() if file.suffix == ".jpg")
    pictures = [to_pil(read_image(file)) for file in photographs]
    lanczos = torch.stack([to_tensor(each.resize(SIZE[::-1], Image.Resampling.LANCZOS)) for each in pictures])
    whole = torch.stack([to_tensor(each) for each in pictures])
    for mode in ("bilinear", "bicubic"):
        here = F.interpolate(whole, size=SIZE, mode=mode, antialias=True, align_corners=False).clamp(0, 1)
        error = 255 * (here - lanczos).square().mean().sqrt()
        say(f"{mode}: RMSE to Lanczos {error:.2f} of 255, gradients {edges(here) / edges(lanczos):.3f} of it")

    network = networks.load("efficientnet_lite0")
    painting = read_image(resolved(Path("example:wave")))[None]
    painted = Teacher().stylized(lanczos[None], painting)[0]
    for side in (None, 224):
        features, originals, style = (
            network(resized(images, side, "bilinear", antialias=True), LAYERS)
            for images in (painted, lanczos, painting)
        )
        content = sum(F.mse_loss(*pair) for pair in zip(features, originals, strict=True))
        moments = [[torch.stack(mean_std(each)) for each in maps] for maps in (features, style)]
        distance = sum(F.mse_loss(one, other.expand_as(one)) for one, other in zip(*moments, strict=True))
        say(f"networks see {side or SIZE}: content {float(content):.4f}, style {float(distance):.4f}")

    for dim, count, distinct in ((256, 96, 6), (512, 192, 12), (1024, 400, 25)):
        for seed in range(3):
            generator, falling = torch.Generator().manual_seed(seed), torch.arange(1, dim + 1).double() ** -0.5
            first = torch.randn(count, dim, generator=generator, dtype=torch.float64) * falling + 0.1
            style = torch.randn(distinct, dim, generator=generator, dtype=torch.float64) * falling
            style = style.repeat_interleave(count // distinct, 0)
            exact = float(frechet_distance(first, style))
            plain, shifted = (by_root(first, style, epsilon) / exact - 1 for epsilon in (0, 1e-6))
            say(f"FID of {count} x {dim}: sqrtm {plain:+.1e}, with 1e-6 on the diagonals {shifted:+.2%}")


def by_root(first: Tensor, second: Tensor, epsilon: float) -> float:
    """The Fréchet distance by the matrix root of the product of covariances; nan where the root is not finite."""
    one, other = (torch.cov(each.T).numpy() for each in (first, second))
    shift = epsilon * np.eye(len(one))
    root = np.trace(scipy.linalg.sqrtm((one + shift) @ (other + shift))).real
    return float((first.mean(0) - second.mean(0)).square().sum() + np.trace(one) + np.trace(other) - 2 * root)


def edges(images: Tensor) -> Tensor:
    return images.diff(dim=-1).abs().mean() + images.diff(dim=-2).abs().mean()


def say(line: str) -> None:
    sys.stdout.write(f"{line}\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
