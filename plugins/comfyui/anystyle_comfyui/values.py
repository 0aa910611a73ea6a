"""What travels between nodes, and its conversion from and to ComfyUI's tensors; nothing here needs ComfyUI."""

from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.io.sheet import save_png, to_pil
from anystyle.pipeline.encode import EncodedCapture
from anystyle.pipeline.load import LoadedModel
from anystyle.pipeline.request import Request
from anystyle.types import Gaussians, StyledScene
from anystyle.vision.weights import license_lines, licenses


class Model(NamedTuple):
    """A loaded model, and the request that it was loaded for, without inputs and styles."""

    request: Request
    loaded: LoadedModel


class Scene(NamedTuple):
    """A scene in one style."""

    encoded: EncodedCapture  # what every other style starts from
    gaussians: Gaussians  # in the style
    title: str  # of the style
    loaded: LoadedModel  # stylizes it

    def styled(self) -> StyledScene:
        """The scene as files hold it."""
        title, encoded = self.title, self.encoded
        notes = (title, *encoded.notes, *license_lines(licenses(self.loaded.weights)))
        styles, names = ((title, self.gaussians),), tuple(encoded.names)
        return StyledScene(styles, encoded.cameras, names, notes, title, offset=encoded.offset)


def image_from_renders(renders: list[Float[Tensor, "3 H W"]]) -> Float[Tensor, "B H W 3"]:
    """Renders as a batch of ComfyUI's type ``IMAGE``, sRGB in [0, 1]."""
    return torch.stack(renders).movedim(1, -1).clamp(0, 1).contiguous()


def style_from_image(image: Float[Tensor, "B H W C"]) -> Float[Tensor, "1 3 H W"]:
    """The first picture of a batch of ComfyUI's type ``IMAGE``, without its alpha; a copy, which may take gradients."""
    return image[:1, ..., :3].float().movedim(-1, 1).clamp(0, 1).clone(memory_format=torch.contiguous_format)


def folder_of_images(images: Float[Tensor, "B H W C"], parent: Path) -> Path:
    """A folder with a batch as PNG files; the same pictures have the same folder, in which cameras are found once."""
    bytes_ = (images[..., :3].float().cpu().clamp(0, 1) * 255).round().byte()
    folder = parent / f"anystyle_{sha256(bytes_.numpy().tobytes() + str(bytes_.shape).encode()).hexdigest()[:16]}"
    folder.mkdir(parents=True, exist_ok=True)
    for index, picture in enumerate(bytes_):
        save_png(to_pil(picture.movedim(-1, 0) / 255), folder / f"{index:04d}.png")
    return folder


def splat_columns(gaussians: Gaussians) -> dict[str, Tensor]:
    """Visible Gaussians as the arguments of ComfyUI's type ``SPLAT``.

    Both have 3DGS's axes, linear scales, opacities in [0, 1], quaternions wxyz and harmonics with the constant first.
    """
    shown = gaussians.map(lambda tensor: tensor[:, gaussians.opacities[0] > 0].detach().float().cpu())
    return {
        "positions": shown.means,
        "scales": shown.scales,
        "rotations": F.normalize(shown.rotations, dim=-1),
        "opacities": shown.opacities[..., None],
        "sh": shown.harmonics,
    }


def gaussians_from_splat(splat: Any, index: int = 0) -> Gaussians:
    """One scene of a batch of ComfyUI's type ``SPLAT``, without its padding."""
    count = splat.positions.shape[1] if splat.counts is None else int(splat.counts[index])
    columns = (splat.positions, splat.rotations, splat.scales, splat.opacities[..., 0], splat.sh)
    return Gaussians(*(column[index : index + 1, :count].detach().float().cpu().clone() for column in columns))
