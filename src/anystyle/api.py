"""The library's front door: load a model; stylize photographs, a video or views."""

import contextlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from torch import Tensor

from anystyle.inference.assemble import assemble_frozen, default_device, default_poses, method_named
from anystyle.inference.controls import Controls
from anystyle.inference.encoding import EncodedCapture as EncodedCapture
from anystyle.inference.encoding import Inputs, encode_capture, encode_splat
from anystyle.inference.options import ExportOptions, PoseOptions, SplatOptions, VideoOptions, ViewOptions
from anystyle.inference.results import Result as Result
from anystyle.inference.results import Results
from anystyle.inference.splats import is_splat
from anystyle.inference.stages import Stages
from anystyle.inference.styles import Mixture, StyleInput, embed_styles
from anystyle.io.atomic import atomic_directory
from anystyle.methods.contract import Method
from anystyle.reconstructions.contract import Reconstruction
from anystyle.registry.build import build
from anystyle.registry.compose import compose
from anystyle.stylizer import Stylizer
from anystyle.types import Style


def load(model: str | None = None, overrides: Sequence[str] = ()) -> Stylizer:
    """Build a stylizer with its weights, ready for use: in ``eval`` mode, without gradients.

    Args:
        model: A preset of the group ``model``; ``None`` for the default, which goes with any backbone.
        overrides: In Hydra's grammar, as ``anystyle stylize`` takes them, such as ``renderer=gsplat``.

    Raises:
        ValueError: The preset or an override is unknown, or weights do not fit.
        FileNotFoundError: A file of weights is missing.
    """
    return assemble_frozen(compose("stylize", [*_preset(model), *overrides]))[0]


def _preset(model: str | None) -> list[str]:
    return [] if model is None else [f"model={model}"]


def stylize(
    inputs: Inputs,
    styles: StyleInput | Sequence[StyleInput],
    *,
    model: str | Stylizer | None = None,
    views: ViewOptions = ViewOptions(),
    poses: PoseOptions | None = None,
    splat: SplatOptions = SplatOptions(),
    reconstruction: str | Reconstruction | None = None,
    method: str | Method | None = None,
    refine: bool = False,
    controls: Controls | Sequence[Controls] = Controls(),
    out: str | Path | None = None,
    export: ExportOptions = ExportOptions(),
    video: VideoOptions = VideoOptions(),
    provenance: Mapping[str, object] = MappingProxyType({}),
    stages: Stages | None = None,
) -> Results:
    """Stylize a scene: read its views, encode them once, and restyle it in each style when its result is asked for.

    Args:
        inputs: A folder of photographs, files, a pattern or a video; views that were read already; or one scene
            that was saved, a PLY file or a folder of results, which keeps its geometry.
        styles: Texts as ``str``, image files as ``Path``, images as tensors or :class:`~anystyle.types.Style`, points
            between two of these as :class:`Mixture`.
        model: A preset of the group ``model`` (``None`` for the default), which is loaded onto
            :func:`default_device`; or a stylizer, such as :func:`load` returns with overrides.
        views: How photographs are read, and how many are encoded together.
        poses: Where the cameras of photographs come from; unless it is given, ``auto`` for a preset whose backbone has
            bundled weights, and ``predicted`` elsewhere.
        splat: From where a scene is seen that is given as Gaussians.
        reconstruction: What becomes of the views: a plugin's name or an instance. ``None`` fits a scene to photographs
            whose cameras are found, and takes what the backbone predicts elsewhere.
        method: How the scene takes a style: a plugin's or a preset's name, such as ``nnfm``, or an instance. ``None``
            is the single pass.
        refine: Whether predicted cameras are aligned by what several views see alike.
        controls: How each style is applied; of several, each gives a result.
        out: A folder to write all results to; each is written when it is saved if there is none.
        export: Which files a result has.
        video: The flight through the cameras that is written with a result.
        provenance: What reports say of a stylizer that was loaded before: weights, configuration.
        stages: Times the work and announces it.

    Returns:
        One result a style and control, each computed when it is asked for.

    Raises:
        ValueError: An input or a style cannot be read, memory does not suffice, or a result is not finite.
        FileNotFoundError: A file of weights is missing.

    Example:
        >>> for result in anystyle.stylize("photos/", ["thick swirling strokes", Path("starry_night.jpg")]):
        ...     result.gaussians.save(f"{result.style.name}.ply")
    """
    single = isinstance(styles, (str, Path, Style, Tensor, Mixture))
    chosen: Sequence[StyleInput] = [styles] if single else styles
    if not isinstance(controls, Controls) and not controls:
        raise ValueError("no controls are given; leave them out, or give at least one")
    if not chosen:
        raise ValueError("no style is given; give a text, an image or both")
    stages = stages or Stages()
    with contextlib.nullcontext() if out is None else atomic_directory(out) as folder:
        if not isinstance(model, Stylizer):
            with stages("load", "the model"):
                config = compose("stylize", _preset(model))
                model, weights = assemble_frozen(config)
                model = model.to(default_device())
            provenance = {"weights": weights, **provenance}
            poses = poses or PoseOptions(default_poses(config))
        rebuilt = build(Reconstruction, reconstruction) if isinstance(reconstruction, str) else reconstruction
        given = is_splat(inputs)
        if given is not None:
            encoded = encode_splat(given, model, views, splat, stages=stages)
        else:
            encoded = encode_capture(
                inputs, model, views, poses or PoseOptions(), refined=refine, stages=stages, reconstruction=rebuilt
            )
        with stages("embed", "the styles"):
            embedded = embed_styles(chosen, model, [controls] if isinstance(controls, Controls) else controls)
            chosen_method = method_named(method, model.style_encoder) if isinstance(method, str) else method
        results = Results(
            encoded, embedded, method=chosen_method, export=export, video=video, provenance=provenance, stages=stages
        )
        if folder is not None:
            results.write(folder)
    return results
