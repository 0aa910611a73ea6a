# ruff: noqa: E402
"""Metrics beside public implementations of the same: by how much they differ, and which is faster.

``python -m tests.benchmarks.metrics [METRIC ...]`` prints a table over the 46 photographs of the benchmark's track
``open`` (squares of 224 pixels from their middle) and what JPEG of quality 8 makes of them. All are given the same
tensors, and their networks the same weights: filled by a rule, with LPIPS' published linear layers. CPU seconds on one
thread are medians over rounds in turn, ours with its checks of the input and without what an earlier round computed.

A library that is not installed is left out, and named. They are art-fid, clean-fid, lpips, opencv-python-headless, piq,
pyiqa, pytorch-fid, scikit-image, torch-fidelity and torchmetrics; of torchvision only networks are used.
"""

import importlib
import os
import statistics
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from functools import cache, partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import torch

# torchvision's networks need none of its operators, which are compiled for one PyTorch; torchmetrics imports it.
_register, torch.library.register_fake = torch.library.register_fake, lambda *names, **options: lambda fake: fake
try:
    importlib.import_module("torchvision")
except ImportError:
    pass
finally:
    torch.library.register_fake = _register

import numpy as np
import torch.nn.functional as F
from PIL import Image, ImageOps
from torch import Tensor, nn

import anystyle
from anystyle.evaluation.tables import Table
from anystyle.metrics import CFSD, LPIPS, PSNR, SSIM, ArtFID, ColorHistogram, Sharpness
from anystyle.metrics.art_fid import frechet_distance
from anystyle.metrics.kid import discrepancy
from anystyle.vision import embeddings, networks, weights
from anystyle.vision.feature_cache import CACHE
from tests.benchmarks.distances import CAPTURES, pairs, photographs
from tests.support.judging_cases import filled_folder

BATCH, ROUNDS = 8, 3
Compute = Callable[[], float | Tensor]
"""A figure of each image, or one of all."""
Given = tuple[Tensor, Tensor]
Theirs = dict[str, Callable[[], Compute]]
"""By library, what imports it and returns what is timed."""


def library(name: str) -> Any:
    """A module, without what it says while it is imported."""
    with quietly(), warnings.catch_warnings(action="ignore"):
        return importlib.import_module(name)


@contextmanager
def quietly() -> Iterator[None]:
    """Nothing is written to the terminal."""
    with Path(os.devnull).open("w") as nowhere, redirect_stdout(nowhere), redirect_stderr(nowhere):
        yield


def batched(function: Callable[..., Tensor], *images: Tensor) -> Tensor:
    """What a function says of each image, a few at a time."""
    with torch.no_grad():
        return torch.cat(
            [function(*batch).flatten() for batch in zip(*(one.split(BATCH) for one in images), strict=True)]
        )


def each(function: Callable[[np.ndarray, np.ndarray], float], *images: Tensor) -> float:
    """The mean of what a function says of arrays ``H W 3``."""
    arrays = [one.movedim(1, -1).numpy() for one in images]
    return float(np.mean([function(*pair) for pair in zip(*arrays, strict=True)]))


def ours(metric: Any, *images: Tensor) -> float:
    """The first figure of a metric, which has seen no image before."""
    CACHE.clear()
    metric.reset()
    return float(next(iter(metric(*images).values())))


def psnr(preds: Tensor, target: Tensor) -> tuple[Compute, Theirs]:
    """Of an image's own error."""
    given = preds, target

    def scikit() -> Compute:
        of = partial(library("skimage.metrics").peak_signal_noise_ratio, data_range=1)
        return lambda: each(of, target, preds)

    def metrics() -> Compute:
        of = library("torchmetrics.functional.image").peak_signal_noise_ratio
        return lambda: batched(partial(of, data_range=1.0, reduction="none", dim=(1, 2, 3)), *given)

    theirs = {
        "scikit-image": scikit,
        "torchmetrics": metrics,
        "piq": lambda: partial(batched, partial(library("piq").psnr, reduction="none"), *given),
        "pyiqa": lambda: partial(batched, library("pyiqa.archs.psnr_arch").psnr, *given),
    }
    return partial(ours, PSNR(), *given), theirs


def ssim(preds: Tensor, target: Tensor) -> tuple[Compute, Theirs]:
    """With the published window, where it lies inside of the image."""
    given = preds, target

    def scikit() -> Compute:
        options = {"channel_axis": 2, "data_range": 1, "gaussian_weights": True, "use_sample_covariance": False}
        return lambda: each(partial(library("skimage.metrics").structural_similarity, **options), *given)

    def metrics() -> Compute:
        of = library("torchmetrics.functional.image").structural_similarity_index_measure
        return lambda: batched(partial(of, data_range=1.0, reduction="none"), *given)

    theirs = {
        "scikit-image": scikit,
        "torchmetrics": metrics,
        "piq": lambda: partial(batched, partial(library("piq").ssim, downsample=False, reduction="none"), *given),
        "piq, as it comes": lambda: partial(batched, partial(library("piq").ssim, reduction="none"), *given),
        "pyiqa": lambda: partial(batched, library("pyiqa.archs.ssim_arch").ssim, *given),
        "pyiqa, as it comes": lambda: partial(batched, library("pyiqa.archs.ssim_arch").SSIM(), *given),
    }
    return partial(ours, SSIM(), *given), theirs


def lpips(backbone: str, preds: Tensor, target: Tensor) -> tuple[Compute, Theirs]:
    """Of images at their own size."""
    metric = LPIPS(backbone=backbone, size=None, variant="corrected", weights="published")

    def package(module: str, cls: str, **options: Any) -> Callable[[], Compute]:
        def make() -> Compute:
            network = getattr(library(module), cls)(net=backbone, pnet_rand=True, **options)
            return partial(batched, partial(filled(network, backbone), normalize=True), preds, target)

        return make

    def iqa() -> Compute:
        heads = Path(library("lpips").__file__).parent / "weights" / "v0.1" / f"{backbone}.pth"
        module, models = library("pyiqa.archs.lpips_arch"), library("torchvision.models")
        # It would download weights that are replaced below.
        module.models = SimpleNamespace(alexnet=lambda weights: models.alexnet(), vgg16=lambda weights: models.vgg16())
        network = module.LPIPS(net=backbone, pnet_rand=True, pretrained_model_path=str(heads))
        return partial(batched, filled(network, backbone), preds, target)

    theirs = {
        "lpips": package("lpips", "LPIPS", verbose=False),
        "torchmetrics": package("torchmetrics.functional.image.lpips", "_LPIPS"),
        "pyiqa": iqa,
    }
    return partial(ours, metric, preds, target), theirs


def filled(network: nn.Module, backbone: str) -> nn.Module:
    """LPIPS whose network, in slices of torchvision's, has the weights of ours."""
    name = {"alex": "alexnet", "vgg": "vgg16"}[backbone]
    state = torch.load(filled_folder() / weights.row(name).file, weights_only=True)
    inner: Any = network.net
    inner.load_state_dict({key: state[f"features.{key.partition('.')[2]}"] for key in inner.state_dict()})
    return network.eval()


def fid(first: Tensor, second: Tensor) -> tuple[Compute, Theirs]:
    """The Fréchet distance of features."""

    def of_moments(module: str, name: str) -> Callable[[], Compute]:
        def make() -> Compute:
            distance = getattr(library(module), name)

            def compute() -> float:
                moments = [(f.mean(0), np.cov(f, rowvar=False)) for f in (first.numpy(), second.numpy())]
                return float(distance(*moments[0], *moments[1]))

            return compute

        return make

    def fidelity() -> Compute:
        module = library("torch_fidelity.metric_fid")

        def compute() -> float:
            moments = [module.fid_features_to_statistics(features) for features in (first, second)]
            return module.fid_statistics_to_metric(*moments, False)[module.KEY_METRIC_FID]

        return compute

    def metrics() -> Compute:
        module = library("torchmetrics.image.fid")

        def compute() -> float:
            moments = [(f.double().mean(0), f.double().T.cov()) for f in (first, second)]
            return float(module._compute_fid(*moments[0], *moments[1]))

        return compute

    theirs = {
        "clean-fid": of_moments("cleanfid.fid", "frechet_distance"),
        "pytorch-fid": of_moments("pytorch_fid.fid_score", "calculate_frechet_distance"),
        "torch-fidelity": fidelity,
        "torchmetrics": metrics,
        "piq": lambda: lambda: float(library("piq").FID()(first, second)),
    }
    return lambda: float(frechet_distance(first, second)), theirs


def kid(first: Tensor, second: Tensor) -> tuple[Compute, Theirs]:
    """The discrepancy of features, in one estimate over all of them."""
    count = len(first)

    def fidelity() -> Compute:
        module = library("torch_fidelity.metric_kid")
        options = {"kid_subsets": 1, "kid_subset_size": count, "verbose": False}
        return lambda: module.kid_features_to_metric(first, second, **options)[module.KEY_METRIC_KID_MEAN]

    def clean() -> Compute:
        distance = library("cleanfid.fid").kernel_distance
        return lambda: distance(first.numpy(), second.numpy(), num_subsets=1, max_subset_size=count)

    theirs = {
        "clean-fid": clean,
        "torch-fidelity": fidelity,
        "torchmetrics": lambda: lambda: float(library("torchmetrics.image.kid").poly_mmd(first, second)),
        "piq": lambda: lambda: float(library("piq").KID(average=False)(first, second)),
    }
    return lambda: float(discrepancy(first, second)), theirs


def art_fid(side: int = 512, count: int = 4) -> tuple[Compute, Theirs]:
    """From files of 512 pixels: no network sees another size."""
    folder = tempfile.TemporaryDirectory()
    root, files = Path(folder.name), sorted(CAPTURES.rglob("*.jpg"))[: 2 * count]
    squares = [ImageOps.fit(Image.open(file).convert("RGB"), (side, side)) for file in files]
    for number, (content, style) in enumerate(zip(squares[::2], squares[1::2], strict=True)):
        result = Image.blend(content, style, 0.5)
        for name, image in (("content", content), ("style", style), ("result", result)):
            (root / name).mkdir(exist_ok=True)
            image.save(root / name / f"{number:02d}.png")
    metric = ArtFID(weights="published")

    def compute() -> float:
        kinds = [sorted((root / name).glob("*.png")) for name in ("result", "content", "style")]
        images = [torch.stack([anystyle.read_image(path) for path in paths]) for paths in kinds]
        return folder.name and ours(metric, *images)

    def package() -> Compute:
        module, distance = library("art_fid.art_fid"), library("lpips").LPIPS(net="alex", pnet_rand=True, verbose=False)
        module.utils.download = lambda url: filled_folder() / weights.row("art_inception").file
        module.image_metrics.lpips.LPIPS = lambda net: filled(distance, net)
        of = [str(root / name) for name in ("result", "style", "content")]

        def run() -> float:
            with quietly():
                return module.compute_art_fid(*of, 4, "cpu", mode="art_fid", num_workers=0)

        return run

    return compute, {"art-fid": package}


def cfsd(preds: Tensor, target: Tensor) -> tuple[Compute, Theirs]:
    """Beside its definition, with all similarities in memory."""
    metric = CFSD(variant="corrected", weights="published")

    def definition() -> Compute:
        network = networks.load("vgg19", weights.find("vgg19"))

        def rows(images: Tensor) -> Tensor:
            features = network(images, ("relu3_1",))[0].flatten(2)
            return ((features / features.shape[1]).mT @ (features / features.shape[1])).log_softmax(-1)

        def entropy(one: Tensor, other: Tensor) -> Tensor:
            logs = rows(other), rows(one)
            return F.kl_div(logs[1], logs[0], reduction="none", log_target=True).sum((1, 2)) / logs[0].shape[1]

        return lambda: torch.cat(
            [batched(entropy, *pair) for pair in zip(preds.split(1), target.split(1), strict=True)]
        )

    return partial(ours, metric, preds, target), {"its definition in PyTorch": definition}


def color_histogram(preds: Tensor, style: Tensor) -> tuple[Compute, Theirs]:
    """The intersection of histograms of 8 x 8 x 8 bins."""

    def opencv() -> Compute:
        cv2 = library("cv2")

        def distance(one: np.ndarray, other: np.ndarray) -> float:
            levels = [np.ascontiguousarray((255 * image).round().astype(np.uint8)) for image in (one, other)]
            counts = [cv2.calcHist([image], [0, 1, 2], None, [8] * 3, [0, 256] * 3) for image in levels]
            shares = [count / count.sum() for count in counts]
            return 1 - cv2.compareHist(*shares, cv2.HISTCMP_INTERSECT)

        return lambda: each(distance, preds, style)

    return partial(ours, ColorHistogram(), preds, style), {"opencv-python-headless": opencv}


def sharpness(preds: Tensor, target: Tensor) -> tuple[Compute, Theirs]:
    """The ratio of total variations."""

    def iqa() -> Compute:
        variation = partial(library("piq").total_variation, reduction="none", norm_type="l1")
        return lambda: batched(variation, preds) / batched(variation, target)

    return partial(ours, Sharpness(), preds, target), {"piq": iqa}


def cases() -> dict[str, Callable[[], tuple[Compute, Theirs]]]:
    """What is compared, by name."""
    captures = photographs()
    given: Given = next((preds, target) for name, preds, target in pairs(captures) if name == "JPEG 8")
    other = next(preds for name, preds, _ in pairs(captures) if name == "another photograph")

    @cache
    def features() -> Given:
        CACHE.clear()
        network = embeddings.load_art_inception("published")
        with torch.no_grad():
            return tuple(torch.cat([network(batch) for batch in images.split(BATCH)]).double() for images in given)

    return {
        "psnr": partial(psnr, *given),
        "ssim": partial(ssim, *given),
        "lpips, alex": partial(lpips, "alex", *given),
        "lpips, vgg": partial(lpips, "vgg", *given),
        "fid of features": lambda: fid(*features()),
        "kid of features": lambda: kid(*features()),
        "art_fid": art_fid,
        "cfsd": partial(cfsd, *given),
        "color_histogram": partial(color_histogram, given[0], other),
        "sharpness": partial(sharpness, *given),
    }


def compared(name: str, make: Callable[[], tuple[Compute, Theirs]]) -> list[tuple[str, ...]]:
    """A row for each library: its value, the relative difference of ours, and the seconds of both."""
    mine, theirs = make()
    made: dict[str, Compute] = {"": mine}
    absent: list[tuple[str, ...]] = []
    for title, importing in theirs.items():
        try:
            made[title] = importing()
        except ImportError as error:
            absent.append((name, title, f"not installed ({error})", "", "", ""))
    values: dict[str, float] = {}
    seconds: dict[str, list[float]] = {title: [] for title in made}
    for _ in range(ROUNDS):
        for title, compute in made.items():
            if sum(seconds[title]) > 5:
                continue  # once is enough of what takes so long
            start = time.process_time()
            with warnings.catch_warnings(action="ignore"):
                values[title] = float(torch.as_tensor(compute()).double().mean())
            seconds[title].append(time.process_time() - start)
    took = {title: statistics.median(each) for title, each in seconds.items()}
    rows = [
        (
            name,
            title,
            f"{values[title]:.6g}",
            f"{abs(values[''] - value) / abs(value):.1e}",
            f"{took['']:.3g}",
            f"{took[title] / took['']:.2f}",
        )
        for title, value in values.items()
        if title
    ]
    return rows + absent


def main(names: Sequence[str]) -> None:
    """Print the table."""
    torch.set_num_threads(1)
    os.environ["ANYSTYLE_WEIGHTS"] = str(filled_folder())
    columns = ("metric", "beside", "its value", "difference", "our seconds", "its time, ours is 1")
    rows: list[tuple[str, ...]] = []
    for name, make in cases().items():
        if not names or name in names:
            rows += compared(name, make)
            sys.stderr.write(f"{name}: {len(rows)} rows\n")
    sys.stdout.write(Table(columns, tuple(rows)).markdown())


if __name__ == "__main__":
    main(sys.argv[1:])
