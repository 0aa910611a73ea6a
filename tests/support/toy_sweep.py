"""The smallest sweep: jobs of the toy training."""

from pathlib import Path

_PLUGIN = """
from anystyle.io import atomic
from anystyle.testing.toy.backbone import ToyBackbone
from anystyle.testing.toy.scenes import ToyScenes
from anystyle.testing.toy.training import ToyTraining

atomic.LEASE = {lease}
"""
_KINDS = {"backbone": "ToyBackbone", "scenes": "ToyScenes", "training": "ToyTraining"}


def write_plugin(folder: Path, lease: float) -> dict[str, str]:
    """Write a plugin of the toys into a folder, which also sets the lease; returns what the environment then needs."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = [f'[project.entry-points."anystyle.{kind}"]\ntoy = "toys:{name}"\n' for kind, name in _KINDS.items()]
    (folder / "pyproject.toml").write_text('[project]\nname = "toys"\nversion = "1"\n' + "".join(lines))
    (folder / "toys.py").write_text(_PLUGIN.format(lease=lease))
    return {"ANYSTYLE_PLUGINS": str(folder)}


def sweep_words(folder: Path | str, seeds: str = "0,1,2") -> list[str]:
    """The words of the sweep, after the launcher's: four jobs for each seed."""
    return [
        "training=toy", "backbone=toy", "scenes=toy", "weights.backbone=null", "loss=[]", "scenes.size=[16,16]",
        "trainer.max_steps=8", "trainer.log_every_n_steps=1", "checkpoint.every_steps=1", f"seed={seeds}",
        "training.learning_rate=0.001,0.002,0.003,0.004", f"hydra.sweep.dir={folder}",
    ]  # fmt: skip
