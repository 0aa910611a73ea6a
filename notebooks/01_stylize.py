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
# # Stylize a scene
#
# A handful of photographs, encoded once; then as many styles as you like, each from a sentence, a picture, or any point
# between two. Everything here runs on the CPU. The scene is reconstructed by a small bundled network; it is painted by
# Magenta's pretrained arbitrary stylization (`model=painter`), at the colours of its pixels. That network is not the
# paper's: `model=tiny` is the small learnt branch that is.

# %%
import time
from pathlib import Path
from tempfile import mkdtemp

from IPython.display import Image

import anystyle
from anystyle.geometry.cameras import smooth_path
from anystyle.io.sheet import contact_sheet, to_pil

ProceduralScenes = anystyle.catalog().find("scenes", "procedural").load()
ProceduralStyles = anystyle.catalog().find("styles", "procedural").load()
out = Path(mkdtemp())
stylizer = anystyle.load()
print(f"{sum(p.numel() for p in stylizer.parameters()) / 1e6:.1f} million parameters")

# %% [markdown]
# ## Photographs
# Two views of a scene that the model never saw. For files of your own, `anystyle.data.folder.read_views` makes the same
# object from a folder or a video.

# %%
views = ProceduralScenes(split="heldout", size=112).read(11, [0, 1])
contact_sheet([[to_pil(image) for image in views.images[0]]])

# %% [markdown]
# ## Encode once
# Cameras, depth and one Gaussian a pixel. Nothing in here depends on a style.

# %%
start = time.perf_counter()
scene = stylizer.encode(views)
encoding = time.perf_counter() - start
depth = scene.geometry.depth[0]
near_is_bright = depth.amin() / depth
contact_sheet(
    [
        [to_pil(image.expand(3, -1, -1)) for image in near_is_bright],
        [to_pil(image) for image in stylizer.render(stylizer.unstyled(scene), scene.cameras).color[0]],
    ],
    row_titles=["depth", "reconstruction"],
)

# %% [markdown]
# ## Many styles are one batch
# Only the style branch runs, for all texts together.

# %%
texts = [
    "pink and mint watercolor",
    "the starry night in thick oil paint",
    "gold leaf, klimt",
    "charcoal drawing",
]
start = time.perf_counter()
gaussians = stylizer.restyle(scene, stylizer.embed(text=texts))
restyling = time.perf_counter() - start
renders = stylizer.render(gaussians, scene.cameras)
print(f"encoding {encoding:.2f} s, once; {restyling / len(texts):.2f} s a style")
contact_sheet([[to_pil(image[0]) for image in renders.color]], column_titles=texts)

# %% [markdown]
# ## What a text means to the network
# Words that it never learnt are named; the description is the nearest one that it did learn.

# %%
stylizer.style_encoder.match_text("a gloomy forest by my uncle")

# %% [markdown]
# ## A picture as the style
# The encoder puts pictures and texts into one space, so a picture goes wherever a text does.

# %%
picture = ProceduralStyles(split="heldout", size=256).read(4)
by_picture = stylizer.embed(image=picture.image)
styled = stylizer.restyle(scene, by_picture)
contact_sheet(
    [[to_pil(picture.image[0]), *map(to_pil, stylizer.render(styled, scene.cameras).color[0])]],
    column_titles=["style", "view 1", "view 2"],
)

# %% [markdown]
# ## From one style to another
# A point on the straight way between two embeddings is a style too.

# %%
one, other = stylizer.embed(text=texts[0]), stylizer.embed(text=texts[1])
strip = []
for amount in (0, 0.25, 0.5, 0.75, 1):
    mixed = stylizer.restyle(scene, one.toward(other, amount))
    strip.append(to_pil(stylizer.render(mixed, scene.cameras).color[0, 0]))
contact_sheet([strip], column_titles=[texts[0], "", "", "", texts[1]])

# %% [markdown]
# ## Fly through it
# The result is a scene, not pictures: it renders from cameras that no photograph was taken with.

# %%
path = smooth_path(scene.cameras, 24)
frames = [to_pil(image) for image in stylizer.render(styled, path).color[0]]
frames = [frame.resize((280, 280)) for frame in frames]
frames[0].save(out / "flight.gif", save_all=True, append_images=frames[1:] + frames[-2:0:-1], duration=60, loop=0)
Image(data=(out / "flight.gif").read_bytes())

# %% [markdown]
# ## Take it elsewhere
# The file opens in SuperSplat, viser and other viewers of 3D Gaussians.

# %%
styled.save(out / "scene.ply")
print(f"{styled.means.shape[1]} Gaussians, {(out / 'scene.ply').stat().st_size / 1e6:.1f} MB")
