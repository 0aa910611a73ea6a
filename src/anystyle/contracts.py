"""The contracts of plugins, one class for each kind.

A plugin inherits from one of these classes, implements its abstract methods and is listed in one line of
TOML. ``anystyle.testing`` holds each contract as plain functions; ``anystyle plugins check`` runs them, on an instance
built with the options of :meth:`~anystyle.registry.socket.Socket.example`, the defaults unless overridden.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, final

import torch
import torchmetrics
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.errors import UserError
from anystyle.published import Published
from anystyle.registry.socket import Socket
from anystyle.types import (
    Attributes,
    Cameras,
    Clusters,
    Comparison,
    Features,
    Flow,
    Frames,
    Gaussians,
    Geometry,
    Inject,
    OnProgress,
    Reconstructed,
    Renders,
    Scene,
    Site,
    Style,
    StyledScene,
    Stylization,
    TextMatch,
    Tokens,
    Views,
    contiguous,
    no_progress,
    untouched,
)
from anystyle.vision.weights import Source


class Embedder(nn.Module, ABC):
    """From pixels to the tokens that every later part shares: the stem."""

    @abstractmethod
    def forward(self, images: Float[Tensor, "B V 3 H W"]) -> Tokens:
        """Embed sRGB images in [0, 1]; any normalisation is the embedder's own."""


class Aggregator(nn.Module, ABC):
    """The transformer that lets views see each other, and is copied when style enters it."""

    @property
    @abstractmethod
    def sites(self) -> tuple[Site, ...]:
        """Where style may enter, named ``aggregator/...``, in the order of the computation."""

    @abstractmethod
    def forward(self, stem: Tokens, inject: Inject = untouched) -> Features:
        """Turn the stem into tapped features, calling ``inject`` at every site."""


class GeometryHead(nn.Module, ABC):
    """Cameras and depth from features; never styled."""

    @abstractmethod
    def forward(self, features: Features, images: Float[Tensor, "B V 3 H W"]) -> Geometry:
        """Predict geometry at the size of the sRGB images in [0, 1], which it may look at."""


class GaussianHead(nn.Module, ABC):
    """One raw Gaussian a pixel from features; copied when style enters it or the aggregator."""

    @property
    @abstractmethod
    def sites(self) -> tuple[Site, ...]:
        """Where style may enter, named ``head/...``, in the order of the computation."""

    @abstractmethod
    def forward(self, features: Features, images: Float[Tensor, "B V 3 H W"], inject: Inject = untouched) -> Attributes:
        """Predict raw attributes from features and sRGB images in [0, 1], calling ``inject`` at every site."""


class Adapter(nn.Module, ABC):
    """From raw attributes to Gaussians: activations, fusion, conventions."""

    @abstractmethod
    def cluster(self, geometry: Geometry, attributes: Attributes) -> Clusters | None:
        """Decide once a scene which pixels become which Gaussian; ``None`` where each pixel is its own."""

    @abstractmethod
    def forward(self, attributes: Attributes, geometry: Geometry, clusters: Clusters | None) -> Gaussians:
        """Activate and fuse. Differentiable in ``attributes``; linear work only in the number of Gaussians."""


class Backbone(Socket, nn.Module, ABC):
    """A feed-forward reconstruction network in five parts.

    The constructor sets all five, ``patch_size`` (image sides are multiples of it) and ``resolution`` (the shorter
    side, in pixels, that its weights were made for).
    """

    embedder: Embedder
    aggregator: Aggregator
    geometry_head: GeometryHead
    gaussian_head: GaussianHead
    adapter: Adapter
    patch_size: int
    resolution: int
    frozen: bool = False
    sources: tuple[Source, ...] = ()
    """The published weights that the constructor filled it with, where it does."""
    published: ClassVar[Published | None] = None
    """How checkpoints in the original layout load, where there are any."""

    @property
    @final
    def sites(self) -> tuple[Site, ...]:
        """Where style may enter; a style branch offers one more, :data:`anystyle.branch.COLOR`."""
        return self.aggregator.sites + self.gaussian_head.sites

    @final
    def encode(self, views: Views) -> Scene:
        """Compute all that does not depend on style."""
        # A product of a tensor that is not contiguous is rounded in one way with weights that learn, as a style branch
        # has them, and in another with frozen ones.
        stem = self.embedder(views.images).contiguous()
        features = contiguous(self.aggregator(stem))
        geometry = self.geometry_head(features, views.images)
        attributes = self.gaussian_head(features, views.images)
        clusters = self.adapter.cluster(geometry, attributes)
        return Scene(views, stem, features, geometry, attributes, clusters)

    @final
    def load_reference(self, state: Mapping[str, Tensor]) -> None:
        """Load published weights: a state dict, with or without the prefixes of its file; parts it lacks stay.

        Raises:
            UserError: They do not fit, or no published weights of this network are known.
        """
        if self.published is None:
            raise UserError(f"no published weights of a {type(self).__name__} are known")
        self.published.load("backbone", self, state)

    @final
    def freeze(self) -> "Backbone":
        """Disable gradients, and stay in ``eval`` mode even if :meth:`train` is called."""
        self.frozen = True
        return self.requires_grad_(False).train(False)

    @final
    def train(self, mode: bool = True) -> "Backbone":
        """Set the mode; a frozen backbone stays in ``eval``."""
        return super().train(mode and not self.frozen)


class StyleEncoder(Socket, nn.Module, ABC):
    """Images and texts in one space.

    The constructor sets ``dim``, the space's dimensions, and ``neutral``, the prompt that stands for no style.
    """

    dim: int
    neutral: str
    unit_norm: bool = True
    """Whether all embeddings have norm 1."""
    reads_texts: bool = True
    """Whether it embeds any text; where not, only the neutral prompt, and others raise a ValueError."""
    sources: tuple[Source, ...] = ()
    """The published weights that the constructor filled it with, where it does."""

    @abstractmethod
    def embed_images(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M D"]:
        """Embeddings of sRGB images in [0, 1] of any size; differentiable in the images."""

    @abstractmethod
    def embed_texts(self, texts: Sequence[str]) -> Float[Tensor, "M D"]:
        """Embeddings of texts.

        Raises:
            ValueError: A text is empty or longer than the encoder reads.
        """

    def load_published(self, state: Mapping[str, Tensor]) -> None:
        """Load weights under their publishers' names, strictly; on the meta device it takes the tensors themselves.

        Raises:
            UserError: They do not fit, or no published weights of this encoder are known.
        """
        raise UserError(f"no published weights of a {type(self).__name__} are known; give one that anystyle wrote")

    def match_text(self, text: str) -> TextMatch | None:
        """The nearest known description to a text, and the words that are unknown; ``None`` if it cannot tell."""
        return None


class Injector(Socket, nn.Module, ABC):
    """How style changes tokens at one site.

    The framework passes ``dim`` (channels at the site), ``style_dim`` and the :class:`~anystyle.types.Site` as ``site``
    to a constructor that names them. At initialisation it is the identity, bit for bit; it is equivariant to the order
    of views.
    """

    sources: tuple[Source, ...] = ()
    """The published weights that the constructor filled it with, where it does."""

    @abstractmethod
    def forward(self, tokens: Tokens, style: Float[Tensor, "B D"]) -> Tokens:
        """Tokens of the same shape, grid and kind."""

    def at_scale(self, scale: float) -> "Injector | None":
        """This injector, parameters shared, for strokes ``scale`` times as large; ``None`` if it paints none."""
        return None


class Placement(Socket, ABC):
    """Which sites style enters, of a backbone's and :data:`anystyle.branch.COLOR`."""

    @abstractmethod
    def select(self, sites: Sequence[Site]) -> tuple[Site, ...]:
        """The chosen sites, in the given order.

        Raises:
            ValueError: None is left.
        """


class Renderer(Socket, ABC):
    """A differentiable 3DGS rasteriser."""

    devices: ClassVar[tuple[str, ...]] = ()
    """The types of device that it runs on, as in ``torch.device.type``; empty for any."""
    priority: ClassVar[int] = 0
    """``renderer=auto`` takes the renderer of the highest priority among those that run on the tensors' device, of
    equal ones the first by name, and gives it the options ``background, near, far, eps2d``. 0: never taken; 1: plain
    PyTorch; 10: the kernels that come with anystyle."""

    @abstractmethod
    def __call__(self, gaussians: Gaussians, cameras: Cameras) -> Renders:
        """Render every camera of every scene, differentiable in the Gaussians and the camera poses."""


class Reconstruction(Socket, ABC):
    """From the views of one scene to the scene that is styled; run once per scene."""

    needs_cameras: ClassVar[bool] = False
    """Whether views must come with cameras. One that does takes all views at once; others may get them in groups."""

    short_side: int | None = None
    """Shorter side in pixels that it is best given views at; smaller photographs stay as they are. ``None`` is the
    backbone's resolution."""

    max_views: int = 48
    """The most photographs of a scene that are read where ``views.take`` sets no number."""

    @abstractmethod
    def __call__(
        self,
        views: Views,
        encode: Callable[[Views], Scene],
        renderer: Renderer,
        *,
        points: Sequence[Float[Tensor, "_ 3"]] | None = None,
        on_progress: OnProgress = no_progress,
    ) -> Reconstructed:
        """Reconstruct one scene, in the frame of its cameras where these are known.

        Args:
            views: A batch of one; with cameras if they are needed.
            encode: Encodes views in the backbone's single pass.
            renderer: Differentiable; the one that will show the scene.
            points: For each view, sparse points in world space that it shows, where some are known.
            on_progress: Called every few seconds.

        Raises:
            UserError: The views do not suffice, or lack cameras.
        """


class Loss(Socket, nn.Module, ABC):
    """One unweighted term of the objective. The framework may pass ``style_encoder`` to the constructor."""

    weight: float
    needs_unstyled: bool = False
    """Set by an instance that compares with renders of the unstyled scene, which the training then makes as well."""

    @abstractmethod
    def forward(self, result: Stylization) -> Float[Tensor, ""]:
        """The term's value for a batch; the framework multiplies by ``weight``."""


class Metric(Socket, torchmetrics.Metric, ABC):
    """A figure of merit. The framework may pass ``style_encoder`` and ``correspondence`` to the constructor."""

    better: ClassVar[Mapping[str, str]]
    """For each name that :meth:`compute` returns, ``higher`` or ``lower``."""

    stand_ins: Mapping[str, str] = MappingProxyType({})
    """Set by an instance: for each figure that a stand-in network computes, the network's name."""

    weights: Mapping[str, str] = MappingProxyType({})
    """Set by an instance: the SHA-256 of every file of weights that figures rest on, by the file's name."""

    gallery: Sequence[Float[Tensor, "3 h w"]] = ()
    """Set by a protocol: further style images to retrieve from, beside those of the comparisons."""

    is_differentiable = False

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        cls.higher_is_better = "lower" not in getattr(cls, "better", {}).values()

    @abstractmethod
    def update(self, comparison: Comparison) -> None:
        """Take in stylized scenes."""

    @abstractmethod
    def compute(self) -> dict[str, Tensor]:
        """The figures over all that was taken in; ``nan`` with a warning where there was too little."""

    def of_each_row(self) -> dict[str, Float[Tensor, " N"]]:
        """Figures that each row taken in, in order, has only beside the others of its scene."""
        return {}

    def plot(self, val: Any = None, ax: Any = None) -> Any:
        """Draw figures as other metrics of torchmetrics do; needs matplotlib (``pip install "anystyle[report]"``).

        Args:
            val: What :meth:`compute` or a call returned, or a list of these, one a step; computed if not given.
            ax: Matplotlib's axes to draw on.

        Returns:
            Matplotlib's figure and axes.
        """
        return self._plot(val, ax)


class Correspondence(Socket, ABC):
    """Where the pixels of one frame are seen in another."""

    sources: tuple[Source, ...] = ()
    """The networks it rests on; set by the constructor of one that has any."""

    @abstractmethod
    def __call__(self, source: Frames, target: Frames) -> Flow:
        """Flow from ``source`` to ``target``, pair by pair.

        Raises:
            ValueError: The frames lack what this correspondence needs, or are too small for it.
        """

    def displacement(self, source: Frames, target: Frames) -> Float[Tensor, "M 2 H W"]:
        """The flow without visibility; override it where that is cheaper.

        Raises:
            ValueError: As :meth:`__call__`.
        """
        return self(source, target).displacement


class SceneSource(Socket, ABC):
    """Scenes to learn from or to be judged on, read at random; all views of one scene have one size."""

    @abstractmethod
    def __len__(self) -> int:
        """How many scenes there are."""

    @abstractmethod
    def name(self, scene: int) -> str:
        """A name for a scene, unique within the source."""

    @abstractmethod
    def num_views(self, scene: int) -> int:
        """How many views a scene has, in capture order."""

    @abstractmethod
    def read(self, scene: int, views: Sequence[int]) -> Views:
        """Some views of one scene as a batch of one, on the CPU; nothing else is decoded."""


class StyleSource(Socket, ABC):
    """Styles to learn from or to be judged on, read at random; all images have one size."""

    @abstractmethod
    def __len__(self) -> int:
        """How many styles there are."""

    @abstractmethod
    def read(self, style: int) -> Style:
        """One style as a batch of one, on the CPU."""


class Format(Socket, ABC):
    """A file format of Gaussian scenes; its name is the suffix of the files.

    A constructor that names ``renderer`` is given a function from Gaussians and cameras to renders if there is one.
    """

    up: ClassVar[str] = "opencv"
    """Axes of the format's files, unless they say otherwise: ``opencv``, ``y`` or ``z`` up."""
    reads: ClassVar[bool] = False
    """Whether files are read, too."""
    needs_cameras: ClassVar[bool] = False
    """Whether a file is made from cameras; those beside a scene's file are found."""
    has_notes: ClassVar[bool] = False
    """Whether a file has room for :attr:`~anystyle.types.StyledScene.notes`."""
    has_offset: ClassVar[bool] = False
    """Whether a file has room for :attr:`~anystyle.types.StyledScene.offset`."""

    many_styles: ClassVar[bool] = False
    """Whether a file has room for several styles."""

    @abstractmethod
    def write(self, scene: StyledScene, path: Path) -> None:
        """Write a scene, whole or not at all.

        Args:
            scene: In the axes of :attr:`up` unless others were asked for; every Gaussian is visible. A format with room
                for one style takes the last.
            path: The file.

        Raises:
            UserError: The format cannot hold the scene.
        """

    def read(self, path: Path) -> StyledScene:
        """Read a scene in the file's own axes, which are its ``up``; without cameras where the file has none.

        Raises:
            UserError: The file is damaged, or none of this format.
        """
        raise UserError(f"{path}: files of this format are written, and not read")


@torch.no_grad()
def neutral_embedding(encoder: StyleEncoder) -> Float[Tensor, "1 D"]:
    """The embedding of the encoder's neutral prompt, which style directions start from."""
    return encoder.embed_texts([encoder.neutral])
