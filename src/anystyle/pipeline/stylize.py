"""``stylize``, for the command and the Python API: load, read, encode, restyle, save."""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

from PIL import Image
from torch import Tensor

from anystyle.contracts import Method, Reconstruction
from anystyle.errors import UserError
from anystyle.io.atomic import atomic_directory, folder_lock
from anystyle.io.documents import kept_json
from anystyle.pipeline.controls import Controls
from anystyle.pipeline.encode import encode
from anystyle.pipeline.load import load_model
from anystyle.pipeline.options import ExportOptions, PoseOptions, SplatOptions, ViewOptions
from anystyle.pipeline.read import read
from anystyle.pipeline.request import GivenInputs, Request
from anystyle.pipeline.results import Restyler, Results, StylizeRun
from anystyle.pipeline.save import Failures, write
from anystyle.pipeline.stages import Stages
from anystyle.pipeline.styles import Mixture, Named, StyleInput, embed_styles
from anystyle.pipeline.words import digest, recorded
from anystyle.stylizer import Stylizer
from anystyle.types import Style
from anystyle.types.seeds import seeded


def stylize(
    inputs: GivenInputs | Request,
    styles: StyleInput | Sequence[StyleInput] = (),
    *,
    model: str | Stylizer | None = None,
    views: ViewOptions | None = None,
    poses: PoseOptions | None = None,
    splat: SplatOptions | None = None,
    reconstruction: str | Reconstruction | None = None,
    method: str | Method | None = None,
    controls: Controls | Sequence[Controls] = Controls(),
    out: str | Path | None = None,
    overwrite: bool = False,
    export: ExportOptions | None = None,
    video: Mapping[str, object] = MappingProxyType({}),
    seed: int | None = None,
    stages: Stages | None = None,
) -> Results:
    """Stylize a scene: read its views, encode them once, and restyle it in each style when its result is asked for.

    Args:
        inputs: A folder of photographs, files, a pattern or a video; views that were read already; or a saved scene, a
            PLY file or a folder of results, which keeps its geometry. Or a :class:`~anystyle.Request`, which holds the
            other arguments; with it only parts that are in memory, ``out`` and ``stages`` are given.
        styles: Texts as ``str``, image files as ``Path``, images as tensors or :class:`~anystyle.types.Style`, points
            between two of these as :class:`Mixture`; texts and files under another name as :class:`Named`.
        model: A preset of the group ``model`` (``None`` for the default), loaded onto a GPU where there is one; or a
            stylizer, such as :func:`anystyle.load` returns.
        views: How photographs are read, and how many are encoded together.
        poses: Where the cameras of photographs come from.
        splat: Where a scene that is given as Gaussians is seen from.
        reconstruction: What makes a scene of the views: a plugin's name or an instance. ``None`` is the model's
            configuration; and where that names none, a fit to photographs whose cameras are found, else what the
            backbone predicts.
        method: How the scene takes a style: the name of a plugin or a preset, such as ``nnfm``, or an instance.
            ``None`` is the model's configuration, and the single pass for a stylizer.
        controls: How each style is applied; of several, each gives a result.
        out: A folder to write all results to; without one :func:`anystyle.save` does. One that holds results of
            another request is refused, and so is one that another process is writing results to.
        overwrite: Whether results of another request in ``out`` are deleted when the new ones are written.
        export: Which files a result has.
        video: Options of the film of each result, such as ``{"path": "orbit"}``: those of
            :class:`~anystyle.pipeline.options.VideoOptions`.
        seed: The seed of random numbers.
        stages: Times and reports the work.

    Returns:
        One result per style and control, each computed when it is asked for.

    Raises:
        UserError: An input or a style cannot be read, memory does not suffice, a result is not finite, ``out`` is not
            free, or a format cannot hold the scene, and all other files are in ``out``.
        FileNotFoundError: A file of weights is missing.

    Example:
        >>> for result in anystyle.stylize("photos/", ["thick swirling strokes", Path("starry_night.jpg")]):
        ...     result.gaussians.save(f"{result.style.name}.ply")
    """
    if isinstance(inputs, Request):
        request = inputs
    else:
        request = Request.of(
            inputs,
            [styles] if isinstance(styles, (str, Path, Style, Tensor, Mixture, Named, Image.Image)) else styles,
            [controls] if isinstance(controls, Controls) else controls,
            model=model if isinstance(model, str) else None,
            reconstruction=reconstruction if isinstance(reconstruction, str) else None,
            method=method if isinstance(method, str) else None,
            views=views, poses=poses, splat=splat, export=export, video=dict(video), seed=seed,
        )  # fmt: skip
    parts = {"stylizer": model, "reconstruction": reconstruction, "method": method}
    in_memory = {name: part for name, part in parts.items() if part is not None and not isinstance(part, str)}
    stages = stages or Stages()
    request.check()
    known = not in_memory
    asked = {"request": recorded(request) if known else None, "request_sha256": digest(request) if known else None}
    with seeded(request.seed), _results_folder(out, request, overwrite, asked["request_sha256"]) as folder:
        with stages("load", "the model"):
            loaded = load_model(request, **in_memory)
        with stages("embed", "the styles"):  # before the scene, which takes longer than to find a mistake in these
            embedded = embed_styles(request.all_styles, loaded.stylizer, request.controls)
        encoded = encode(read(request, loaded, stages), loaded.stylizer, request.views, stages)
        results = Results(StylizeRun(Restyler(encoded, loaded.method), loaded, request, asked, stages), embedded)
        failures = Failures() if folder is None else write(results, folder)
    failures.tell(Path(out or ""))
    return results


@contextlib.contextmanager
def _results_folder(out: str | Path | None, request: Request, overwrite: bool, again: object) -> Iterator[Path | None]:
    """A temporary folder whose files move to ``out``, which is refused before the work begins if it is not free.

    It is free for a request of the digest ``again`` whose results it holds: the same files are made again.
    """
    if out is None:
        yield None
        return
    out = Path(out)
    single = len(request.all_styles) * len(request.controls) == 1
    names = ("renders", "scene.ply", *(("sparse",) if request.export.colmap != "none" else ())) if single else ()
    busy = f"another run writes its results to {out}; wait for its end, or give another --out"
    with (
        folder_lock(out, busy) as check,
        atomic_directory(out, ("report.json", "sheet.png", *names), overwrite=overwrite) as folder,
    ):
        report = kept_json(out / "report.json", dict[str, Any])
        if report is not None and not overwrite and (again is None or report.get("request_sha256") != again):
            ways = "--overwrite (in Python overwrite=True) replaces them, another --out keeps them"
            raise UserError(f"{out} holds results of another run; {ways}")
        yield folder
        check()
