"""The Hugging Face cache, where the extra ``hub`` is installed: what lies there is found, offline."""

from pathlib import Path

import pytest

from anystyle.errors import UserError
from anystyle.vision import weights
from tests.support.refusals import raises_line

hub = pytest.importorskip("huggingface_hub", reason='needs the extra: pip install "anystyle[hub]"')


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache, and no network."""
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_CACHE", str(tmp_path))
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
    monkeypatch.setenv(weights.FOLDERS, str(tmp_path / "nothing"))
    return tmp_path


def test_files_in_the_cache_are_found(cache: Path) -> None:
    repository = cache / "models--BeichenZhang--LongCLIP-B-32"
    snapshot = repository / "snapshots" / ("0" * 40)
    snapshot.mkdir(parents=True)
    (repository / "refs").mkdir()
    (repository / "refs" / "main").write_text("0" * 40)
    with pytest.raises(FileNotFoundError, match=r"looked for .*, the Hugging Face cache"):
        weights.find("longclip_b32")
    (snapshot / "longclip-B-32.pt").write_bytes(b"weights")
    assert weights.find("longclip_b32").read_bytes() == b"weights"
    assert weights.download("longclip_b32").read_bytes() == b"weights"


def test_a_download_without_a_network_says_what_to_do(cache: Path) -> None:
    with raises_line(UserError, match=r"cannot be fetched \(.*\); try again, or get it from https://"):
        weights.download("longclip_b32")
