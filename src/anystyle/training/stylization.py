"""Training the style branch: a frozen backbone, styled renders, and the objective of the paper."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.contracts import Loss, SceneSource, StyleSource, neutral_embedding
from anystyle.contracts.scene import required
from anystyle.contracts.training import Training
from anystyle.errors import UserError
from anystyle.io.atomic import atomic_path
from anystyle.io.sheet import to_pil
from anystyle.losses.features import objective
from anystyle.ranges import AtLeastOne, Count, Fraction, NonNegative, Positive, Range
from anystyle.stylizer import Stylizer
from anystyle.training.data import Batch, SceneBatches
from anystyle.training.optim import scheduled, trainable
from anystyle.training.sampling import generator
from anystyle.training.scene_cache import EncodedScenes
from anystyle.training.trainer import log_picture
from anystyle.types import Gaussians, Renders, Scene, Style, StyleEmbedding, Stylization, Views

Beta = Annotated[float, Range(ge=0, lt=1)]


class StylizationTraining(Training):
    """Train a style branch by the objective of the paper's equation 11; defaults as published.

    The backbone and the style encoder are frozen. The scene is rendered at its own cameras, and every loss sees the
    result. Whether a step's styles are given as texts or as images is a function of the step.

    Args:
        stylizer: Its branch is trained.
        losses: The terms of the objective by name, each with its weight.
        images: Images per step over all processes; with n views per scene that is ``images // n`` scenes, the same
            number in each process (published: 36 images per process).
        batch_size: Scenes per step, instead of ``images``.
        context_views: Least and greatest number of views of a scene.
        view_power: Numbers of views are drawn in proportion to this power of themselves.
        spread: ``any`` views of a scene, or the published ``bounded`` window of a video.
        heights: Least and greatest image height; ``None`` leaves images as they are.
        width: Image width; ``None`` keeps the aspect ratio.
        flip: Probability of mirroring a scene.
        min_scale: Below 1, images are shrunk to a random scale from ``min_scale`` to 1 and enlarged again, which blurs
            them (published: 0.77).
        pool: Number of fixed selections of scenes and views; ``None`` draws new ones each step.
        cache_scenes: Number of encoded scenes kept in memory; for use with a ``pool``.
        text_ratio: Fraction of steps whose styles are texts; with 0 no text is embedded at all, and styles without an
            image are drawn again.
        text_step_images: Whether losses on style images see them on steps whose styles are texts, as published.
        alternation: ``coin`` tosses for each step; ``strict`` spreads text steps evenly.
        learning_rate: The rate of the head's copy and of its injectors.
        aggregator_rate: Times ``learning_rate``, for the aggregator's copy.
        injector_rate: Times ``learning_rate``, for the aggregator's injectors; ``None`` takes ``aggregator_rate``, as
            published (the paper: 1).
        learn_copies: Whether the copied parts are trained beside the injectors; without, ``injector=lora`` is LoRA.
        betas: AdamW's betas.
        warmup: Steps of the warm-up.
        weight_decay: AdamW's weight decay of all parameters.
        floor: The learning rate at the end.
        decay_steps: Length of the cosine behind the warm-up; ``None`` takes ``trainer.max_steps`` (published: 300 000).
        preview_every: Steps between two grids of styled renders; 0 draws none.
        preview_texts: The texts of the grid.
    """

    needs = ("scenes", "styles")

    def __init__(
        self,
        *,
        stylizer: Stylizer,
        losses: Mapping[str, Loss],
        images: AtLeastOne = 36,
        batch_size: AtLeastOne | None = None,
        context_views: Sequence[int] = (2, 18),
        view_power: float = 2.0,
        spread: Literal["any", "bounded"] = "bounded",
        heights: Sequence[int] | None = (224, 448),
        width: AtLeastOne | None = 448,
        flip: Fraction = 0.5,
        min_scale: Fraction = 1.0,
        pool: AtLeastOne | None = None,
        cache_scenes: Count = 0,
        text_ratio: Fraction = 0.25,
        text_step_images: bool = True,
        alternation: Literal["coin", "strict"] = "coin",
        learning_rate: Positive = 1e-4,
        aggregator_rate: Positive = 0.3,
        injector_rate: Positive | None = None,
        learn_copies: bool = True,
        betas: tuple[Beta, Beta] = (0.9, 0.95),
        warmup: Count = 100,
        weight_decay: NonNegative = 0.05,
        floor: NonNegative = 1e-5,
        decay_steps: AtLeastOne | None = None,
        preview_every: Count = 0,
        preview_texts: Sequence[str] = ("blue and yellow swirling brush strokes", "orange and navy stripes"),
    ) -> None:
        super().__init__()
        injector_rate = aggregator_rate if injector_rate is None else injector_rate
        self.rates = {"aggregator_rate": aggregator_rate, "injector_rate": injector_rate}
        if not losses:
            raise UserError("there is nothing to learn from; add loss=[content,style,clip_directional]")
        if stylizer.branch.reads_tokens and text_ratio > 0:
            raise UserError("this style branch reads tokens of images, and texts have none; set training.text_ratio=0")
        self.stylizer = stylizer
        for copied in (stylizer.branch.aggregator, stylizer.branch.gaussian_head):
            if copied is not None and not learn_copies:
                copied.requires_grad_(False)
        self.losses, self.terms = dict(losses), nn.ModuleDict(losses)
        self.make_batches = partial(
            SceneBatches, images=images, batch_size=batch_size, context_views=context_views, view_power=view_power,
            spread=spread, heights=heights, width=width, multiple=stylizer.backbone.patch_size, flip=flip,
            min_scale=min_scale, pool=pool, needs_style_image=text_ratio == 0,
        )  # fmt: skip
        self.encoded, self.validated = (EncodedScenes(stylizer.encode, cache_scenes) for _ in range(2))
        self.text_ratio, self.alternation = text_ratio, alternation
        self.text_step_images = text_step_images
        self.learning_rate, self.betas, self.weight_decay = learning_rate, betas, weight_decay
        self.warmup, self.floor, self.decay_steps = warmup, floor, decay_steps
        self.preview_every, self.preview_texts = preview_every, preview_texts
        self.seed = 0
        self._source: SceneBatches | None = None

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        return {"batch_size": 1, "context_views": (2, 2), "spread": "any", "heights": None, "width": None, "warmup": 1}

    def batches(self, scenes: SceneSource | None, styles: StyleSource | None, *, seed: int) -> SceneBatches:
        self.seed = seed
        self._source = self.make_batches(required(scenes, "scenes"), required(styles, "styles"), seed=seed)
        return self._source

    def exports(self) -> Mapping[str, nn.Module]:
        return {"branch": self.stylizer.branch}

    def training_step(self, batch: Batch, step: int) -> Tensor:
        return self._loss(batch, self.global_step, "train")

    def validation_step(self, batch: Batch, step: int) -> None:
        self._loss(batch, step, "val")

    def _loss(self, batch: Batch, step: int, stage: str) -> Tensor:
        assert batch.style is not None
        result = self.stylize(batch, self.embed(batch.style, step), step)
        rows = len(batch.keys)
        # In full precision, as published, whatever the networks are computed in.
        with torch.autocast(result.renders.color.device.type, enabled=False):
            result = result.to(torch.float32)
            total, values = objective(self.losses, result)
            for name, value in values.items():
                self.log(f"{stage}/{name}", value, batch_size=rows, sync_dist=True)
        self.log(f"{stage}/loss", total, batch_size=rows, prog_bar=True, sync_dist=True)
        return total

    def stylize(self, batch: Batch, embedding: StyleEmbedding, step: int = 0) -> Stylization:
        """Encode the scenes or take them from the cache, style them, and render them at their own cameras."""
        style = batch.style
        assert style is not None
        views = batch.inputs
        cameras = views.cameras if self.stylizer.backbone.reads_cameras else None
        encoded = self.encoded if self.training else self.validated  # whose keys are those of other scenes
        scene = encoded(Views(images=views.images, cameras=cameras), batch.keys)
        gaussians, unstyled, identity = self.stylizer.restyle(scene, embedding), None, None
        if any(loss.needs_identity for loss in self.losses.values()):
            own = self.embed(Style(image=views.images[:, 0]), step)
            identity = self._render(self.stylizer.restyle(scene, own), scene)
        with torch.autocast(views.images.device.type, enabled=False):
            renders = self._render(gaussians, scene)
            if any(loss.needs_unstyled for loss in self.losses.values()):
                with torch.no_grad():
                    unstyled = self._render(self.stylizer.unstyled(scene), scene)
        if not self.text_step_images and self.is_text_step(step):
            style = replace(style, image=None, has_image=None)
        return Stylization(views, style, embedding, scene, gaussians, renders, unstyled, identity)

    def _render(self, gaussians: Gaussians, scene: Scene) -> Renders:
        with torch.autocast(gaussians.means.device.type, enabled=False):
            return self.stylizer.render(gaussians.to(torch.float32), scene.cameras.to(torch.float32))

    def embed(self, style: Style, step: int) -> StyleEmbedding:
        """The styles of a step, as texts or as images; a row that lacks the one is embedded as the other."""
        if self.stylizer.branch.reads_tokens:
            assert style.image is not None
            with torch.no_grad():
                vector, tokens = self.stylizer.vectors_and_tokens(style.image)
        else:
            vector, tokens = style_vectors(self.stylizer, style, as_text=self.is_text_step(step)), None
        neutral = neutral_embedding(self.stylizer.style_encoder)
        return StyleEmbedding(vector, nn.functional.normalize(vector - neutral, dim=-1), tokens=tokens)

    def is_text_step(self, step: int) -> bool:
        """Whether the styles of a step are texts; the same in every process and after a restart."""
        if self.alternation == "strict":
            return int((step + 1) * self.text_ratio) > int(step * self.text_ratio)
        return bool(generator(self.seed, 5, step).random() < self.text_ratio)

    def on_train_batch_end(self, outputs: Any, batch: Batch, batch_idx: int) -> None:
        """Log the grid of styled renders every ``preview_every`` steps: of the same scene, in the same styles."""
        step = self.global_step
        if not (self.preview_every and step % self.preview_every == 0 and self.trainer.is_global_zero):
            return
        assert self._source is not None
        rows = self.preview(self._source.batch(0, 0, self.trainer.world_size).to(self.device))
        picture = to_pil(torch.cat([torch.cat(row, dim=-1) for row in rows], dim=-2).float())
        folder = Path(self.trainer.default_root_dir).with_name("previews")  # beside the logs
        with atomic_path(folder / f"step_{step:07d}.png") as temporary:
            picture.save(temporary)
        for logger in self.trainer.loggers:
            log_picture(logger, "previews", np.asarray(picture), step)

    @torch.no_grad()
    def preview(self, batch: Batch) -> list[list[Float[Tensor, "3 H W"]]]:
        """Rows of images: the photographs of the first scene, unstyled renders, and renders in each style."""
        stylizer, inputs = self.stylizer, batch.inputs.row(0)
        views = Views(images=inputs.images, cameras=inputs.cameras if stylizer.backbone.reads_cameras else None)
        scene = stylizer.encode(views)
        embeddings = [stylizer.embed(text=text) for text in self.preview_texts]
        if batch.style is not None and batch.style.image is not None:
            embeddings.append(stylizer.embed(image=batch.style.image[:1]))
        rows = [stylizer.unstyled(scene), *(stylizer.restyle(scene, embedding) for embedding in embeddings)]
        return [list(views.images[0]), *(list(self._render(gaussians, scene).color[0]) for gaussians in rows)]

    def configure_optimizers(self) -> Any:
        groups = branch_groups(self.stylizer, lr=self.learning_rate, **self.rates)
        fused = self.device.type == "cuda" and self.trainer.precision != "16-mixed"  # whose scaler refuses it
        optimizer = torch.optim.AdamW(groups, betas=self.betas, weight_decay=self.weight_decay, fused=fused or None)
        total = self.trainer.max_steps if self.decay_steps is None else self.decay_steps
        return scheduled(optimizer, total=total, warmup=self.warmup, floor=self.floor)

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        # Frozen weights come from their own files.
        state = checkpoint["state_dict"]
        checkpoint["state_dict"] = {key: state[key] for key in state if key.startswith("stylizer.branch.")}

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        # With the frozen weights, so that loading stays strict.
        frozen = {key: value for key, value in self.state_dict().items() if not key.startswith("stylizer.branch.")}
        checkpoint["state_dict"] = frozen | checkpoint["state_dict"]


def branch_groups(
    stylizer: Stylizer, *, lr: float, aggregator_rate: float = 0.3, injector_rate: float = 0.3
) -> list[dict[str, Any]]:
    """Parameter groups: the head's copy and its injectors, the aggregator's copy and its injectors; rates times lr."""
    branch, inside = stylizer.branch, {site.name for site in stylizer.backbone.aggregator.sites}
    parts = (
        ("head", [branch.gaussian_head], 1.0),
        ("head injectors", [each for name, each in branch.injectors.items() if name not in inside], 1.0),
        ("aggregator", [branch.aggregator], aggregator_rate),
        ("aggregator injectors", [each for name, each in branch.injectors.items() if name in inside], injector_rate),
    )
    groups = ((name, trainable(each for each in modules if each is not None), rate) for name, modules, rate in parts)
    return [{"params": parameters, "lr": lr * rate, "name": name} for name, parameters, rate in groups if parameters]


@torch.no_grad()
def style_vectors(stylizer: Stylizer, style: Style, *, as_text: bool) -> Float[Tensor, "B D"]:
    """Embeddings of styles as texts or as images; a row that lacks the one is embedded as the other."""
    encoder, image = stylizer.style_encoder, style.image
    count = len(style.text) if style.text is not None else 0 if image is None else len(image)
    has_image = [image is not None] * count if style.has_image is None else style.has_image.tolist()
    rows: list[Tensor] = []
    for row, text in enumerate(style.text or ("",) * count):
        if text and (as_text or not has_image[row]):
            rows.append(encoder.embed_texts([text])[0])
        elif image is not None and has_image[row]:
            rows.append(encoder.embed_images(image[row : row + 1])[0])
        else:
            raise UserError("a style has neither an image nor a text; look at the style source")
    return torch.stack(rows)
