"""The published networks that are measured beside ours: how each is built from a checkout, and how ours loads its file.

Networks are built by their own classes from their own configurations. VGGT's weights are not downloaded, and what is
cast to bf16 stays fp32: ``torch.bfloat16`` is replaced before they are imported.
"""

import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import torch
import torch.nn.functional as F
import yaml
from torch import Tensor, nn

import anystyle
from anystyle.geometry.projection import covariances
from anystyle.pipeline.weights import load_reference
from anystyle.stylizer import Stylizer
from anystyle.testing.oracle import hashed, smooth_image
from anystyle.types import Cameras, Gaussians, StyleEmbedding, Views

FOCAL = 0.9
"""Focal length of the photographs in units of their sides; Styl3R is told it."""

Pass = Callable[[Tensor, Tensor], Any]
"""From images, ``1 V 3 H W``, and a style to the published Gaussians."""


@dataclass(frozen=True)
class Network:
    """A published network.

    Args:
        repository: On GitHub.
        file: Of a checkout, by which it is known.
        golden: By whose rules weights are filled.
        prefix: Of names in its checkpoint.
        size: Height and width of photographs, unless others are asked for.
        warm_up: The same of the pass that is not measured.
        build: The network and its single pass, from a checkout.
        load: Ours, from the checkpoint.
        style: A style of a seed, for photographs of a size.
        embed: That style as ours takes it.
        fields: Names and values of our Gaussians in the published convention.
    """

    repository: str
    file: str
    golden: str
    prefix: str
    size: tuple[int, int]
    warm_up: tuple[int, int]
    build: Callable[[Path], tuple[nn.Module, Pass]]
    load: Callable[[Path], Stylizer]
    style: Callable[[int, Sequence[int]], Tensor]
    embed: Callable[[Stylizer, Tensor], StyleEmbedding]
    fields: Callable[[Gaussians], Mapping[str, Tensor]]


def views(images: Tensor) -> Views:
    """Photographs with the cameras' lenses; a network that reads none ignores them."""
    lens = torch.tensor([[FOCAL, 0, 0.5], [0, FOCAL, 0.5], [0, 0, 1]]).expand(*images.shape[:2], 3, 3)
    cameras = Cameras(torch.eye(4).expand(*images.shape[:2], 4, 4), lens, (1, 1))
    return Views(images, cameras=cameras.resized((images.shape[-2], images.shape[-1])))


def _options(*files: Path) -> dict[str, Any]:
    """What encoders are configured with; later files go before earlier ones."""
    found: dict[str, Any] = {}
    for file in files:
        settings = yaml.safe_load(file.read_text())
        settings = settings["model"]["encoder"] if isinstance(settings.get("model"), dict) else settings
        nested = {name: {**found.get(name, {}), **value} for name, value in settings.items() if isinstance(value, dict)}
        found |= settings | nested
    found.pop("defaults", None)
    return found


def _namespace(value: Any) -> Any:
    if isinstance(value, dict):
        return SimpleNamespace(**{name: _namespace(each) for name, each in value.items()})
    return value


def _vggt_encoder(checkout: Path, experiment: str, **changes: Any) -> nn.Module:
    """``EncoderAnySplat`` of AnyStyle and of Stylos, which started from AnySplat's."""
    torch.bfloat16 = torch.float32
    network = importlib.import_module("src.model.encoder.anysplat")
    vggt = network.VGGT
    vggt.from_pretrained = lambda name: vggt()
    config = checkout / "config"
    options = _options(config / "model/encoder/anysplat.yaml", config / f"experiment/{experiment}.yaml") | changes
    known = set(network.EncoderAnySplatCfg.__dataclass_fields__)
    given = {name: _namespace(value) for name, value in options.items() if name in known}
    return network.EncoderAnySplat(network.EncoderAnySplatCfg(**{"backbone": None, **given}))


def _anystyle(experiment: str) -> Callable[[Path], tuple[nn.Module, Pass]]:
    def build(checkout: Path) -> tuple[nn.Module, Pass]:
        encoder = _vggt_encoder(checkout, experiment)
        return encoder, lambda images, style: encoder(images, style_dir=(None, None, None, style)).gaussians

    return build


def _stylos(checkout: Path) -> tuple[nn.Module, Pass]:
    encoder = _vggt_encoder(checkout, "dl3dv_style")
    return encoder, lambda images, style: encoder(images, style[:, None]).gaussians


def _styl3r(checkout: Path) -> tuple[nn.Module, Pass]:
    network = importlib.import_module("src.model.encoder.encoder_noposplat_multi_token_style")
    config = checkout / "config/model/encoder"
    options = _options(config / "noposplat_token_style.yaml", checkout / "config/experiment/re10k_3view_style_1x.yaml")
    options["backbone"] = _options(config / "backbone/croco.yaml") | options["backbone"]
    options["token_stylizer"] = _options(config / "token_stylizer/token_stylizer.yaml")
    options["gaussian_adapter"]["sh_degree"] = 0  # as all its commands set it
    encoder = network.EncoderNoPoSplatMultiTokenStyle(_namespace(options | {"stylized": True}))

    def single(images: Tensor, style: Tensor) -> Any:
        lens = torch.tensor([[FOCAL, 0, 0.5], [0, FOCAL, 0.5], [0, 0, 1]])
        context = {"image": 2 * images - 1, "intrinsics": lens.expand(*images.shape[:2], 3, 3)}
        return encoder(context, {"image": style})  # in [0, 1], as its commands read it

    return encoder, single


def _vector(seed: int, size: Sequence[int]) -> Tensor:
    return F.normalize(hashed(1000 + seed, (1, 512), -1, 1), dim=-1)


def _image(seed: int, size: Sequence[int]) -> Tensor:
    return smooth_image(1000 + seed, [1, 3, *size])


def _without_covariances(gaussians: Gaussians) -> dict[str, Tensor]:
    found = {name: getattr(gaussians, name)[0] for name in ("means", "rotations", "scales", "opacities")}
    return found | {"rotations": found["rotations"].roll(-1, -1), "harmonics": gaussians.harmonics[0].mT}


def _with_covariances(gaussians: Gaussians) -> dict[str, Tensor]:
    found = {name: getattr(gaussians, name)[0] for name in ("means", "opacities")}
    covariance = covariances(gaussians.rotations, gaussians.scales)[0]
    return found | {"covariances": covariance, "harmonics": gaussians.harmonics[0].mT}


def _anystyle_network(experiment: str) -> Network:
    return Network(
        repository="joaxkal/AnyStyle",
        file="src/model/encoder/anysplat.py",
        golden="golden_e2e",
        prefix="model.encoder.",
        size=(224, 448),
        warm_up=(56, 112),
        build=_anystyle(experiment),
        load=load_reference,
        style=_vector,
        embed=lambda _, style: StyleEmbedding(style, style),
        fields=_without_covariances,
    )


def _published_branch(model: str, *changes: str) -> Callable[[Path], Stylizer]:
    return lambda file: anystyle.load(model, [f"weights.backbone={file}", *changes])


NETWORKS = {
    "head": _anystyle_network("dl3dv_head"),
    "full": _anystyle_network("dl3dv_aggregator"),
    "styl3r": Network(
        repository="WU-CVGL/Styl3R",
        file="src/model/encoder/encoder_noposplat_multi_token_style.py",
        golden="golden_styl3r",
        prefix="encoder.",
        size=(256, 256),
        warm_up=(64, 64),
        build=_styl3r,
        load=_published_branch("styl3r"),
        style=_image,
        embed=lambda stylizer, style: stylizer.embed(image=style),
        fields=_with_covariances,
    ),
    "stylos": Network(
        repository="HanzhouLiu/Stylos",
        file="src/model/encoder/vggt/models/aggregator.py",
        golden="golden_stylos",
        prefix="encoder.",
        size=(224, 448),
        warm_up=(56, 112),
        build=_stylos,
        # Its style image has the size of the photographs.
        load=_published_branch("stylos", "style_encoder.resolution=null"),
        style=_image,
        embed=lambda stylizer, style: stylizer.embed(image=style),
        fields=_without_covariances,
    ),
}
