"""What made this track: held-out scenes and styles of the procedural world; ``python make.py``, then ``--lock`` it."""

import json
from pathlib import Path

import numpy as np

from anystyle.contracts import SceneSource, StyleSource
from anystyle.evaluation.comparisons import write_cameras
from anystyle.io.sheet import save_png, to_pil
from anystyle.registry.build import build
from anystyle.registry.catalog import catalog

HERE = Path(__file__).parent
HEAD = """# Made by make.py beside it: scenes, cameras and depth are exact, and nothing is anybody's but this project's.
name = "ablation"
version = 1
about = "Three procedural scenes in four procedural styles, as pictures and as words; no training of ours saw them."
short_side = 112

[metrics]
image = ["cfsd", "color_match", "warp_consistency", "style_retrieval", "structure_distance", "met3r_depth", "sharpness"]
text = ["clip_style", "warp_consistency", "structure_distance", "met3r_depth", "sharpness"]
"""
SAID = """title = "procedural"
licence = "Apache-2.0"
source = "scenes=procedural and styles=procedural, split heldout, seed 0"
"""


def main() -> None:
    """Write the inputs and the track."""
    names = {"scenes": "procedural", "styles": "procedural"}
    paths = {kind: catalog().find(kind, name).path for kind, name in names.items()}
    scenes = build(SceneSource, {"_target_": paths["scenes"], "size": 112, "views": 6, "split": "heldout"})
    styles = build(StyleSource, {"_target_": paths["styles"], "size": 128, "split": "heldout"})
    lines = [HEAD]
    for scene in range(3):
        views = scenes.read(scene, range(6))
        stems, folder, geometry = [f"{view:03d}" for view in range(6)], f"scenes/{scene}", f"geometry/{scene}"
        for path in (folder, geometry):
            (HERE / path).mkdir(parents=True, exist_ok=True)
        assert views.cameras is not None and views.depth is not None
        write_cameras(HERE / geometry / "cameras.npz", stems, views.cameras)
        for index, stem in enumerate(stems):
            save_png(to_pil(views.images[0, index]), HERE / folder / f"{stem}.png")
            np.save(HERE / geometry / f"{stem}.npy", views.depth[0, index].numpy().astype(np.float16))
        said = f'name = "scene_{scene}"\nphotographs = "{folder}"\ngeometry = "{geometry}"\n'
        lines.append(f"[[scenes]]\n{said}views = {json.dumps(stems)}\n{SAID}")
    (HERE / "styles").mkdir(exist_ok=True)
    for number in range(4):
        style = styles.read(number)
        assert style.image is not None and style.text is not None
        save_png(to_pil(style.image[0]), HERE / "styles" / f"{number}.png")
        lines.append(f'[[styles]]\nname = "picture_{number}"\nimage = "styles/{number}.png"\n{SAID}')
        lines.append(f'[[styles]]\nname = "words_{number}"\ntext = "{style.text[0]}"\n')
    (HERE / "track.toml").write_text("\n".join(lines))


if __name__ == "__main__":
    main()
