"""2D stylization of each photograph, its colours solved back onto the Gaussians: the baseline of all 3D stylization."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.data.folder import image_files, read_picture
from anystyle.data.images import to_tensor
from anystyle.geometry.harmonics import rgb_from_constant
from anystyle.methods.contract import Method, Progress, silent
from anystyle.reconstructions.colors import colors_alone, fit_colors
from anystyle.stylizer import Stylizer
from anystyle.types import Gaussians, Scene, Style, StyleEmbedding


class Projection(Method):
    """Stylize every photograph by itself in 2D, and solve the colours of the Gaussians for them by least squares.

    Any 2D stylizer will do: without ``images`` it is the style branch, where it styles the colours of pixels alone
    (``placement=color``, as in ``model=painter``), run on each view as if there were no other.

    Args:
        images: A folder of stylized photographs of any origin, one a view in the views' order.
        steps: Of conjugate gradients after the weighted means; see ``fit_colors``.
        damping: Pulls each colour towards its weighted mean.
    """

    def __init__(self, *, images: str | None = None, steps: int = 8, damping: float = 0.01) -> None:
        if steps < 0:
            raise ValueError(f"method.steps={steps}; give 0 or more")
        self.images, self.steps, self.damping = None if images is None else Path(images).expanduser(), steps, damping

    def __call__(
        self,
        stylizer: Stylizer,
        scene: Scene,
        style: Style,
        embedding: StyleEmbedding,
        *,
        on_progress: Callable[[Progress], None] = silent,
    ) -> Gaussians:
        if self.images is None:
            targets = stylized_views(stylizer, scene, embedding)
        else:
            targets = pictures_of_views(self.images, scene).to(scene.views.images)
        on_progress(Progress(f"{len(targets)} views stylized in 2D", targets[0]))
        with torch.no_grad():
            gaussians = stylizer.unstyled(scene)
        cameras, renderer = scene.cameras, stylizer.renderer
        with torch.enable_grad():
            fitted = fit_colors(
                gaussians, cameras, targets, renderer, steps=self.steps, damping=self.damping,
                keep=stylizer.keep_harmonics,
            )  # fmt: skip
        return fitted.detach()


@torch.no_grad()
def stylized_views(stylizer: Stylizer, scene: Scene, embedding: StyleEmbedding) -> Float[Tensor, "V 3 H W"]:
    """Each view stylized by the style branch alone, as a picture of its own.

    Raises:
        ValueError: The branch reads more than colours.
    """
    if stylizer.branch.gaussian_head is not None:
        raise ValueError(
            "method=projection needs a 2D stylizer: a style branch at placement=color, such as model=painter, or a "
            "folder of stylized photographs as method.images"
        )
    views = []
    for view in range(scene.views.images.shape[1]):
        alone = colors_alone(replace(scene.views.select([view]), cameras=None), scene.cameras.select([view]))
        color = stylizer.branch(alone, embedding).color  # 1 1 H W 3 K
        views.append(rgb_from_constant(color[0, 0, ..., 0]).clamp(0, 1).movedim(-1, 0))
    return torch.stack(views).float()


def pictures_of_views(folder: Path, scene: Scene) -> Float[Tensor, "V 3 H W"]:
    """The images of a folder in natural order, brought to the size of a scene's views.

    Raises:
        ValueError: There are not as many as views, or one cannot be read.
    """
    files, number = image_files(folder), scene.views.images.shape[1]
    if len(files) != number:
        raise ValueError(f"method.images={folder} has {len(files)} images, and the scene has {number} views")
    return torch.stack([to_tensor(read_picture(file, file.stem, scene.views.size)[0]) for file in files])
