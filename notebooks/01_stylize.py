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
# Photographs become a scene once; then any number of styles is applied to it, each from a text, a picture, or a blend
# of two. Everything here runs on the CPU. Cameras are estimated, and Gaussians are fitted to the photographs. The
# default model, `model=painter`, colours them with Magenta's pretrained arbitrary stylization. It is not the network of
# the paper; `model=tiny` is a small one that works as the paper's does.

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
# cameras, fits a scene and embeds the styles. The photographs are downsampled here, for a quick look; leave `views` out
# for the default size.

# %%
texts = ["pink and mint watercolor", "charcoal drawing", "sunset in oil paint", "gold leaf, klimt"]
wave = Path("example:wave")
mixed = [Mixture(texts[0], texts[1], amount) for amount in (0.25, 0.5, 0.75)]
results = anystyle.stylize("example:street", [*texts, wave, *mixed], views=ViewOptions(short_side=168))
scene = results.encoded
contact_sheet([[to_pil(image) for image in scene.views.images[0, ::3]]])

# %% [markdown]
# ## The scene
# The fitted Gaussians, before any style. The fit is judged on held-out views:

# %%
print({name: scene.reconstruction[name] for name in ("registered", "num_gaussians", "heldout_psnr")})
cameras = scene.cameras.select([0, 3, 6, 9])
contact_sheet([[to_pil(image) for image in scene.render(results.run.unstyled, cameras)]])

# %% [markdown]
# ## A style is computed when it is asked for
# Only colours are solved for; the geometry stays.

# %%


def first_view(result):
    return to_pil(next(result.render()))


start = time.process_time()
styled = [results[index] for index in range(len(texts))]
print(f"{(time.process_time() - start) / len(texts):.1f} CPU seconds per style")
contact_sheet([[first_view(result) for result in styled]], column_titles=texts)

# %% [markdown]
# ## What a text means to the network
# The text encoder names the words that it does not know, and shows the nearest description that it does.

# %%
scene.stylizer.style_encoder.match_text("a gloomy forest by my uncle")

# %% [markdown]
# ## A picture as the style
# Pictures and texts share one embedding space, so a picture can be used wherever a text can. `anystyle stylize --help`
# ends with the paintings that come with the package.

# %%
by_picture = results[len(texts)]
views = [to_pil(image) for image in by_picture.render(by_picture.cameras.select([0, 7]))]
contact_sheet([[by_picture.style.cell, *views]], column_titles=["style", "view 1", "view 8"])

# %% [markdown]
# ## From one style to another
# Every point on the line between two embeddings is a style.

# %%
between = [results[index] for index in range(len(texts) + 1, len(results))]
strip = [first_view(result) for result in (styled[0], *between, styled[1])]
contact_sheet([strip], column_titles=[texts[0], "", "", "", texts[1]])

# %% [markdown]
# ## Fly through it
# The result is a scene, so it renders from any camera.

# %%
frames = [to_pil(image) for image in by_picture.render(smooth_path(by_picture.cameras, 36))]
frames[0].save(out / "flight.gif", save_all=True, append_images=frames[1:] + frames[-2:0:-1], duration=60, loop=0)
Image(data=(out / "flight.gif").read_bytes())

# %% [markdown]
# ## Take it elsewhere
# `anystyle.save(by_picture, out)` writes every file of `anystyle stylize`. The PLY opens in SuperSplat, viser and other
# viewers of 3D Gaussians.

# %%
by_picture.gaussians.save(out / "scene.ply")
print(f"{by_picture.gaussians.means.shape[1]} Gaussians, {(out / 'scene.ply').stat().st_size / 1e6:.1f} MB")
