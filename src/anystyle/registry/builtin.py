"""What is in the box, on one screen: the kinds of plugin, and the built-in plugins of each."""

from typing import NamedTuple


class Kind(NamedTuple):
    """A socket that plugins fit.

    Args:
        base: The contract, as ``module:Class``.
        many: Whether a configuration holds several at once.
        runtime: Constructor arguments that the framework passes by name, and that are no options.
    """

    base: str
    many: bool = False
    runtime: tuple[str, ...] = ()


KINDS: dict[str, Kind] = {
    "backbone": Kind("anystyle.contracts:Backbone"),
    "style_encoder": Kind("anystyle.contracts:StyleEncoder"),
    "placement": Kind("anystyle.contracts:Placement"),
    "injector": Kind("anystyle.contracts:Injector", runtime=("dim", "style_dim")),
    "renderer": Kind("anystyle.contracts:Renderer"),
    "reconstruction": Kind("anystyle.reconstructions.contract:Reconstruction"),
    "method": Kind("anystyle.methods.contract:Method", runtime=("losses",)),
    "loss": Kind("anystyle.contracts:Loss", many=True, runtime=("style_encoder",)),
    "metric": Kind("anystyle.contracts:Metric", many=True, runtime=("style_encoder", "correspondence")),
    "correspondence": Kind("anystyle.contracts:Correspondence"),
    "scenes": Kind("anystyle.contracts:SceneSource"),
    "styles": Kind("anystyle.contracts:StyleSource"),
    "study_test": Kind("anystyle.study.contract:StudyTest", many=True),
    "training": Kind(
        "anystyle.training.contract:Training",
        runtime=("backbone", "renderer", "style_encoder", "stylizer", "losses", "features"),
    ),
    "protocol": Kind(
        "anystyle.evaluation.contract:Protocol", runtime=("stylizer", "method", "metrics", "scenes", "styles")
    ),
}

BUILTIN: dict[str, dict[str, str]] = {
    "backbone": {},
    "style_encoder": {
        "long_clip": "anystyle.style_encoders.long_clip:LongClip",
    },
    "placement": {
        "head": "anystyle.placements.head:Head",
        "aggregator": "anystyle.placements.aggregator:Aggregator",
        "full": "anystyle.placements.full:Full",
        "color": "anystyle.placements.color:Color",
        "sites": "anystyle.placements.sites:Sites",
    },
    "injector": {
        "ada_ln": "anystyle.injectors.ada_ln:AdaLN",
        "cross_attention": "anystyle.injectors.cross_attention:CrossAttention",
        "film": "anystyle.injectors.film:FiLM",
        "lora": "anystyle.injectors.lora:LoRA",
        "zero_conv": "anystyle.injectors.zero_conv:ZeroConv",
    },
    "renderer": {
        "auto": "anystyle.renderers.auto:AutoRenderer",
        "cpu": "anystyle.renderers.cpu.renderer:CpuRenderer",
        "gsplat": "anystyle.renderers.gsplat:GsplatRenderer",
        "torch": "anystyle.renderers.torch:TorchRenderer",
    },
    "reconstruction": {
        "feedforward": "anystyle.reconstructions.feedforward:Feedforward",
        "fit": "anystyle.reconstructions.fit:Fit",
    },
    "method": {
        "branch": "anystyle.methods.branch:Branch",
        "optimize": "anystyle.methods.optimize:Optimize",
        "projection": "anystyle.methods.projection:Projection",
    },
    "loss": {
        "attribute_change": "anystyle.losses.attribute_change:AttributeChange",
        "clip_directional": "anystyle.losses.clip_directional:ClipDirectional",
        "clip_patch": "anystyle.losses.clip_patch:ClipPatch",
        "content": "anystyle.losses.content:Content",
        "depth_consistency": "anystyle.losses.depth_consistency:DepthConsistency",
        "edge_aware_smoothness": "anystyle.losses.edge_aware_smoothness:EdgeAwareSmoothness",
        "gram": "anystyle.losses.gram:Gram",
        "histogram": "anystyle.losses.histogram:Histogram",
        "nnfm": "anystyle.losses.nnfm:NNFM",
        "simultaneous_scales": "anystyle.losses.simultaneous_scales:SimultaneousScales",
        "sliced_wasserstein": "anystyle.losses.sliced_wasserstein:SlicedWasserstein",
        "style": "anystyle.losses.style:StyleLoss",
        "style_3d": "anystyle.losses.style_3d:Style3D",
        "total_variation": "anystyle.losses.total_variation:TotalVariation",
    },
    "metric": {
        "art_fid": "anystyle.metrics.art_fid:ArtFID",
        "art_score": "anystyle.metrics.art_score:ArtScore",
        "cfsd": "anystyle.metrics.cfsd:CFSD",
        "clip_direction": "anystyle.metrics.clip_direction:ClipDirection",
        "clip_style": "anystyle.metrics.clip_style:ClipStyle",
        "color_match": "anystyle.metrics.color_match:ColorMatch",
        "depth_agreement": "anystyle.metrics.depth_agreement:DepthAgreement",
        "kid": "anystyle.metrics.kid:KID",
        "lpips": "anystyle.metrics.lpips:LPIPS",
        "lpips_gray": "anystyle.metrics.lpips_gray:LPIPSGray",
        "psnr": "anystyle.metrics.psnr:PSNR",
        "ssim": "anystyle.metrics.ssim:SSIM",
        "style_retrieval": "anystyle.metrics.style_retrieval:StyleRetrieval",
        "timing": "anystyle.metrics.timing:Timing",
        "warp_consistency": "anystyle.metrics.warp_consistency:WarpConsistency",
    },
    "correspondence": {
        "dis": "anystyle.correspondences.dis:DIS",
        "raft": "anystyle.correspondences.raft:Raft",
        "rendered_depth": "anystyle.correspondences.rendered_depth:RenderedDepth",
    },
    "scenes": {
        "folder": "anystyle.data.scene_folder:FolderScenes",
        "re10k": "anystyle.data.re10k:Re10kScenes",
    },
    "styles": {
        "folder": "anystyle.data.style_folder:FolderStyles",
        "wikiart": "anystyle.data.wikiart:WikiArtStyles",
    },
    "study_test": {
        "crossed_t": "anystyle.study.tests.crossed_t:CrossedT",
        "one_sample_t": "anystyle.study.tests.one_sample_t:OneSampleT",
        "ordinal_mixed": "anystyle.study.tests.ordinal_mixed:OrdinalMixed",
        "sign_flip": "anystyle.study.tests.sign_flip:SignFlip",
        "wilcoxon": "anystyle.study.tests.wilcoxon:Wilcoxon",
    },
    "training": {
        "reconstruction": "anystyle.training.reconstruction:ReconstructionTraining",
        "stylization": "anystyle.training.stylization:StylizationTraining",
    },
    "protocol": {
        "captures": "anystyle.evaluation.protocols.captures:Captures",
        "folders": "anystyle.evaluation.protocols.folders:Folders",
        "paper": "anystyle.evaluation.protocols.paper:Paper",
        "tables": "anystyle.evaluation.protocols.tables:Tables",
    },
}
