"""Published weights by one call: a state dict in the original layout in, a stylizer out."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from jaxtyping import Float
from omegaconf import DictConfig
from torch import Tensor

from anystyle.contracts import StyleEncoder
from anystyle.inference.assemble import build_and_load, published_by, weights_file
from anystyle.perception import weights
from anystyle.registry.compose import compose, override
from anystyle.stylizer import Stylizer

ENCODER = "longclip_b32"
"""The style encoder's weights that published style branches were trained with."""


def load_reference(
    checkpoint: Mapping[str, Tensor] | str | Path,
    *,
    style_encoder: Mapping[str, Tensor] | str | Path | None = None,
    overrides: Sequence[str] = (),
) -> Stylizer:
    """Build the published network around a checkpoint in the original layout, whatever its values.

    The variant is read off the keys: a style branch with or without an aggregator of its own, or none; so are the
    sizes, off the shapes. Without a style branch every style gives the reconstruction itself, colours of all degrees
    included. Tensors of the right type are taken as they are, without a copy; those of another are cast one by one.

    Args:
        checkpoint: A state dict, with or without its file's prefixes (``encoder.``, ``model.encoder.``), or a file.
        style_encoder: Weights of the text and image encoder in their original layout; ``None`` looks for
            ``longclip_b32`` where :func:`anystyle.perception.weights.find` does. Where they are missing, scenes can be
            encoded and restyled by embeddings, and asking for an embedding raises a FileNotFoundError.
        overrides: In Hydra's grammar, such as ``backbone.voxel_size=0.004`` or ``branch.styled=[color]``.

    Returns:
        A stylizer in ``eval`` mode, without gradients.

    Raises:
        ValueError: The checkpoint is of another network, or incomplete; up to five keys of a kind are named.

    Example:
        >>> stylizer = anystyle.weights.load_reference("anystyle_head.ckpt")
        >>> stylizer.branch.aggregator is None
        True
    """
    state = _state(checkpoint)
    config = reference_config(state, overrides)
    published = published_by(config)
    parts: dict[str, Mapping[str, Tensor]] = {"backbone": state}
    if published.placement(state) is not None:
        parts["branch"] = state
    missing: StyleEncoder | None = None
    try:
        parts["style_encoder"] = _state(ENCODER if style_encoder is None else style_encoder)
    except FileNotFoundError as error:
        if style_encoder is not None:
            raise
        missing = _Missing(dim=config.style_encoder.dim, neutral=config.style_encoder.neutral, reason=str(error))
    stylizer, _ = build_and_load(config, {}, parts, missing)
    return stylizer.requires_grad_(False).eval()


def reference_config(state: Mapping[str, Tensor], overrides: Sequence[str] = ()) -> DictConfig:
    """The configuration that a checkpoint in the original layout fits: variant and sizes read off its tensors.

    Raises:
        ValueError: It is of another network, or incomplete.
    """
    common = ["~model", *_unless_given(overrides, "style_encoder", "long_clip")]
    published = published_by(compose("stylize", [*common, *overrides]))
    placement = published.placement(state)
    options = published.options(state)
    chosen = [override(f"backbone.{name}", value) for name, value in options.items()]
    chosen += _unless_given(overrides, "placement", placement or "head")
    if placement is None:
        chosen.append(override("branch.sh_degree", options.get("sh_degree", 0)))
    adapter = bool(published.text_adapter(state))
    chosen += [override("style_encoder.text_adapter", adapter)] if adapter else []
    return compose("stylize", [*common, *chosen, *overrides])


def _unless_given(overrides: Sequence[str], group: str, name: str) -> list[str]:
    return [] if any(word.startswith(f"{group}=") for word in overrides) else [f"{group}={name}"]


def _state(given: Mapping[str, Tensor] | str | Path) -> Mapping[str, Tensor]:
    if isinstance(given, Mapping):
        return given
    return weights.read(weights_file(str(given)))


class _Missing(StyleEncoder):
    """Stands where the style encoder's weights are missing, and says so when an embedding is asked for."""

    def __init__(self, *, dim: int, neutral: str, reason: str) -> None:
        super().__init__()
        self.dim, self.neutral, self.reason = dim, neutral, reason

    def embed_images(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M D"]:
        raise FileNotFoundError(self.reason)

    def embed_texts(self, texts: Sequence[str]) -> Float[Tensor, "M D"]:
        raise FileNotFoundError(self.reason)
