"""Photographs painted one by one, by the network of the default painter: ``painter.py JOB``."""

import time
from pathlib import Path

import torch
from torch import Tensor
from views import Job

import anystyle
from anystyle.data.images import read_image
from anystyle.io.atomic import write_json
from anystyle.stylizer import Stylizer
from anystyle_benchmark.job import SECONDS


@torch.no_grad()
def two_d(stylizer: Stylizer, photographs: Tensor, style: dict[str, str]) -> Tensor:
    """Photographs [V, 3, H, W] painted one by one by the network that teaches the painter its colours."""
    from anystyle_magenta.injector import MagentaInjector, stylize_images  # found once a model of it is loaded

    injector = stylizer.branch.injectors["color"]
    assert isinstance(injector, MagentaInjector)
    painting = None if style["text"] else read_image(Path(style["image"]))[None]
    vector, images = stylizer.embed(text=style["text"], image=painting).vector, photographs[None]
    for size in injector.sizes((images.shape[-2], images.shape[-1])):
        images = stylize_images(injector.network, images, vector, working_size=size)
    return images[0]


if __name__ == "__main__":
    job, start = Job(), time.process_time()
    painter, seconds = anystyle.load(), {}
    photographs = torch.stack([torch.tensor(job.photograph(view)).movedim(-1, 0) / 255 for view in job.views])
    spent = time.process_time()
    once = spent - start
    for style in job.styles:
        for view, image in zip(job.views, two_d(painter, photographs, style), strict=True):
            job.write(style["name"], view, 255 * image.movedim(0, -1).numpy())
        spent, before = time.process_time(), spent
        seconds[style["name"]] = spent - before
    write_json(job.out / SECONDS, {"scene": once, "styles": seconds})
