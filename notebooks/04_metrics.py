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
# # Metrics
#
# Images of any method can be evaluated, from three folders. This notebook makes such folders with the default
# model, evaluates them by both variants of the protocol, and then looks at what a consistency score measures. Such a
# score needs optical flow, and depends on the images from which the flow is estimated.

# %%
from pathlib import Path

import matplotlib.colors
import numpy as np
import torch
from IPython.display import Markdown
from PIL import Image

import anystyle
from anystyle.correspondences.rendered_depth import RenderedDepth
from anystyle.io.sheet import contact_sheet, to_pil
from anystyle.types import Frames

# %% [markdown]
# ## A folder of results
# Photographs are `content/SCENE/FRAME.png`, styles `style/STYLE.png`, results `stylized/SCENE/STYLE_FRAME.png`.

# %%
ProceduralScenes = anystyle.catalog().find("scenes", "procedural").load()
ProceduralStyles = anystyle.catalog().find("styles", "procedural").load()
stylizer = anystyle.load()
scenes, styles = ProceduralScenes(split="heldout", size=168), ProceduralStyles(split="heldout", size=168)
views = scenes.read(11, [0, 1])
scene = stylizer.encode(views)


def save(image, *place):
    path = Path(*place)
    path.parent.mkdir(parents=True, exist_ok=True)
    to_pil(image).save(path)


for frame, image in enumerate(views.images[0]):
    save(image, "content", "house", f"{frame}.png")
renders = []
for number in (9, 14):
    style = styles.read(number).image
    save(style[0], "style", f"{number}.png")
    renders.append(stylizer.render(stylizer.restyle(scene, stylizer.embed(image=style)), scene.cameras).color)
    for frame, image in enumerate(renders[-1][0]):
        save(image, "stylized", "house", f"{number}_{frame}.png")
contact_sheet([[Image.open(path) for path in sorted(Path("stylized/house").iterdir())]])

# %% [markdown]
# ## Two variants of one score
# Published scripts have errors. `variant=reference` reproduces them, so that a score can be compared with a published
# one; `variant=corrected` is what was meant. A score also depends on the networks it is computed with. The bundled ones
# are stand-ins for those of the literature, so **do not compare the scores below with a paper's**.

# %%
folders = "--content content --style style --stylized stylized metric=[lpips_gray,color_match]"
# !anystyle evaluate {folders} variant=reference --out reference >reference.log 2>&1
# !anystyle evaluate {folders} variant=corrected --out corrected >corrected.log 2>&1

# %%
Markdown("\n".join(Path(variant, "table.md").read_text() for variant in ("reference", "corrected")))

# %% [markdown]
# ## Where did a pixel go?
# Consistency compares a frame with its neighbour, warped by optical flow. In the procedural world the true flow is
# known from depth and cameras.


# %%
def frame(images, place):
    cameras = views.cameras
    return Frames(
        images[:, place], views.depth[:, place], cameras.world_from_camera[:, place], cameras.intrinsics[:, place]
    )


truth = RenderedDepth()(frame(views.images, 0), frame(views.images, 1))
print(f"{truth.visible.float().mean():.0%} of the first frame is seen in the second")

# %% [markdown]
# ## Flow of the photographs, or of the result?
# The published protocol estimates flow on the *stylized* frames, where it follows the texture that the method painted;
# others estimate it on the photographs. Here `correspondence=raft` searches in windows, as it does where RAFT's weights
# are missing: it is wrong where the picture is plain, in whichever of the two. An image without texture has no flow.

# %%
images_of = {
    "photographs": views.images,
    "style 9": renders[0],
    "style 14": renders[1],
    "flat grey": 0 * views.images + 0.5,
}
raft = anystyle.catalog().find("correspondence", "raft").load()(weights="stand_in")
flows = {name: raft(frame(images, 0), frame(images, 1)) for name, images in images_of.items()}


def colored(displacement):
    """Direction as hue, length as saturation."""
    x, y = displacement[0].numpy()
    hue, length = (np.arctan2(y, x) / (2 * np.pi)) % 1, np.hypot(x, y) / 12
    hsv = np.stack([hue, length.clip(0, 1), np.ones_like(hue)], axis=-1)
    return Image.fromarray((255 * matplotlib.colors.hsv_to_rgb(hsv)).astype(np.uint8))


top = [to_pil(images[0, 0]) for images in images_of.values()]
below = [colored(flow.displacement) for flow in flows.values()]
contact_sheet(
    [[to_pil(views.images[0, 0]), *top], [colored(truth.displacement), *below]],
    column_titles=["true flow", *images_of],
    row_titles=["images", "flow"],
)

# %% [markdown]
# The error of each flow in pixels, where the point is visible in both frames:


# %%
def error(flow):
    distance = (flow.displacement - truth.displacement).norm(dim=1)
    return distance[truth.visible].mean().item()


rows = [f"| {name} | {error(flow):.2f} |" for name, flow in flows.items()]
Markdown("\n".join(["| flow from | error in pixels |", "|---|---:|", *rows]))

# %% [markdown]
# ## What it does to the score
# The same pair of frames, warped by each flow; lower is more consistent. A result looks more consistent by its own
# flow, which was sought to make its two frames alike, than by the true one (in part because the model's geometry is
# not exact). The flat grey image is perfectly consistent with any flow: a consistency score rewards blank images, and
# therefore belongs beside a score of style.


# %%
def warped_rmse(images, flow):
    height, width = images.shape[-2:]
    v, u = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    x, y = u + flow.displacement[0, 0], v + flow.displacement[0, 1]
    where = torch.stack([2 * x / width - 1, 2 * y / height - 1], dim=-1)[None]
    back = torch.nn.functional.grid_sample(images[:, 1], where, padding_mode="border", align_corners=False)
    return ((back - images[:, 0])[:, :, flow.visible[0]] ** 2).mean().sqrt().item()


rows = [
    f"| {name} | {warped_rmse(images, flows[name]):.3f} | {warped_rmse(images, flows['photographs']):.3f} "
    f"| {warped_rmse(images, truth):.3f} |"
    for name, images in images_of.items()
]
Markdown("\n".join(["| images | own flow | flow of photographs | truth |", "|---|---:|---:|---:|", *rows]))
