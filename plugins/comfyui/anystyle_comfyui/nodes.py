"""The nodes. Each calls one step of the Python API; importable only where ComfyUI runs."""

import importlib
import inspect
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

from anystyle.geometry.cameras import smooth_path
from anystyle.pipeline.controls import Controls
from anystyle.pipeline.export import export_styles
from anystyle.pipeline.load import load_model
from anystyle.pipeline.request import Request
from anystyle.pipeline.restyle import Restyler
from anystyle.pipeline.styles import Mixture, StyleInput, embed_styles
from anystyle.pipeline.stylize import encode_inputs
from anystyle.registry.catalog import catalog
from anystyle.registry.packages import presets
from anystyle.types import Progress, Style

from .running import running
from .values import Model, Scene, folder_of_images, image_from_renders, style_from_image

io: Any = importlib.import_module("comfy_api.latest").io
ui: Any = importlib.import_module("comfy_api.latest").ui
folder_paths: Any = importlib.import_module("folder_paths")

MODEL, CAPTURE = io.Custom("ANYSTYLE_MODEL"), io.Custom("ANYSTYLE_CAPTURE")
SCENE, STYLE = io.Custom("ANYSTYLE_SCENE"), io.Custom("ANYSTYLE_STYLE")


class Node(io.ComfyNode):
    """A node; its docstring is what ComfyUI shows of it."""

    title: ClassVar[str]
    inputs: ClassVar[list[Any]]
    outputs: ClassVar[list[Any]]
    is_output: ClassVar[bool] = False

    @classmethod
    def define_schema(cls) -> Any:
        """The node as ComfyUI lists it."""
        return io.Schema(
            node_id=f"AnyStyle{cls.__name__}",
            display_name=cls.title,
            category="anystyle",
            description=" ".join((inspect.getdoc(cls) or "").split()),
            inputs=cls.inputs,
            outputs=cls.outputs,
            is_output_node=cls.is_output,
        )


def _slider(name: str, default: float, low: float, high: float, step: float, tooltip: str) -> Any:
    return io.Float.Input(name, default=default, min=low, max=high, step=step, tooltip=tooltip)


def _located(source: str) -> str | Path:
    """A source as a path; relative ones are below ComfyUI's input folder."""
    source = source.strip()
    return source if source.startswith("example:") else Path(folder_paths.get_input_directory(), source).expanduser()


_OPTIONS = "Overrides of `anystyle stylize`, such as: reconstruction.quality=draft views.take=24 method=brush"
_SOURCE = "A folder, a pattern, a video or a splat, in ComfyUI's input folder or with its whole path"
_BATCH = "A batch to use instead; files in a folder are better: their EXIF data describe the lens"


class LoadModel(Node):
    """The networks that reconstruct photographs and stylize the scene."""

    title = "Load AnyStyle Model"
    inputs: ClassVar = [
        io.Combo.Input("model", options=list(presets("model")), default="default"),
        io.String.Input("options", default="", tooltip=_OPTIONS),
    ]
    outputs: ClassVar = [MODEL.Output(display_name="model")]

    @classmethod
    def execute(cls, model: str, options: str) -> Any:
        """Load it."""
        with running():
            request = Request(overrides=(f"model={model}", *shlex.split(options)))
            return io.NodeOutput(Model(request, load_model(request)))


class LoadCapture(Node):
    """Overlapping photographs of one place, a video, or a file of a Gaussian scene."""

    title = "Load Photographs"
    inputs: ClassVar = [
        io.String.Input("source", default="example:street", tooltip=_SOURCE),
        io.Image.Input("images", optional=True, tooltip=_BATCH),
    ]
    outputs: ClassVar = [CAPTURE.Output(display_name="capture")]

    @classmethod
    def fingerprint_inputs(cls, source: str, images: Any = None) -> Any:
        """What changes when files do, so that a changed folder is read again."""
        path = Path(_located(source))
        files = sorted(path.iterdir()) if path.is_dir() else [path] if path.is_file() else []
        return [source, *((file.name, file.stat().st_mtime_ns, file.stat().st_size) for file in files)]

    @classmethod
    def execute(cls, source: str, images: Any = None) -> Any:
        """Name the source; a batch becomes files in ComfyUI's temporary folder."""
        if images is None:
            return io.NodeOutput(_located(source))
        with running():
            return io.NodeOutput(folder_of_images(images, Path(folder_paths.get_temp_directory())))


class FitScene(Node):
    """Finds the cameras of photographs and fits Gaussians to them, once for any number of styles."""

    title = "Fit Scene"
    inputs: ClassVar = [MODEL.Input("model"), CAPTURE.Input("capture")]
    outputs: ClassVar = [SCENE.Output(display_name="scene")]

    @classmethod
    def execute(cls, model: Model, capture: str | Path) -> Any:
        """Encode the capture."""
        request, loaded = replace(model.request, inputs=(str(capture),)), model.loaded
        with running() as report:
            encoded = encode_inputs(request, loaded, report.stages)
            return io.NodeOutput(Scene(encoded, Restyler(encoded, loaded.method).unstyled, "unstyled", loaded))


class TextStyle(Node):
    """A style in words."""

    title = "Style from Text"
    inputs: ClassVar = [io.String.Input("text", default="thick oil paint in orange and navy", multiline=True)]
    outputs: ClassVar = [STYLE.Output(display_name="style")]

    @classmethod
    def execute(cls, text: str) -> Any:
        """Pass the words on."""
        return io.NodeOutput(text)


class ImageStyle(Node):
    """A style as a picture; of a batch the first."""

    title = "Style from Image"
    inputs: ClassVar = [
        io.Image.Input("image"),
        io.String.Input("name", default="picture", tooltip="For titles and notes"),
    ]
    outputs: ClassVar = [STYLE.Output(display_name="style")]

    @classmethod
    def execute(cls, image: Any, name: str) -> Any:
        """Turn the picture into a style."""
        with running():
            return io.NodeOutput(Style(image=style_from_image(image), names=(name.strip() or "picture",)))


class MixStyles(Node):
    """A point between two styles, of texts or pictures."""

    title = "Mix Styles"
    inputs: ClassVar = [
        STYLE.Input("first"),
        STYLE.Input("second"),
        _slider("amount", 0.5, 0.0, 1.0, 0.05, "0 is the first style, 1 the second"),
    ]
    outputs: ClassVar = [STYLE.Output(display_name="style")]

    @classmethod
    def execute(cls, first: StyleInput, second: StyleInput, amount: float) -> Any:
        """Mix them."""
        return io.NodeOutput(Mixture(first, second, amount))


class Stylize(Node):
    """Gives a scene a style. It starts from the photographs' colours, whatever style the scene had."""

    title = "Stylize Scene"
    inputs: ClassVar = [
        SCENE.Input("scene"),
        STYLE.Input("style"),
        _slider("strength", 1.0, 0.0, 1.0, 0.05, "0 is the unstyled scene"),
        _slider("preserve_color", 0.0, 0.0, 1.0, 0.05, "How much of the scene's own hues stays"),
        _slider("scale", 1.0, 0.125, 8.0, 0.125, "Size of strokes"),
    ]
    outputs: ClassVar = [SCENE.Output(display_name="scene")]

    @classmethod
    def execute(cls, scene: Scene, style: StyleInput, strength: float, preserve_color: float, scale: float) -> Any:
        """Restyle it."""
        controls = Controls(strength=strength, preserve_color=preserve_color, scale=scale)
        with running() as report:
            embedded = embed_styles([style], scene.encoded.stylizer, [controls])[0]
            gaussians = Restyler(scene.encoded, scene.loaded.method)(embedded, report)
            return io.NodeOutput(Scene(scene.encoded, gaussians, embedded.title, scene.loaded))


class Render(Node):
    """Pictures of a scene from the photographs' cameras, or of a flight through them."""

    title = "Render Scene"
    inputs: ClassVar = [
        SCENE.Input("scene"),
        io.Combo.Input("cameras", options=["photographs", "flight"], default="photographs"),
        io.Int.Input("frames", default=48, min=2, max=10_000, tooltip="Frames of the flight"),
        _slider("scale", 1.0, 0.1, 8.0, 0.1, "Relative to the views"),
    ]
    outputs: ClassVar = [io.Image.Output(display_name="images")]

    @classmethod
    def execute(cls, scene: Scene, cameras: str, frames: int, scale: float) -> Any:
        """Render it."""
        given = scene.encoded.cameras
        route = smooth_path(given, frames) if cameras == "flight" else given
        height, width = (max(2, round(side * scale / 2) * 2) if scale != 1 else side for side in given.size)
        number, images = route.intrinsics.shape[1], []
        with running() as report:
            for image in scene.encoded.render(scene.gaussians, route.resized((height, width))):
                images.append(image)
                report(Progress(f"view {len(images)} of {number}", len(images) / number, image))
            return io.NodeOutput(image_from_renders(images))


class SaveScene(Node):
    """Writes a scene into ComfyUI's output folder."""

    title = "Save Scene"
    inputs: ClassVar = [
        SCENE.Input("scene"),
        io.String.Input("filename_prefix", default="scenes/anystyle"),
        io.Combo.Input("format", options=list(catalog().names("format")), default="ply"),
    ]
    outputs: ClassVar = [io.String.Output(display_name="path")]
    is_output = True

    @classmethod
    def execute(cls, scene: Scene, filename_prefix: str, format: str) -> Any:
        """Write the file."""
        output = folder_paths.get_output_directory()
        folder, name, counter, *_ = folder_paths.get_save_image_path(filename_prefix, output)
        path = Path(folder, f"{name}_{counter:05}_.{format}")
        with running():
            size = export_styles(scene.styled(), path, format)
        line = f"{path.name}: {size / 1e6:.2f} MB, {scene.title}"
        return io.NodeOutput(str(path), ui=ui.PreviewText(line))
