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
# A handful of photographs, made into a scene once; then as many styles as you like, each from a sentence, a picture, or
# any point between two. Everything here runs on the CPU. The scene is fitted to the photographs, whose cameras are
# found; it is painted by Magenta's pretrained arbitrary stylization (`model=painter`). That network is not the paper's:
# `model=tiny` is the small learnt branch that is.

# %%
import time
from pathlib import Path
from tempfile import mkdtemp

from IPython.display import Image

import anystyle
from anystyle import Mixture, ViewOptions
from anystyle.geometry.cameras import smooth_path
from anystyle.io.sheet import contact_sheet, to_pil

out = Path(mkdtemp())

# %% [markdown]
# ## One call
# Twelve photographs of a street come with the package; `"photos/"` would be a folder of your own. The call finds the
# cameras, fits a scene and embeds the styles. They are small here, for a quick look; leave `views` out for the size
# that the fit is made for.

# %%
texts = ["pink and mint watercolor", "charcoal drawing", "sunset in oil paint", "gold leaf, klimt"]
wave = Path("example:wave")
mixed = [Mixture(texts[0], texts[1], amount) for amount in (0.25, 0.5, 0.75)]
start = time.perf_counter()
results = anystyle.stylize("example:street", [*texts, wave, *mixed], views=ViewOptions(short_side=168))
print(f"{time.perf_counter() - start:.0f} s for the cameras and the scene, once")
scene = results.encoded
contact_sheet([[to_pil(image) for image in scene.views.images[0, ::3]]])

# %% [markdown]
# ## The scene
# Gaussians that are fitted to the photographs. Nothing in here depends on a style. How good the fit is, on views
# that it never saw:

# %%
print({name: scene.reconstruction[name] for name in ("registered", "num_gaussians", "heldout_psnr")})
_, _, unstyled = results.unstyled
contact_sheet([unstyled])

# %% [markdown]
# ## A style is computed when it is asked for
# Only colours are solved for; the geometry stays.

# %%


def first_view(result):
    return to_pil(next(result.render()))


start = time.perf_counter()
styled = [results[index] for index in range(len(texts))]
print(f"{(time.perf_counter() - start) / len(texts):.1f} s a style")
contact_sheet([[first_view(result) for result in styled]], column_titles=texts)

# %% [markdown]
# ## What a text means to the network
# Words that it never learnt are named; the description is the nearest one that it did learn.

# %%
scene.stylizer.style_encoder.match_text("a gloomy forest by my uncle")

# %% [markdown]
# ## A picture as the style
# The encoder puts pictures and texts into one space, so a picture goes wherever a text does. `anystyle examples` lists
# the paintings that come with the package.

# %%
by_picture = results[len(texts)]
views = [to_pil(image) for image in by_picture.render(by_picture.cameras.select([0, 7]))]
contact_sheet([[by_picture.style.cell, *views]], column_titles=["style", "view 1", "view 8"])

# %% [markdown]
# ## From one style to another
# A point on the straight way between two embeddings is a style too.

# %%
between = [results[index] for index in range(len(texts) + 1, len(results))]
strip = [first_view(result) for result in (styled[0], *between, styled[1])]
contact_sheet([strip], column_titles=[texts[0], "", "", "", texts[1]])

# %% [markdown]
# ## Fly through it
# The result is a scene, not pictures: it renders from cameras that no photograph was taken with.

# %%
frames = [to_pil(image) for image in by_picture.render(smooth_path(by_picture.cameras, 36))]
frames[0].save(out / "flight.gif", save_all=True, append_images=frames[1:] + frames[-2:0:-1], duration=60, loop=0)
Image(data=(out / "flight.gif").read_bytes())

# %% [markdown]
# ## Take it elsewhere
# `by_picture.save(out)` writes every file of `anystyle stylize`. The PLY alone opens in SuperSplat, viser and other
# viewers of 3D Gaussians.

# %%
by_picture.gaussians.save(out / "scene.ply")
print(f"{by_picture.gaussians.means.shape[1]} Gaussians, {(out / 'scene.ply').stat().st_size / 1e6:.1f} MB")
