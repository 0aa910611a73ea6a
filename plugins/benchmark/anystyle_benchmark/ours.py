"""A method of ``anystyle stylize`` in a process of its own: ``python -m anystyle_benchmark.ours JOB ARGUMENT...``."""

import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch

import anystyle
from anystyle.cli.run import run
from anystyle.errors import UserError
from anystyle.io.atomic import write_json
from anystyle.io.documents import read_json
from anystyle.io.sheet import save_png, to_pil
from anystyle.pipeline import words
from anystyle.pipeline.request import inputs_of
from anystyle.pipeline.results import Results
from anystyle.types import Cameras, SourceImage
from anystyle_benchmark.job import SECONDS, WEIGHTS, Job


def main(job_file: str, args: Sequence[str]) -> None:
    """Render a job's views in its styles; views are read at the job's size unless an argument says otherwise."""
    job: Job = read_json(job_file, Job, what="job of a benchmark")
    start = time.process_time()
    results, cameras = stylized(job, args)
    loaded = {str(one["file"]): str(one["sha256"]) for one in results.run.model.networks.values()}
    write_json(Path(job.out) / WEIGHTS, loaded)
    spent = time.process_time()
    # A fit that an earlier method left in the cache took no time now: that method's record has its seconds.
    once = None if results.encoded.reconstruction.get("kept") else spent - start
    seconds: dict[str, float] = {}
    for style, result in zip(job.styles, results, strict=True):
        folder = Path(job.out) / style.name
        folder.mkdir(parents=True, exist_ok=True)
        for view, image in zip(job.views, result.render(cameras), strict=True):
            save_png(to_pil(image), folder / f"{view}.png")
        spent, before = time.process_time(), spent
        seconds[style.name] = spent - before
        write_json(Path(job.out) / SECONDS, {"scene": once, "styles": seconds})


def stylized(job: Job, args: Sequence[str]) -> tuple[Results, Cameras]:
    """A job's results, each computed when it is asked for, and its cameras; ``args`` are those of a preset."""
    given = [f"views.short_side={min(job.size)}", f"seed={job.seed}"]
    request = replace(
        words.request([*given, *(word.replace("{seed}", str(job.seed)) for word in args)]),
        inputs=inputs_of(list(job.photographs.values())),
        styles=tuple(str(style.text) if style.image is None else Path(style.image) for style in job.styles),
    )
    results = anystyle.stylize(request)
    return results, judged_cameras(results.encoded.cameras, results.encoded.sources, job.views, job.size)


def judged_cameras(
    cameras: Cameras, sources: Sequence[SourceImage], views: Sequence[str], size: tuple[int, int]
) -> Cameras:
    """The cameras of whole photographs at a size, the parts that views leave out included."""
    names = [source.name for source in sources]
    if absent := [view for view in views if view not in names]:
        raise UserError(f"the camera of photograph {absent[0]} was not found")
    chosen = [names.index(view) for view in views]
    whole = [sources[index].source_intrinsics(cameras.intrinsics[0, index]) for index in chosen]
    known = replace(cameras.select(chosen), intrinsics=torch.stack(whole)[None], size=sources[chosen[0]].size)
    return known.resized(size)


if __name__ == "__main__":
    run(lambda: main(sys.argv[1], sys.argv[2:]))
