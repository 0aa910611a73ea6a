import pytest

from anystyle.vision import weights
from tests.support.style_cases import filled_vgg_file


@pytest.fixture(autouse=True)
def vgg_of_the_goldens(monkeypatch: pytest.MonkeyPatch) -> None:
    """Losses find the goldens' VGG in place of the published one; the bundled networks stay in reach."""
    monkeypatch.setenv(weights.FOLDERS, str(filled_vgg_file().parent))
