"""``stylize``, for the command and the Python API: load, read, encode, restyle, save."""

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

from omegaconf import DictConfig
from torch import Tensor

from anystyle.contracts import Method, Reconstruction
from anystyle.errors import UserError
from anystyle.io.atomic import atomic_directory
from anystyle.pipeline.controls import Controls
from anystyle.pipeline.encode import EncodedCapture, encode
from anystyle.pipeline.export import film
from anystyle.pipeline.load import load_model
from anystyle.pipeline.options import ExportOptions, PoseOptions, SplatOptions, ViewOptions
from anystyle.pipeline.provenance import photographs
from anystyle.pipeline.read import Inputs, check_inputs, paths_of, read, saved_path
from anystyle.pipeline.save import Results
from anystyle.pipeline.stages import Stages
from anystyle.pipeline.styles import Mixture, Places, StyleInput, check_styles, embed_styles
from anystyle.stylizer import Stylizer
from anystyle.types import Style, Views


def stylize(
    inputs: Inputs,
    styles: StyleInput | Sequence[StyleInput],
    *,
    model: str | DictConfig | Stylizer | None = None,
    views: ViewOptions = ViewOptions(),
    poses: PoseOptions = PoseOptions(),
    splat: SplatOptions = SplatOptions(),
    reconstruction: str | Reconstruction | None = None,
    method: str | Method | None = None,
    controls: Controls | Sequence[Controls] = Controls(),
    out: str | Path | None = None,
    export: ExportOptions = ExportOptions(),
    video: Mapping[str, object] = MappingProxyType({}),
    provenance: Mapping[str, object] = MappingProxyType({}),
    stages: Stages | None = None,
) -> Results:
    """Stylize a scene: read its views, encode them once, and restyle it in each style when its result is asked for.

    Args:
        inputs: A folder of photographs, files, a pattern or a video; views that were read already; or a saved scene, a
            PLY file or a folder of results, which keeps its geometry.
        styles: Texts as ``str``, image files as ``Path``, images as tensors or :class:`~anystyle.types.Style`, points
            between two of these as :class:`Mixture`, several in one scene as :class:`Places`.
        model: A preset of the group ``model`` (``None`` for the default) or a composed configuration, loaded onto a GPU
            where there is one; or a stylizer, such as :func:`anystyle.load` returns.
        views: How photographs are read, and how many are encoded together.
        poses: Where the cameras of photographs come from.
        splat: Where a scene that is given as Gaussians is seen from.
        reconstruction: What makes a scene of the views: a plugin's name or an instance. ``None`` is the model's
            configuration; and where that names none, a fit to photographs whose cameras are found, else what the
            backbone predicts.
        method: How the scene takes a style: the name of a plugin or a preset, such as ``nnfm``, or an instance.
            ``None`` is the model's configuration, and the single pass for a stylizer.
        controls: How each style is applied; of several, each gives a result.
        out: A folder to write all results to; without one each is written when it is saved.
        export: Which files a result has.
        video: Options of the film of each result, such as ``{"path": "orbit"}``: those of the format ``mp4``.
        provenance: Entries for reports, such as the seed.
        stages: Times and reports the work.

    Returns:
        One result a style and control, each computed when it is asked for.

    Raises:
        UserError: An input or a style cannot be read, memory does not suffice, or a result is not finite.
        FileNotFoundError: A file of weights is missing.

    Example:
        >>> for result in anystyle.stylize("photos/", ["thick swirling strokes", Path("starry_night.jpg")]):
        ...     result.gaussians.save(f"{result.style.name}.ply")
    """
    given = [styles] if isinstance(styles, (str, Path, Style, Tensor, Mixture, Places)) else styles
    applied = [controls] if isinstance(controls, Controls) else controls
    if not given or not applied:
        raise UserError("no style is given; give a text or an image, and leave controls out or give at least one")
    check_inputs(inputs, poses)
    check_styles(given)
    stages = stages or Stages()
    film(video)  # refuses options that make no sense before the work
    with contextlib.nullcontext() if out is None else atomic_directory(out, export.folders) as folder:
        with stages("load", "the model"):
            loaded = load_model(model, reconstruction, method)
        with stages("embed", "the styles"):  # before the scene, which takes longer than to find a mistake in these
            embedded = embed_styles(given, loaded.stylizer, applied)
        encoded = encode_inputs(
            inputs,
            loaded.stylizer,
            views,
            PoseOptions(poses.use or loaded.poses, poses.folder),
            splat,
            loaded.reconstruction,
            stages,
        )
        results = Results(
            encoded,
            embedded,
            method=loaded.method,
            export=export,
            video=video,
            provenance={"weights": loaded.weights, **provenance},
            stages=stages,
        )
        if folder is not None:
            results.write(folder)
    return results


def encode_inputs(
    inputs: Inputs,
    stylizer: Stylizer,
    views: ViewOptions,
    poses: PoseOptions,
    splat: SplatOptions,
    reconstruction: Reconstruction | None,
    stages: Stages,
) -> EncodedCapture:
    """Read inputs of any kind and encode them; the arguments are those of :func:`stylize`."""
    saved = saved_path(inputs)
    if views.masks is not None and (saved is not None or isinstance(inputs, Views)):
        raise UserError(f"views.masks={views.masks}: masks belong to photographs, and the input is {saved or 'views'}")
    if saved is not None:
        from anystyle.pipeline.splats import encode_saved

        return encode_saved(saved, stylizer, views, splat, stages)
    encoded = encode(read(inputs, stylizer.backbone, views, poses, reconstruction, stages), stylizer, views, stages)
    return replace(encoded, notes=photographs([] if isinstance(inputs, Views) else paths_of(inputs), encoded.sources))
