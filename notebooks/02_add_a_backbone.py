# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Add a backbone
#
# A backbone is five parts behind one contract. This notebook writes one from scratch, checks it, stylizes with it, and
# makes it a package. It reconstructs badly, since it takes bright pixels to be near; but it has every part, and a real
# network fits in the same places.

# %%
import torch
from torch import nn

import anystyle
from anystyle import contracts
from anystyle.geometry.cameras import smooth_path
from anystyle.io.sheet import contact_sheet, to_pil
from anystyle.types import Attributes, Cameras, Gaussians, Geometry, Site, Tokens, untouched

# %% [markdown]
# ## 1. The embedder: pixels to tokens
# One convolution per patch. `Tokens` know their grid; a real network would add camera tokens in front
# (`special=1`).


# %%
class Patches(contracts.Embedder):
    def __init__(self, dim: int, side: int) -> None:
        super().__init__()
        self.patches = nn.Conv2d(3, dim, side, stride=side)

    def forward(self, images):
        maps = self.patches(images.flatten(0, 1)).unflatten(0, images.shape[:2])  # B V C h w
        return Tokens(maps.flatten(3).mT, grid=(maps.shape[-2], maps.shape[-1]))


# %% [markdown]
# ## 2. The aggregator: views see each other
# This is where the transformer goes. `sites` names the places where style may enter; `forward` calls `inject` at each.
# A style branch needs to know nothing else about a network.


# %%
class Mixer(contracts.Aggregator):
    def __init__(self, dim: int, depth: int) -> None:
        super().__init__()
        self.dim, self.norm = dim, nn.LayerNorm(dim)
        self.layers = nn.ModuleList(nn.Linear(2 * dim, dim) for _ in range(depth))

    @property
    def sites(self):
        return tuple(Site(f"aggregator/{index}", self.dim) for index in range(len(self.layers)))

    def forward(self, stem, inject=untouched):
        tokens, features = stem, {}
        for index, layer in enumerate(self.layers):
            tokens = inject(f"aggregator/{index}", tokens)
            local = self.norm(tokens.data)
            mean = local.mean((1, 2), keepdim=True).expand_as(local)
            tokens = tokens.with_data(tokens.data + layer(torch.cat([local, mean], -1)).tanh())
            features[index] = tokens
        return features


# %% [markdown]
# ## 3. The geometry head: cameras and depth
# Depth comes from brightness. The cameras stand in a row and look ahead.


# %%
class BrightIsNear(contracts.GeometryHead):
    def forward(self, features, images):
        batch, number, _, height, width = images.shape
        pose = torch.eye(4).to(images).repeat(batch, number, 1, 1)
        pose[..., 0, 3] = 0.2 * torch.arange(number).to(images)
        focal = float(max(height, width))
        pinhole = images.new_tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
        brightness = images.mean(2)
        cameras = Cameras(pose, pinhole.expand(batch, number, 3, 3), (height, width))
        return Geometry(cameras, depth=3 - brightness, confidence=torch.ones_like(brightness))


# %% [markdown]
# ## 4. The Gaussian head: what each pixel's Gaussian looks like
# A style branch also copies this part if style enters it. Colours start from the photograph's.

# %%
HARMONIC_0 = 0.28209479177387814  # the constant spherical harmonic


class Looks(contracts.GaussianHead):
    def __init__(self, dim: int, side: int) -> None:
        super().__init__()
        self.dim, self.side = dim, side
        self.maps = nn.Linear(dim, 11 * side**2)

    @property
    def sites(self):
        return (Site("head/tokens", self.dim),)

    def forward(self, features, images, inject=untouched):
        tokens = inject("head/tokens", features[max(features)])
        maps = 0.1 * self.maps(tokens.patches).mT.unflatten(-1, tokens.grid)  # B V 11ss h w
        pixels = nn.functional.pixel_shuffle(maps, self.side).movedim(2, -1)  # B V H W 11
        opacity, scale, rotation, change = pixels.split([1, 3, 4, 3], dim=-1)
        color = (images.movedim(2, -1) - 0.5) / HARMONIC_0 + change
        return Attributes(opacity[..., 0] + 2, scale, rotation, color[..., None])


# %% [markdown]
# ## 5. The adapter: raw numbers to Gaussians
# Activations and conventions. This adapter fuses nothing, so `cluster` returns `None`.


# %%
class Pixels(contracts.Adapter):
    def cluster(self, geometry, attributes):
        return None

    def forward(self, attributes, geometry, clusters):
        pixel = (geometry.depth / geometry.cameras.intrinsics[..., 0, 0, None, None])[..., None]
        return Gaussians(
            means=geometry.points().flatten(1, 3),
            rotations=attributes.rotation.flatten(1, 3),
            scales=(nn.functional.softplus(attributes.scale) * pixel).flatten(1, 3),
            opacities=attributes.opacity.sigmoid().flatten(1, 3),
            harmonics=attributes.color.mT.flatten(1, 3),
        )


# %% [markdown]
# ## The backbone
# The constructor is the configuration: every option has a name, a type and a default. The decorator adds it to the
# catalog of this process.


# %%
@anystyle.plugin("backbone", "relief")
class Relief(contracts.Backbone):
    """What is bright is near."""

    def __init__(self, *, dim: int = 24, depth: int = 2, patch_size: int = 8) -> None:
        super().__init__()
        self.patch_size, self.resolution = patch_size, 112
        self.embedder = Patches(dim, patch_size)
        self.aggregator = Mixer(dim, depth)
        self.geometry_head = BrightIsNear()
        self.gaussian_head = Looks(dim, patch_size)
        self.adapter = Pixels()


# %% [markdown]
# ## Is it one?
# `check` runs the contract tests of a backbone: shapes, batches, sites and gradients; and, with placements and an
# injector, that an untrained style branch changes nothing, that every weight learns, and that styles can be batched. It
# prints one line per test, as `anystyle plugins check` does.

# %%
from anystyle.testing import check

assert check("backbone", "relief")

# %% [markdown]
# ## What if something is wrong?
# Here depth depends on the other scenes of a batch, a mistake that cannot be seen with one scene.


# %%
class Leaky(BrightIsNear):
    def forward(self, features, images):
        return super().forward(features, images - 0.1 * images.mean(0))


class Mistaken(Relief):
    """What is bright is near, more or less."""

    def __init__(self, *, dim: int = 24) -> None:
        super().__init__(dim=dim)
        self.geometry_head = Leaky()


assert not check("backbone", Mistaken)

# %% [markdown]
# ## Use it
# By name, like any other backbone; options are typed and checked. The warning of an untrained backbone is left out.

# %%
import logging

logging.getLogger("anystyle").setLevel(logging.ERROR)
stylizer = anystyle.load("painter", ["backbone=relief", "backbone.depth=3", "renderer=cpu"])
ProceduralScenes = anystyle.catalog().find("scenes", "procedural").load()
views = ProceduralScenes(split="heldout", size=112).read(11, [0])
scene = stylizer.encode(views)
gaussians = stylizer.unstyled(scene)
around = stylizer.render(gaussians, smooth_path(scene.cameras, 5)).color[0]
contact_sheet([[to_pil(views.images[0, 0]), *map(to_pil, around)]], column_titles=["photograph", *5 * [""]])

# %% [markdown]
# A typo is one line, before anything is built:

# %%
try:
    anystyle.load(overrides=["backbone=relief", "backbone.dpeth=3"])
except ValueError as error:
    print(error)

# %% [markdown]
# ## Make it a package
# `anystyle plugins new backbone relief_map` writes a folder with a class, one line of TOML and a test; put the classes
# above into it, and others can install it. Without installing, name the folder in `ANYSTYLE_PLUGINS`.

# %%
from pathlib import Path
from tempfile import mkdtemp

folder = Path(mkdtemp())
# !anystyle plugins new backbone relief_map --into {folder}

# %%
print("\n".join(sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())))
print((folder / "relief_map" / "pyproject.toml").read_text())

# %%
# !ANYSTYLE_PLUGINS={folder} anystyle plugins check backbone relief_map
