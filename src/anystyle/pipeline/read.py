"""The second step: photographs, a video, views or a saved scene, as views of one size with the cameras asked for."""

from typing import TYPE_CHECKING

from omegaconf import DictConfig

from anystyle.contracts import Backbone, Reconstruction
from anystyle.errors import UserError
from anystyle.pipeline.encode import ReadViews
from anystyle.pipeline.load import LoadedModel, make_scenes
from anystyle.pipeline.options import PoseOptions, ViewOptions
from anystyle.pipeline.request import InMemory, Photographs, Request, SavedScene
from anystyle.pipeline.stages import Stages
from anystyle.reconstructions import Feedforward
from anystyle.types import SourceImage, Views

if TYPE_CHECKING:
    from anystyle.pipeline.saved import ReadSplat


def read(request: Request, model: LoadedModel, stages: Stages) -> "ReadViews | ReadSplat":
    """Read the inputs of a request, with cameras where they are known or can be estimated.

    Where the model names no reconstruction, the plugin that estimates cameras chooses it if it succeeds; elsewhere it
    is the backbone's single pass.
    """
    backbone, options, inputs = model.stylizer.backbone, request.views, request.inputs
    poses = PoseOptions(request.poses.use or model.poses, request.poses.folder)
    if options.masks is not None and not isinstance(inputs, Photographs):
        given = inputs.path if isinstance(inputs, SavedScene) else "views"
        raise UserError(f"views.masks={options.masks}: masks belong to photographs, and the input is {given}")
    match inputs:
        case SavedScene(path):
            from anystyle.pipeline.saved import read_splat

            return read_splat(path, model.stylizer, options, request.splat, stages)
        case Photographs(paths):
            from anystyle.pipeline.photographs import read_photographs

            return read_photographs(paths, backbone, options, poses, model.reconstruction, stages)
        case InMemory() | None:
            views = first_views(request.config, options) if inputs is None else inputs.views
            return _in_memory(views, backbone, poses, model.reconstruction)


def first_views(config: DictConfig, options: ViewOptions) -> Views:
    """The first views of the configured scene."""
    source = make_scenes(config)
    if not 0 <= config.scene < len(source):
        raise UserError(f"scene={config.scene} does not exist; the source holds {len(source)}")
    number = min(source.num_views(config.scene), options.take or Reconstruction.max_views)
    return source.read(config.scene, range(number))


def _in_memory(
    views: Views, backbone: Backbone, poses: PoseOptions, reconstruction: Reconstruction | None
) -> ReadViews:
    from anystyle.pipeline.cameras import with_stored

    if any(side % backbone.patch_size for side in views.size):
        wrong = f"the scene's images are {views.size}"
        raise UserError(f"{wrong}; their sides must be multiples of {backbone.patch_size}")
    names = [f"view_{index:02d}" for index in range(views.images.shape[1])]
    sources = tuple(SourceImage.covering(name, views.size, views.size) for name in names)
    return with_stored(ReadViews(views, sources, reconstruction or Feedforward()), poses)
