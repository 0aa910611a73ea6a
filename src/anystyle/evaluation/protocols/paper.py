"""The published protocol: a model on scenes and styles, its renders written as images, and these judged."""

from anystyle.evaluation.model_renders import ModelRenders


class Paper(ModelRenders):
    """Stylize every scene in every style, keep the first frames as images, and judge these (Sec. 4 of the paper)."""
