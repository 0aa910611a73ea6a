"""2D stylization of each photograph, its colours solved back onto the Gaussians: the baseline of all 3D stylization."""

from dataclasses import replace
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Method
from anystyle.data.folder import image_files, read_picture
from anystyle.data.images import to_tensor
from anystyle.errors import UserError
from anystyle.geometry.harmonics import rgb_from_constant
from anystyle.methods.colors import colors_alone, fit_colors
from anystyle.paths import expanded
from anystyle.ranges import Count
from anystyle.stylizer import Stylizer
from anystyle.types import Gaussians, Scene, Style, StyleEmbedding
from anystyle.types.progress import OnProgress, Progress, no_progress


class Projection(Method):
    """Stylize every photograph by itself in 2D, and solve the colours of the Gaussians for them by least squares.

    The 2D stylizer may be any: by default it is a style branch that styles only the colours of pixels
    (``placement=color``), applied to each view separately.

    Args:
        images: A folder of stylized photographs of any origin, one a view in the views' order.
        steps: Steps of conjugate gradients after the weighted means; see ``fit_colors``.
        damping: Pulls each colour towards its weighted mean.
        keep_harmonics: Whether harmonics above degree 0 stay as they are; they are dropped otherwise.
    """

    def __init__(
        self, *, images: str | None = None, steps: Count = 8, damping: float = 0.01, keep_harmonics: bool = False
    ) -> None:
        self.keep_harmonics = keep_harmonics
        self.images, self.steps, self.damping = None if images is None else expanded(images), steps, damping

    def __call__(
        self,
        stylizer: Stylizer,
        scene: Scene,
        style: Style,
        embedding: StyleEmbedding,
        *,
        on_progress: OnProgress = no_progress,
    ) -> Gaussians:
        if self.images is None:
            targets = stylized_views(stylizer, scene, embedding)
        else:
            targets = images_of_views(self.images, scene).to(scene.views.images)
        on_progress(Progress(f"{len(targets)} views stylized in 2D", thumbnail=targets[0]))
        with torch.no_grad():
            gaussians = stylizer.unstyled(scene)
        cameras, renderer = scene.cameras, stylizer.renderer
        with torch.enable_grad():
            fitted = fit_colors(
                gaussians, cameras, targets, renderer, steps=self.steps, damping=self.damping,
                keep=self.keep_harmonics, alpha=None if scene.views.alpha is None else scene.views.alpha[0],
            )  # fmt: skip
        return fitted.detach()


@torch.no_grad()
def stylized_views(stylizer: Stylizer, scene: Scene, embedding: StyleEmbedding) -> Float[Tensor, "V 3 H W"]:
    """Each view stylized separately by the style branch."""
    if stylizer.branch.gaussian_head is not None:
        raise UserError(
            "method=projection needs a 2D stylizer: a model whose style branch is at placement=color, or a folder of "
            "stylized photographs as method.images"
        )
    views = []
    for view in range(scene.views.images.shape[1]):
        alone = colors_alone(replace(scene.views.select([view]), cameras=scene.cameras.select([view])))
        color = stylizer.branch(alone, embedding).color  # 1 1 H W 3 K
        views.append(rgb_from_constant(color[0, 0, ..., 0]).clamp(0, 1).movedim(-1, 0))
    return torch.stack(views).float()


def images_of_views(folder: Path, scene: Scene) -> Float[Tensor, "V 3 H W"]:
    """The images of a folder in natural order, resized to a scene's views."""
    files, num_views = image_files(folder), scene.views.images.shape[1]
    if len(files) != num_views:
        raise UserError(f"method.images={folder} has {len(files)} images, and the scene has {num_views} views")
    return torch.stack([to_tensor(read_picture(file, file.stem, scene.views.size)[0]) for file in files])
