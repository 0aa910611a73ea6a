"""The single pass, by an embedding that is optimised for one scene."""

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import torch

from anystyle.contracts import Loss, Method
from anystyle.errors import UserError
from anystyle.losses.features import FeatureLoss, objective
from anystyle.ranges import AtLeastOne, Positive
from anystyle.stylizer import Stylizer
from anystyle.types import Gaussians, Scene, Source, Style, StyleEmbedding, Stylization
from anystyle.types.progress import OnProgress, Progress, no_progress


class RefineEmbedding(Method):
    """Optimise the style embedding of one scene at test time, with a frozen style branch.

    The paper names it as a way out for styles far from those that the branch was trained on (limitations). Adam lowers
    the weighted sum of the losses of the configuration on all views; the embedding of the least sum is taken.

    Args:
        num_steps: Each a single pass, a render of every view, and their backward pass.
        learning_rate: In units of the root mean square of the embedding's components.
        seed: Seed of random crops.
    """

    def __init__(
        self, *, losses: Mapping[str, Loss], num_steps: AtLeastOne = 30, learning_rate: Positive = 0.05, seed: int = 0
    ) -> None:
        if not losses:
            raise UserError("method=embedding has no loss to minimise; give loss=[style,content]")
        self.losses, self.num_steps, self.learning_rate, self.seed = dict(losses), num_steps, learning_rate, seed

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        return {"num_steps": 2}

    @property
    def sources(self) -> tuple[Source, ...]:
        """The networks of the losses, each once."""
        return tuple(dict.fromkeys(loss.source for loss in self.losses.values() if isinstance(loss, FeatureLoss)))

    def __call__(
        self,
        stylizer: Stylizer,
        scene: Scene,
        style: Style,
        embedding: StyleEmbedding,
        *,
        on_progress: OnProgress = no_progress,
    ) -> Gaussians:
        if scene.gaussians is not None:
            raise UserError("method=refine_embedding requires reconstruction=feedforward")
        losses = {name: loss.to(embedding.vector.device) for name, loss in self.losses.items()}
        vector = embedding.vector.detach().clone().requires_grad_()
        rate = self.learning_rate * float(vector.detach().square().mean().sqrt())
        optimizer = torch.optim.Adam([vector], lr=rate)
        with torch.no_grad():
            before = stylizer.unstyled(scene)
            unstyled = stylizer.render(before, scene.cameras)
        best, least, started = vector.detach().clone(), torch.inf, time.monotonic()
        with torch.random.fork_rng(devices=[]), torch.enable_grad():
            for step in range(1, self.num_steps + 1):
                torch.manual_seed(self.seed)  # the same crops at each step, whose sums can then be compared
                gaussians = stylizer.restyle(scene, replace(embedding, vector=vector))
                result = Stylization(
                    views=replace(scene.views, cameras=None), style=style, embedding=embedding, scene=scene,
                    gaussians=gaussians, renders=stylizer.render(gaussians, scene.cameras), unstyled=unstyled,
                )  # fmt: skip
                total, _ = objective(losses, result)
                if (value := float(total.detach())) < least:
                    best, least = vector.detach().clone(), value
                (vector.grad,) = torch.autograd.grad(total, [vector])
                optimizer.step()
                left = (time.monotonic() - started) / step * (self.num_steps - step)
                line = f"step {step} of {self.num_steps}: loss {value:.4g}, {left:.0f} s left"
                on_progress(Progress(line, step / self.num_steps, result.renders.color[0, 0].detach()))
        with torch.no_grad():
            return stylizer.restyle(scene, replace(embedding, vector=best))
