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
# # The ablation table
#
# A row of the paper's Table 3 is a file of two lines. This notebook trains five of them on the procedural world, judges
# them by one protocol, and makes the table. It stops after a few steps: enough to see every part work, and **far too
# few to compare rows**. `docs/ablation.md` has the table with three seeds per row, which takes half an hour.

# %%
from pathlib import Path

from IPython.display import Image, Markdown

from anystyle.paths import CONF

STEPS = 2

# %% [markdown]
# ## What a row changes
# No code knows about ablations; each is a change to any recipe.

# %%
rows = ["base", "all_geometry", "no_clip_loss", "no_style_loss", "no_text"]
Markdown("\n".join(f"**{row}**\n```yaml\n{(CONF / 'ablation' / f'{row}.yaml').read_text()}```" for row in rows))

# %% [markdown]
# ## Train all of them
# `-m` runs one job per value. The same command resumes where it was stopped; a job that fails does not stop the others.

# %%
short = f"trainer.max_steps={STEPS} training.pool=2 scenes.num_scenes=2 training.warmup=1"
# !anystyle train -m experiment=tiny_ablation ablation={",".join(rows)} {short} hydra.sweep.dir=table 2>train.log

# %% [markdown]
# ## Judge all of them
# One protocol for every row: the same held-out scene in the same styles, each given as a text.
# The score is the similarity of a render's embedding to the style's.

# %%
scenes = "scenes=procedural scenes.split=heldout scenes.size=112 protocol.num_scenes=1 protocol.frames=2"
styles = "styles=procedural styles.split=heldout styles.size=96 protocol.num_styles=2"
# !anystyle evaluate --run table protocol=paper_text {scenes} {styles} metric=[clip_style] >judge.log 2>&1

# %% [markdown]
# ## The table
# `anystyle report` writes Markdown, CSV, LaTeX, a plot and a contact sheet. Runs that differ only in their seed become
# one row with an interval.

# %%
# !anystyle report table >report.log 2>&1
Markdown(Path("table/report/table.md").read_text())

# %% [markdown]
# ## What the rows look like
# One row per variant and one column per style. After so few steps all are still close to the reconstruction.

# %%
Image(filename="table/report/sheet.png")

# %% [markdown]
# ## The full table
# Leave `short` out, and add `seed=0,1,2` to the first command. On a cluster, `hydra/launcher=submitit_slurm` submits
# each job to Slurm.
