"""The Kuwahara filter of the package pykuwahara, which asks for no style: ``pykuwahara_views.py JOB``."""

from pykuwahara import kuwahara  # pyright: ignore[reportMissingImports]
from views import Job

if __name__ == "__main__":
    job = Job()
    for view in job.views:
        painted = kuwahara(job.photograph(view), method="gaussian", radius=4)
        for style in job.styles:
            job.write(style["name"], view, painted)
