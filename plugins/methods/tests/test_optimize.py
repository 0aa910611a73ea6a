"""The loop of per-scene methods and its presets."""

import pytest
import torch

from anystyle.contracts import Loss
from anystyle.errors import UserError
from anystyle.losses.features import objective
from anystyle.types import Style
from anystyle_methods import scene_loop
from anystyle_methods.optimize import Optimize
from anystyle_methods.scene_loop import SceneLoop
from tests.support.refusals import raises_line
from tests.support.worlds import method, painting, run, scene, stylizer

GEOMETRY = ("means", "rotations", "scales", "opacities")
WEIGHTS = {
    "nnfm": {"nnfm": 1.0, "content": 0.005, "total_variation": 1.0},
    "stylized_gs": {
        "nnfm": 5.0, "content": 0.005, "total_variation": 1.0, "depth_consistency": 0.01, "attribute_change": 1.0,
    },
    "sos": {"simultaneous_scales": 1.0, "content": 1.0},
    "g_style": {"nnfm": 10.0, "clip_patch": 10.0, "content": 0.05, "total_variation": 1e-4},
    "clip": {"clip_directional": 5.0, "clip_patch": 90.0, "content": 0.8},
}  # fmt: skip
"""As docs/rivals.md cites them."""
SMALL = {name: ["loss.clip_patch.crops=1", "loss.clip_patch.crop_size=32"] for name in ("clip", "g_style")}


def loop_of(chosen):
    style = painting()
    embedding = stylizer().embed(image=style.image)
    return SceneLoop(stylizer(), scene(), style, embedding, chosen.losses, **chosen.schedule)


@pytest.mark.parametrize("preset", WEIGHTS)
def test_a_preset_is_the_sum_that_its_paper_says(preset, monkeypatch):
    chosen = method(f"method={preset}", *SMALL.get(preset, []))
    assert {name: loss.weight for name, loss in chosen.losses.items()} == WEIGHTS[preset]
    seen = []
    monkeypatch.setattr(
        scene_loop, "objective", lambda losses, result: seen.append(result) or objective(losses, result)
    )
    torch.manual_seed(0)
    total = float(loop_of(chosen).loss(2).detach())
    torch.manual_seed(0)
    terms = {name: float(loss(seen[0]).detach()) for name, loss in chosen.losses.items()}
    assert total == pytest.approx(sum(WEIGHTS[preset][name] * value for name, value in terms.items()), rel=1e-5)


@pytest.mark.parametrize("preset", WEIGHTS)
def test_what_does_not_move_keeps_its_bits(preset):
    chosen = method(f"method={preset}", "method.num_steps=3", *SMALL.get(preset, []))
    given = scene()
    reports = []
    result = run(chosen, given=given, on_progress=reports.append)
    assert reports[-1].line.startswith("step 3 of 3: loss ") and reports[-1].thumbnail.shape == (3, 48, 48)
    moving = preset in ("stylized_gs", "clip")
    for name in GEOMETRY:
        assert torch.equal(getattr(result, name), getattr(given.gaussians, name)) is not moving, name
    assert not torch.equal(result.harmonics, given.gaussians.harmonics)


@pytest.mark.parametrize("kept", [0, 1 << 30])
def test_views_that_are_linear_in_colours_have_the_loss_and_the_gradient_of_renders(kept, monkeypatch):
    monkeypatch.setattr(scene_loop, "KEPT", kept)
    chosen = method("method=nnfm")
    loops = [loop_of(chosen), loop_of(chosen)]
    loops[1].only_colors = False
    losses = [loop.loss(view) for loop in loops for view in (0, 1)]
    (losses[0] + losses[1]).backward()
    (losses[2] + losses[3]).backward()
    assert (len(loops[0].linear_views), len(loops[1].linear_views)) == (2 if kept else 0, 0)
    torch.testing.assert_close(losses[:2], losses[2:], rtol=1e-5, atol=1e-7)
    grads = [loop.splats.parameters["colors"].grad for loop in loops]
    assert grads[1].abs().max() > 1e-6
    # Shares are kept in 16 bits, by which a few features have another nearest one; as by noise of 1e-5 in colours.
    torch.testing.assert_close(
        grads[0], grads[1], rtol=1e-3, atol=(2e-2 if kept else 1e-3) * float(grads[1].abs().max())
    )


def test_the_loss_falls():
    lines = []
    words = ("method=nnfm", "method.num_steps=16", "method.report_every=4")
    run(method(*words), on_progress=lambda progress: lines.append(progress.line))
    losses = [float(line.split("loss ")[1].split(",")[0]) for line in lines]
    assert losses[-1] < losses[0]


def test_colours_are_matched_after():
    chosen = method("method=optimize", "loss=[total_variation]", "method.num_steps=1", "method.recolor=both")
    result = run(chosen)
    with torch.no_grad():
        renders = stylizer().render(result, scene().cameras).color[0]
    torch.testing.assert_close(renders.mean((0, 2, 3)), painting().image.mean((0, 2, 3)), rtol=0, atol=0.06)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["method=optimize"], "no loss to minimise"),
        (["method=nnfm", "method.colors_lr=0"], "give one above 0"),
        (["method=nnfm", "method.means_lr=-1"], "method.means_lr=-1.0: expected float >= 0"),
        (["method=nnfm", "method.num_steps=0"], "method.num_steps=0: expected int >= 1"),
        (["method=nnfm", "method.recolor=sometimes"], "recolor"),
    ],
)
def test_nonsense_is_refused_in_a_line(words, message):
    with raises_line(ValueError, match=message):
        method(*words)


def test_a_text_is_refused_where_an_image_is_read():
    with pytest.raises(ValueError, match="--image"):
        run(method("method=nnfm"), Style(text=("red stripes",)))
    chosen = method("method=clip", "method.num_steps=2", *SMALL["clip"])
    assert run(chosen, Style(text=("red stripes",))).harmonics.isfinite().all()


class Change(Loss):
    """The distance from where a step begins: 0, with a derivative of 0 / 0."""

    weight = 1.0

    def forward(self, result):
        return (result.renders.color - result.renders.color.detach()).square().sum().sqrt()


def test_a_gradient_that_is_not_finite_stops_the_first_step():
    chosen = Optimize(losses={**method("method=nnfm").losses, "change": Change()}, num_steps=3)
    with pytest.raises(UserError, match=r"^the gradient of nnfm, content, total_variation, change is not"):
        run(chosen)
