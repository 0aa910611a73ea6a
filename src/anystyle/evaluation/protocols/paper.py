"""The published protocol: a model on scenes and styles, its renders written as images, and these judged."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

from anystyle.contracts import Metric, SceneSource, StyleSource
from anystyle.evaluation.contract import Evaluation, Progress, Protocol, required
from anystyle.evaluation.model_renders import ModelRenders, Variant
from anystyle.methods.contract import Method
from anystyle.stylizer import Stylizer


class Paper(Protocol):
    """Stylize every scene in every style, keep the first frames as images, and judge these (Sec. 4 of the paper).

    Args:
        styles: Every style has an image, which the figures compare with.
        guide: Whether a style enters as its image or as its text.
        variant: ``reference`` writes JPEG of quality 75 with truncated values and shows the model all views of a
            scene, as the published scripts do; ``corrected`` writes PNG with rounded values and shows it the frames
            that are judged.
        scene_names: Which scenes, in this order; all if empty.
        num_scenes: At most so many; ``None`` takes all.
        num_styles: At most so many; ``None`` takes all.
        frames: Of each scene, the first so many are judged.
        square: Whether the middle square of each view is taken.

    Raises:
        ValueError: A source is not configured, or lacks a scene that is named.
    """

    def __init__(
        self,
        *,
        stylizer: Stylizer,
        metrics: Mapping[str, Metric],
        scenes: SceneSource | None,
        styles: StyleSource | None,
        method: Method | None = None,
        guide: Literal["image", "text"] = "image",
        variant: Variant = "reference",
        scene_names: Sequence[str] = (),
        num_scenes: int | None = None,
        num_styles: int | None = 50,
        frames: int = 16,
        square: bool = True,
    ) -> None:
        self.metrics = metrics
        self.renders = ModelRenders(
            stylizer,
            required(scenes, "scenes"),
            required(styles, "styles"),
            guide=guide,
            variant=variant,
            scene_names=scene_names,
            num_scenes=num_scenes,
            num_styles=num_styles,
            frames=frames,
            square=square,
            method=method,
        )

    def run(self, out: Path, progress: Progress) -> Evaluation:
        return self.renders.judge(self.metrics, out, progress)
