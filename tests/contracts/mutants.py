"""Small plugins that break one promise each, and the promise.

``MUTANTS[kind]`` lists pairs of a class and the name of the promise that finds it, without ``test_``; others may
find it, too.
"""

from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

from anystyle.contracts import Published
from anystyle.errors import UserError
from anystyle.io.checkpoint import load_strictly
from anystyle.testing.toy.backbone import (
    ToyAdapter,
    ToyAggregator,
    ToyBackbone,
    ToyEmbedder,
    ToyGaussianHead,
    ToyGeometryHead,
)
from anystyle.testing.toy.cameras import ToyCameras
from anystyle.testing.toy.command import ToyCommand
from anystyle.testing.toy.correspondence import ToyCorrespondence
from anystyle.testing.toy.format import ToyFormat
from anystyle.testing.toy.injector import ToyInjector
from anystyle.testing.toy.loss import ToyLoss
from anystyle.testing.toy.method import ToyMethod
from anystyle.testing.toy.metric import ToyMetric
from anystyle.testing.toy.placement import ToyPlacement
from anystyle.testing.toy.pose_estimator import ToyPoseEstimator
from anystyle.testing.toy.protocol import ToyProtocol
from anystyle.testing.toy.reconstruction import ToyReconstruction
from anystyle.testing.toy.renderer import ToyRenderer
from anystyle.testing.toy.scenes import ToyScenes
from anystyle.testing.toy.style_encoder import ToyStyleEncoder
from anystyle.testing.toy.styles import ToyStyles
from anystyle.testing.toy.training import ToyTraining
from anystyle.types import Site, no_progress
from anystyle_study.testing.toy.study_test import ToyStudyTest


def changed(toy, method, change):
    """A toy whose method returns ``change`` of what it returned."""

    def call(self, *args, **options):
        return change(getattr(super(cls, self), method)(*args, **options))

    cls = type(f"Changed{toy.__name__}", (toy,), {method: call, "__doc__": toy.__doc__})
    return cls


def given(toy, method, change):
    """A toy whose method gets ``change`` of its first argument."""

    def call(self, first, *args, **options):
        return getattr(super(cls, self), method)(change(first), *args, **options)

    cls = type(f"Given{toy.__name__}", (toy,), {method: call, "__doc__": toy.__doc__})
    return cls


def flipped(cameras):
    """Stored cameras as in a mirror: their axes are left-handed."""
    mirror = np.diag([-1.0, 1, 1, 1])
    return {name: replace(one, world_from_camera=one.world_from_camera @ mirror) for name, one in cameras.items()}


def enlarged(read):
    styles = tuple((title, scale("scales", 2)(gaussians)) for title, gaussians in read.styles)
    return replace(read, styles=styles)


def drawn(change):
    """A renderer that draws other Gaussians than it is given."""
    return given(ToyRenderer, "__call__", change)


def scale(name, factor):
    """Multiply one field of a value."""
    return lambda value: replace(value, **{name: getattr(value, name) * factor})


def backbone(part, make):
    """A toy backbone with another part."""

    def init(self):
        ToyBackbone.__init__(self, dim=12, depth=2, patch_size=4)
        setattr(self, part, make())

    return type("Changed", (ToyBackbone,), {"__init__": init, "example": classmethod(lambda cls, folder: {})})


def geometry(change):
    return backbone("geometry_head", lambda: changed(ToyGeometryHead, "forward", change)(dim=12, patch_size=4))


def aggregator(cls):
    return backbone("aggregator", lambda: cls(dim=12, depth=2))


class Unvisited(ToyAggregator):
    @property
    def sites(self):
        return (*super().sites, Site("aggregator/norm", self.dim))


class SharedHead(ToyGaussianHead):
    def __deepcopy__(self, memory):
        return self


class ToyCheckpoints(Published):
    """Files in which each name stands behind ``net.``."""

    def names(self, keys):
        return {key: f"net.{key}" for key in keys}

    def config(self, state):
        self.parts(state)
        return {"backbone.dim": state["net.embedder.patches.bias"].numel()}

    def parts(self, state):
        if not any(name.startswith("net.") for name in state):
            raise UserError("the file is of another network")
        return {"backbone": True}

    def load(self, part, module, state):
        load_strictly(module, {name.removeprefix("net."): state[name] for name in state}, source="the file")


class Lenient(ToyCheckpoints):
    def load(self, part, module, state):
        self.parts(state)
        module.load_state_dict({name.removeprefix("net."): state[name] for name in state}, strict=False)


class Narrow(ToyCheckpoints):
    def config(self, state):
        return {"backbone.dim": super().config(state)["backbone.dim"] // 2}


def published(checkpoints):
    return type("Released", (ToyBackbone,), {"__doc__": ToyBackbone.__doc__, "published": checkpoints()})


def mix_scenes(tokens):
    return tokens.with_data(tokens.data - 0.5 * tokens.data.mean(0, keepdim=True))


class Biased(ToyInjector):
    def __init__(self, *, dim, style_dim):
        super().__init__(dim=dim, style_dim=style_dim)
        nn.init.normal_(self.scale.bias, std=1e-4)


class FirstViewOnly(ToyInjector):
    def forward(self, tokens, style):
        result = super().forward(tokens, style).data
        return tokens.with_data(torch.cat([result[:, :1], tokens.data[:, 1:]], dim=1))


class MixedStyles(ToyInjector):
    def forward(self, tokens, style):
        return super().forward(tokens, style - 0.5 * style.mean(0, keepdim=True))


class EveryOtherPatch(ToyInjector):
    def forward(self, tokens, style):
        result = super().forward(tokens, style).data
        return tokens.with_data(torch.where(torch.arange(result.shape[2])[:, None] % 2 == 0, result, tokens.data))


class Slopes(ToyLoss):
    def forward(self, result):
        across, down = (result.renders.color.diff(dim=dim)[..., :32, :32].square() for dim in (-1, -2))
        return (across + down).sqrt().mean()


class ReadsAbsentImages(ToyLoss):
    def forward(self, result):
        image = result.style.image
        return super().forward(result) if image is None else (result.renders.color.mean() - image.mean()).square()


class Painting(ToyMethod):
    def __call__(self, stylizer, scene, style, embedding, *, on_progress=no_progress):
        result = super().__call__(stylizer, scene, style, embedding)
        scene.views.images.mul_(0.5)
        return result


class Forgetful(ToyProtocol):
    def run(self, out, on_progress):
        with (out / "runs").open("a") as file:
            file.write("one\n")
        scores = {"runs": float(len((out / "runs").read_text().splitlines()))}
        return replace(super().run(out, on_progress), scores=scores, better={})


class Careless(ToyFormat):
    def write(self, scene, path):
        path.with_suffix(".part").write_bytes(b"")
        super().write(scene, path)


class Tilted(ToyFormat):
    up = "y"

    def read(self, path):
        return replace(super().read(path), up="z")


def posed(change):
    """Change the cameras of a value."""
    return lambda value: replace(value, cameras=change(value.cameras))


def inverted(cameras):
    return replace(cameras, world_from_camera=cameras.camera_from_world)


def opengl(cameras):
    return replace(cameras, world_from_camera=cameras.world_from_camera @ torch.diag(torch.tensor([1.0, -1, -1, 1])))


def farther(cameras):
    pose = cameras.world_from_camera.clone()
    pose[..., :3, 3] *= 2
    return replace(cameras, world_from_camera=pose)


def longer(cameras):
    lens = torch.tensor([[1.5, 1.0, 1.0], [1.0, 1.5, 1.0], [1.0, 1.0, 1.0]])
    return replace(cameras, intrinsics=cameras.intrinsics * lens)


def in_fractions(cameras):
    width_height = torch.tensor([cameras.size[1], cameras.size[0], 1.0])
    return replace(cameras, intrinsics=cameras.intrinsics / width_height[:, None])


def of_a_square(cameras):
    intrinsics = cameras.intrinsics.clone()
    intrinsics[..., 0, 2] = cameras.size[0] / 2
    return replace(cameras, intrinsics=intrinsics)


def transposed_lens(cameras):
    order = [1, 0, 2]
    return replace(cameras, intrinsics=cameras.intrinsics[..., order, :][..., order])


def along_ray(cameras):
    """How much longer a ray is than its part along z, pixel by pixel."""
    height, width = cameras.size
    centre = torch.stack(torch.meshgrid(torch.arange(width) + 0.5, torch.arange(height) + 0.5, indexing="xy"))
    ray = torch.linalg.inv(cameras.intrinsics) @ F.pad(centre, (0, 0, 0, 0, 0, 1), value=1.0).flatten(1)
    return ray.norm(dim=-2).unflatten(-1, (height, width))


def unprojected(change):
    """A toy backbone whose adapter takes other geometry for its own."""
    return backbone("adapter", lambda: Misled(change))


class Misled(ToyAdapter):
    def __init__(self, change):
        super().__init__()
        self.change = change

    def forward(self, attributes, geometry, clusters):
        return super().forward(attributes, self.change(geometry), clusters)


class CameraLast(ToyEmbedder):
    def forward(self, images):
        tokens = super().forward(images)
        return tokens.with_data(torch.cat([tokens.patches, tokens.data[:, :, :1]], dim=2))


def by_columns(geometry):
    """Depth whose patches are laid out column by column."""
    height, width = (side // 4 for side in geometry.depth.shape[-2:])
    patches = geometry.depth.unflatten(3, (width, 4)).unflatten(2, (height, 4)).movedim(4, 3).flatten(2, 3)
    patches = patches.unflatten(2, (width, height)).transpose(2, 3)
    return replace(geometry, depth=patches.movedim(3, 4).flatten(4, 5).flatten(2, 3))


class Given(ToyGeometryHead):
    reads_cameras = True

    def forward(self, features, images, cameras):
        return replace(super().forward(features, images), cameras=cameras)


class NeedsCameras(ToyBackbone):
    """Its scenes have the cameras of their views."""

    needs_cameras = True
    head = Given

    def __init__(self):
        super().__init__(dim=12, depth=2)
        self.geometry_head = self.head(dim=12, patch_size=8)

    @classmethod
    def example(cls, folder):
        return {}


class Inverting(NeedsCameras):
    head = changed(Given, "forward", posed(inverted))


class AlongRay(ToyRenderer):
    def __call__(self, gaussians, cameras):
        return scale("depth", along_ray(cameras))(super().__call__(gaussians, cameras))


class MeanOfBatches(ToyMetric):
    def update(self, comparison):
        self.total = self.total + (comparison.stylized - comparison.content).abs().mean()
        self.count = self.count + 1


class Reversed(ToyMetric):
    better: ClassVar = {"change": "higher"}


class Spent(ToyMetric):
    def compute(self):
        return super().compute() + self.total.zero_()


class Remembering(ToyMetric):
    def reset(self):
        total, count = self.total, self.count
        super().reset()
        self.total, self.count = total, count


class Summed(ToyLoss):
    def forward(self, result):
        return super().forward(result) * len(result.renders.color)


class Weighted(ToyLoss):
    def forward(self, result):
        return self.weight * super().forward(result)


HALF = torch.tensor([[0.0, 0.0, 0.5], [0.0, 0.0, 0.5], [0.0, 0.0, 0.0]])
ROLLED, CONJUGATE = [1, 2, 3, 0], torch.tensor([1.0, -1.0, -1.0, -1.0])

MISPLACED = [
    *(posed(change) for change in (inverted, opengl, farther, in_fractions, longer)),
    posed(lambda cameras: replace(cameras, intrinsics=cameras.intrinsics + HALF)),
    lambda views: scale("depth", along_ray(views.cameras))(views),
    lambda views: replace(views, depth=views.depth.log()),
    scale("depth", 1000.0),
    lambda views: replace(views, images=views.images.flip(-1)),
]
"""What makes the views of a scene disagree with each other."""


MUTANTS = {
    "backbone": [
        (geometry(lambda value: replace(value, depth=value.depth.int())), "encodes_views"),
        (geometry(scale("confidence", float("nan"))), "numbers_are_finite"),
        (aggregator(given(ToyAggregator, "forward", mix_scenes)), "encodes_several_scenes_at_once"),
        (aggregator(Unvisited), "every_site_is_visited"),
        (backbone("gaussian_head", lambda: SharedHead(dim=12, patch_size=4)), "copies_compute_the_same"),
        (backbone("adapter", changed(ToyAdapter, "forward", scale("opacities", 2.5))), "gaussians_are_renderable"),
        (backbone("adapter", changed(ToyAdapter, "forward", lambda g: g.detach())), "attributes_carry_gradients"),
        (backbone("embedder", lambda: CameraLast(dim=12, patch_size=4)), "patches_keep_their_places"),
        (Inverting, "needed_cameras_are_those_of_the_scene"),
        (geometry(by_columns), "patches_keep_their_places"),
        *((geometry(posed(change)), "cameras_are_rigid_pinholes") for change in (in_fractions, of_a_square)),
        *(
            (unprojected(posed(change)), "gaussians_lie_where_pixels_see_them")
            for change in (inverted, opengl, farther, of_a_square, transposed_lens)
        ),
        (unprojected(lambda g: replace(g, depth=g.depth.roll(1, dims=1))), "gaussians_lie_where_pixels_see_them"),
        (unprojected(lambda g: replace(g, depth=g.depth.log())), "gaussians_lie_where_pixels_see_them"),
        (published(Lenient), "published_weights_load_strictly"),
        (published(Narrow), "a_published_file_becomes_a_stylizer"),
    ],
    "injector": [
        (Biased, "changes_nothing_at_initialisation"),
        (FirstViewOnly, "views_have_no_order"),
        (MixedStyles, "styles_of_a_batch_stay_apart"),
        (EveryOtherPatch, "style_matters_after_training"),
    ],
    "placement": [(changed(ToyPlacement, "select", lambda sites: sites[::-1]), "selects_sites_of_the_backbone")],
    "loss": [
        (changed(ToyLoss, "forward", torch.Tensor.double), "value_is_one_finite_number"),
        (given(ToyLoss, "forward", lambda result: result.detach()), "something_learns_from_it"),
        (Slopes, "something_learns_from_it"),
        (ReadsAbsentImages, "absent_images_are_not_read"),
        (Summed, "a_batch_has_a_mean"),
        (Weighted, "value_is_reproducible"),
    ],
    "metric": [
        (changed(ToyMetric, "compute", lambda score: score.nan_to_num(0)), "too_little_is_not_an_error"),
        (changed(ToyMetric, "compute", float), "scores_are_declared"),
        (changed(ToyMetric, "compute", lambda score: torch.stack([score, score])), "scores_are_declared"),
        (
            given(ToyMetric, "update", lambda c: replace(c, stylized=c.stylized.clamp_(0.2, 0.8))),
            "inputs_are_left_alone",
        ),
        (Remembering, "inputs_are_left_alone"),
        (Spent, "copies_and_processes_can_be_merged"),
        (given(ToyMetric, "update", lambda c: replace(c, content=c.content.roll(1, 1))), "the_ideal_is_not_the_worst"),
        (MeanOfBatches, "order_does_not_matter"),
        (Reversed, "the_ideal_is_not_the_worst"),
    ],
    "style_encoder": [
        (changed(ToyStyleEncoder, "embed_images", lambda vectors: 2 * vectors), "images_become_vectors"),
        (given(ToyStyleEncoder, "embed_images", lambda i: i - 0.5 * i.mean(0, keepdim=True)), "batches_are_loops"),
        (given(ToyStyleEncoder, "embed_texts", lambda texts: ["grey"] * len(texts)), "empty_text_is_refused"),
    ],
    "renderer": [
        (drawn(lambda g: replace(g, means=g.means * torch.tensor([1.0, 1.0, -1.0]))), "near_hides_far"),
        (drawn(lambda g: replace(g, rotations=g.rotations.detach())), "everything_carries_gradients"),
        (drawn(lambda g: replace(g, means=g.means + 0.1)), "points_appear_where_they_project"),
        (AlongRay, "points_appear_where_they_project"),
        (drawn(lambda g: replace(g, harmonics=g.harmonics[:, :, :1])), "points_appear_where_they_project"),
        (drawn(scale("scales", 1.1)), "long_gaussians_are_turned"),
        (drawn(lambda g: replace(g, rotations=g.rotations[..., ROLLED])), "long_gaussians_are_turned"),
        (drawn(scale("rotations", CONJUGATE)), "long_gaussians_are_turned"),
    ],
    "cameras": [
        (changed(ToyCameras, "read", flipped), "reads_its_example"),
        (changed(ToyCameras, "find", lambda path: path or Path("toy_cameras.txt")), "finds_its_own_and_nothing_else"),
    ],
    "pose_estimator": [
        (changed(ToyPoseEstimator, "__call__", lambda posed: posed.verdict), "gives_cameras_or_a_verdict")
    ],
    "reconstruction": [
        (
            changed(ToyReconstruction, "__call__", lambda r: r._replace(measures={"psnr": float("nan")})),
            "makes_a_scene_of_the_views",
        )
    ],
    "method": [
        (changed(ToyMethod, "__call__", scale("opacities", float("nan"))), "gives_gaussians"),
        (changed(ToyMethod, "__call__", lambda g: g.map(lambda tensor: tensor[:, :0])), "gives_gaussians"),
        (changed(ToyMethod, "__call__", lambda g: replace(g, harmonics=g.harmonics.half())), "gives_gaussians"),
        (Painting, "leaves_the_scene_alone"),
        # What a scene of given Gaussians has, the result has, too.
        (changed(ToyMethod, "__call__", lambda g: replace(g, means=g.means.mul_(2))), "leaves_the_scene_alone"),
    ],
    "correspondence": [
        (
            changed(ToyCorrespondence, "__call__", lambda f: replace(f, displacement=f.displacement.flip(1))),
            "moved_cameras_are_followed",
        ),
        (changed(ToyCorrespondence, "displacement", lambda flow: 0.5 * flow), "pairs_are_independent"),
    ],
    "scenes": [
        (changed(ToyScenes, "name", lambda name: "wall"), "views_are_images"),
        (changed(ToyScenes, "read", scale("images", 255.0)), "views_are_images"),
        *((changed(ToyScenes, "read", change), "views_agree") for change in MISPLACED),
    ],
    "styles": [
        (changed(ToyStyles, "read", lambda s: replace(s, image=None, text=None)), "styles_have_an_image_or_a_text"),
        (changed(ToyStyles, "read", lambda s: replace(s, image=s.image * torch.rand(()))), "reading_twice_is_the_same"),
    ],
    "training": [
        (changed(ToyTraining, "exports", lambda modules: {}), "exports_what_it_trains"),
        (changed(ToyTraining, "training_step", lambda loss: loss * 0), "steps_train_what_is_exported"),
    ],
    "protocol": [
        (changed(ToyProtocol, "run", lambda evaluation: replace(evaluation, scores={})), "scores_are_numbers"),
        (Forgetful, "interrupted_runs_resume"),
    ],
    "format": [
        (Careless, "writes_one_file"),
        (Tilted, "reads_what_it_writes"),
        (changed(ToyFormat, "read", enlarged), "reads_what_it_writes"),
    ],
    "command": [(given(ToyCommand, "__call__", lambda words: []), "unknown_words_are_refused")],
    "study_test": [
        (given(ToyStudyTest, "__call__", lambda r: replace(r, deviations=-r.deviations)), "negative_means_ours")
    ],
}


class ColorsAsScales(ToyAdapter):
    def forward(self, attributes, geometry, clusters):
        brightness = attributes.color.mean((-1, -2))[..., None]
        return super().forward(replace(attributes, scale=attributes.scale + 0.1 * brightness), geometry, clusters)


def head(cls):
    return backbone("gaussian_head", lambda: cls(dim=12, patch_size=4))


COMPOSED = [
    (ToyBackbone, Biased, "nothing_changes_at_initialisation"),
    (head(SharedHead), ToyInjector, "the_backbone_does_not_learn"),
    (backbone("adapter", ColorsAsScales), ToyInjector, "what_is_not_styled_stays"),
    (ToyBackbone, MixedStyles, "many_styles_are_one_batch"),
]
"""Backbones and injectors that break a promise of compositions, and which."""
