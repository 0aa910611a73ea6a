"""A stylizer with published weights, from a state dict in the original layout."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from jaxtyping import Float
from omegaconf import DictConfig
from torch import Tensor

from anystyle.contracts import StyleEncoder
from anystyle.pipeline.load import build_and_load, published_by, weights_file
from anystyle.registry.compose import compose, override
from anystyle.stylizer import Stylizer
from anystyle.vision import weights

ENCODER = "longclip_b32"
"""The style encoder's weights that published style branches were trained with."""


def load_reference(
    checkpoint: Mapping[str, Tensor] | str | Path,
    *,
    style_encoder: Mapping[str, Tensor] | str | Path | None = None,
    overrides: Sequence[str] = (),
) -> Stylizer:
    """Build the published network around a checkpoint in the original layout.

    The variant is read off the keys (a style branch with or without an aggregator of its own, or none), the sizes off
    the shapes. Without a style branch every style gives the reconstruction itself, with colours of all degrees.

    Args:
        checkpoint: A state dict, with or without its file's prefixes (``encoder.``, ``model.encoder.``), or a file.
        style_encoder: Weights of the text and image encoder in their original layout; by default the checkpoint's own
            where it has all of one, else ``longclip_b32`` where :func:`anystyle.vision.weights.find` looks. Where they
            are missing, scenes can be encoded and restyled by embeddings, and asking for an embedding raises a
            UserError.
        overrides: In Hydra's grammar, such as ``backbone.voxel_size=0.004`` or ``branch.styled=[color]``.

    Returns:
        A stylizer in ``eval`` mode, without gradients.

    Raises:
        UserError: The checkpoint is of another network, or incomplete; up to five keys of a kind are named.

    Example:
        >>> stylizer = anystyle.weights.load_reference("anystyle_head.ckpt")
        >>> stylizer.branch.aggregator is None
        True
    """
    state = _state(checkpoint)
    config = reference_config(state, overrides)
    parts: dict[str, Mapping[str, Tensor]] = {"backbone": state}
    held = published_by(config).parts(state)
    if "branch" in held:
        parts["branch"] = state
    if style_encoder is None and held.get("style_encoder"):
        style_encoder = state
    missing: StyleEncoder | None = None
    try:
        parts["style_encoder"] = _state(style_encoder or ENCODER)
    except FileNotFoundError as error:
        if style_encoder is not None:
            raise
        missing = _Missing(dim=config.style_encoder.dim, neutral=config.style_encoder.neutral, reason=str(error))
    return build_and_load(config, {}, parts, missing)[0].requires_grad_(False).eval()


def reference_config(state: Mapping[str, Tensor], overrides: Sequence[str] = ()) -> DictConfig:
    """The configuration that a checkpoint in the original layout fits, read off its tensors."""
    words = ["~model", "style_encoder=long_clip", "placement=head"]
    fixed = published_by(compose("stylize", [*words, *overrides])).config(state)
    # Of two overrides of one key the last counts.
    return compose("stylize", [*words, *(override(key, value) for key, value in fixed.items()), *overrides])


def _state(given: Mapping[str, Tensor] | str | Path) -> Mapping[str, Tensor]:
    return given if isinstance(given, Mapping) else weights.read(weights_file(str(given)))


class _Missing(StyleEncoder):
    """Takes the place of a style encoder without weights: asking for an embedding raises."""

    def __init__(self, *, dim: int, neutral: str, reason: str) -> None:
        super().__init__()
        self.dim, self.neutral, self.reason = dim, neutral, reason

    def embed_images(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M D"]:
        raise weights.MissingWeights(self.reason)

    def embed_texts(self, texts: Sequence[str]) -> Float[Tensor, "M D"]:
        raise weights.MissingWeights(self.reason)
