"""The contract of a backbone and of its five parts."""

import pkgutil
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from typing import ClassVar, final

from jaxtyping import Float
from torch import Tensor, nn

from anystyle.contracts.style import StylePredictor
from anystyle.errors import UserError
from anystyle.registry.catalog import Pluggable
from anystyle.types import (
    Attributes,
    Clusters,
    Features,
    Gaussians,
    Geometry,
    Inject,
    Scene,
    Site,
    Source,
    Tokens,
    Views,
    contiguous,
    untouched,
)


class Embedder(nn.Module, ABC):
    """From pixels to the tokens that every later part shares: the stem.

    One that ``reads_cameras`` takes them as a second argument, ``None`` where they are not known.
    """

    reads_cameras: ClassVar[bool] = False

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
    """Cameras and depth from features; never styled.

    One that ``reads_cameras`` takes those of the views as a third argument, ``None`` where they are not known.
    """

    reads_cameras: ClassVar[bool] = False

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

    def without_colors(self, features: Features, images: Float[Tensor, "B V 3 H W"]) -> Attributes:
        """The same attributes, save that colours, which nothing will read, are zero where that saves work."""
        return self(features, images)


class Adapter(nn.Module, ABC):
    """From raw attributes to Gaussians: activations, fusion, conventions."""

    @abstractmethod
    def cluster(self, geometry: Geometry, attributes: Attributes) -> Clusters | None:
        """Decide once a scene which pixels become which Gaussian; ``None`` where each pixel is its own."""

    @abstractmethod
    def forward(self, attributes: Attributes, geometry: Geometry, clusters: Clusters | None) -> Gaussians:
        """Activate and fuse. Differentiable in ``attributes``; linear work only in the number of Gaussians."""


class Published(ABC):
    """Recognises a backbone's published checkpoints, says what they need, and loads them.

    State dicts have their publishers' names, with or without the prefixes of their file. Every method raises a
    :class:`~anystyle.errors.UserError` where the checkpoint is of another network.
    """

    @abstractmethod
    def names(self, keys: Iterable[str]) -> dict[str, str]:
        """For each key of the backbone's state dict, what its publishers call the tensor, without their prefixes."""

    @abstractmethod
    def config(self, state: Mapping[str, Tensor]) -> dict[str, object]:
        """What the checkpoint fixes of a configuration, as far as its shapes show it.

        Keys are those of overrides: ``backbone.dim``, and for a checkpoint with a style branch ``placement`` and
        all other options that the branch was trained with.
        """

    @abstractmethod
    def parts(self, state: Mapping[str, Tensor]) -> dict[str, bool]:
        """The parts it has weights of (``backbone``, ``style_encoder``, ``branch``), and whether it has all of them.

        A checkpoint that initialises part of a backbone, or adds to the weights of a style encoder, has not all.
        """

    @abstractmethod
    def load(self, part: str, module: nn.Module, state: Mapping[str, Tensor]) -> None:
        """Load one part, strictly; a module on the meta device takes the tensors themselves.

        A file that is named as ``weights.branch`` is loaded into the branch and, for what the branch was trained with,
        into the style encoder.
        """


class Backbone(Pluggable, nn.Module, ABC):
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
    trusted_cameras: bool = True
    """Whether the cameras that it predicts are good enough to make a scene with; a small network's are not."""
    needs_cameras: ClassVar[bool] = False
    """Whether views must come with cameras, which then are those of the scene; ``poses=known`` is its default."""
    frozen: bool = False
    sources: tuple[Source, ...] = ()
    """The published weights that the constructor filled it with, where it does."""
    published: ClassVar[Published | str | None] = None
    """How checkpoints in the original layout load, where there are any; ``module:Class`` is imported for the first."""

    @final
    @classmethod
    def checkpoints(cls) -> Published | None:
        """What :attr:`published` is, or names."""
        return pkgutil.resolve_name(cls.published)() if isinstance(cls.published, str) else cls.published

    @property
    @final
    def sites(self) -> tuple[Site, ...]:
        """Where style may enter; a style branch offers one more, :data:`anystyle.branch.COLOR`."""
        return self.aggregator.sites + self.gaussian_head.sites

    @property
    @final
    def reads_cameras(self) -> bool:
        """Whether the cameras of views, where they are known, change what it computes."""
        return self.needs_cameras or self.embedder.reads_cameras or self.geometry_head.reads_cameras

    @final
    def stem_of(self, views: Views) -> Tokens:
        """The embedder's tokens of views.

        Raises:
            UserError: The network needs cameras, and the views have none.
        """
        if self.needs_cameras and views.cameras is None:
            remedy = "poses=known reads those that are stored, and poses=sfm finds some"
            raise UserError(f"{type(self).__name__} needs the cameras of its views, which have none; {remedy}")
        return self.embedder(views.images, *((views.cameras,) if self.embedder.reads_cameras else ()))

    @final
    def geometry_of(self, features: Features, views: Views) -> Geometry:
        """The geometry head's prediction for views."""
        head = self.geometry_head
        return head(features, views.images, *((views.cameras,) if head.reads_cameras else ()))

    @final
    def encode(self, views: Views, *, colors: bool = True) -> Scene:
        """Compute all that does not depend on style; without ``colors`` nothing may read the unstyled ones.

        Raises:
            UserError: As :meth:`stem_of`.
        """
        # A product of a tensor that is not contiguous is rounded in one way with weights that learn, as a style branch
        # has them, and in another with frozen ones.
        stem = self.stem_of(views).contiguous()
        features = contiguous(self.aggregator(stem))
        geometry = self.geometry_of(features, views)
        head = self.gaussian_head
        attributes = head(features, views.images) if colors else head.without_colors(features, views.images)
        return Scene(views, stem, features, geometry, attributes, self.adapter.cluster(geometry, attributes))

    def make_branch(self) -> StylePredictor | None:
        """The style branch that it was published with, where style enters by other parts than injectors.

        It holds copies of what the Gaussian head computes unstyled colours with, so that both are the same bits where
        the style is the one that the head takes for none.
        """
        return None

    @final
    def load_reference(self, state: Mapping[str, Tensor]) -> None:
        """Load published weights: a state dict, with or without the prefixes of its file; parts it lacks stay.

        Raises:
            UserError: They do not fit, or no published weights of this network are known.
        """
        if (published := self.checkpoints()) is None:
            raise UserError(f"no published weights of a {type(self).__name__} are known")
        published.load("backbone", self, state)

    @final
    def freeze(self) -> "Backbone":
        """Disable gradients, and stay in ``eval`` mode even if :meth:`train` is called."""
        self.frozen = True
        return self.requires_grad_(False).train(False)

    @final
    def train(self, mode: bool = True) -> "Backbone":
        """Set the mode; a frozen backbone stays in ``eval``."""
        return super().train(mode and not self.frozen)
