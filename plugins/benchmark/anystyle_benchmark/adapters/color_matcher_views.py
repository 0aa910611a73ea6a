"""Colours of the painting by the package color-matcher, view by view: ``color_matcher_views.py JOB``."""

from color_matcher import ColorMatcher  # pyright: ignore[reportMissingImports]
from views import Job

if __name__ == "__main__":
    job = Job()
    for style in job.styles:
        painting = job.painting(style["image"]).astype(float)
        for view in job.views:
            photograph = job.photograph(view).astype(float)
            job.write(style["name"], view, ColorMatcher().transfer(src=photograph, ref=painting, method="mkl"))
