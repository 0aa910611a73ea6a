from . import types as types
from .data.images import read_image as read_image
from .evaluation.run import evaluate as evaluate
from .pipeline import weights as weights
from .pipeline.controls import Controls as Controls
from .pipeline.load import load as load
from .pipeline.options import ExportOptions as ExportOptions
from .pipeline.options import PoseOptions as PoseOptions
from .pipeline.options import SplatOptions as SplatOptions
from .pipeline.options import ViewOptions as ViewOptions
from .pipeline.request import Request as Request
from .pipeline.save import save as save
from .pipeline.styles import Mixture as Mixture
from .pipeline.styles import Named as Named
from .pipeline.stylize import stylize as stylize
from .registry.build import build as build
from .registry.catalog import catalog as catalog
from .registry.catalog import plugin as plugin
from .stylizer import Stylizer as Stylizer
from .training.run import train as train

__version__: str
