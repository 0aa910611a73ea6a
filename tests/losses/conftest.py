from pathlib import Path

import pytest

from anystyle.perception import weights
from style_cases import filled_vgg_file


@pytest.fixture(autouse=True)
def vgg_of_the_goldens(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Losses find the goldens' VGG where the published one would lie; the bundled networks stay in reach."""
    entry = weights.FILES["vgg19"]
    folder = tmp_path / "weights"
    folder.mkdir()
    (folder / "vgg19.safetensors").symlink_to(filled_vgg_file())
    monkeypatch.setenv(weights.FOLDERS, str(folder))
    monkeypatch.setitem(
        weights.FILES, "vgg19", weights.WeightsFile("vgg19.safetensors", entry.purpose, entry.license, entry.source)
    )
