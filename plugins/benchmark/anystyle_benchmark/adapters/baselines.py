"""What metrics are tested by, and palette transfer: ``baselines.py photographs|noise|pasted|palette JOB``."""

import sys

import numpy as np
from views import Job


def palette(pixels: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Matrix and offset of the Monge-Kantorovitch map between colours ``[N, 3]`` (Pitié and Kokaram 2007)."""
    covariance = np.cov(pixels.T) + 1e-5 * 255**2 * np.eye(3)
    root, inverse = _power(covariance, 0.5), _power(covariance, -0.5)
    matrix = inverse @ _power(root @ np.cov(target.T) @ root, 0.5) @ inverse
    return matrix, target.mean(0) - pixels.mean(0) @ matrix


def _power(matrix: np.ndarray, exponent: float) -> np.ndarray:
    values, axes = np.linalg.eigh(matrix)
    return axes @ np.diag(values.clip(1e-8) ** exponent) @ axes.T


def main(name: str, job: Job) -> None:
    """Paint every view in every style."""
    images = {view: job.photograph(view) for view in job.views}
    pixels = np.concatenate([image.reshape(-1, 3) for image in images.values()]).astype(float)
    for style in job.styles:
        generator = np.random.default_rng([job.seed, *style["name"].encode()])  # whatever else is asked
        matrix, offset = np.eye(3), np.zeros(3)
        if name == "palette":
            matrix, offset = palette(pixels, job.painting(style["image"]).reshape(-1, 3).astype(float))
        for view, photograph in images.items():
            image = photograph @ matrix + offset
            if name == "pasted":
                image = job.fitted(style["image"])
            elif name == "noise":
                image = generator.integers(0, 256, image.shape)
            job.write(style["name"], view, image)


if __name__ == "__main__":
    main(sys.argv[1], Job())
