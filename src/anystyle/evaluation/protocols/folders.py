"""Any method's images, in three folders."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from PIL import Image, ImageEnhance

from anystyle.contracts import Metric
from anystyle.contracts.protocol import Evaluation, Protocol
from anystyle.evaluation.judge import judge_pairing
from anystyle.evaluation.pairing import pair
from anystyle.types import OnProgress


class Folders(Protocol):
    """Judge stylized images of any method against their photographs and styles.

    Stylized images are ``SCENE/STYLE/FRAME.png`` or ``SCENE/STYLE_FRAME.png``, of one scene also without its folder;
    photographs are ``SCENE/FRAME.png``, styles ``STYLE.png``; or all three have the same names.

    Args:
        content: A folder of photographs.
        style: A folder of style images.
        stylized: A folder of results.
        depth: A folder of depth maps ``SCENE/FRAME.npy``, with ``SCENE/cameras.npz`` where cameras are known.
        missing: ``refuse`` judges nothing until every photograph has an image in every style; ``allow`` judges those
            that are there, and says what is missing.
    """

    def __init__(
        self,
        *,
        metrics: Mapping[str, Metric],
        content: str,
        style: str,
        stylized: str,
        depth: str | None = None,
        missing: Literal["refuse", "allow"] = "refuse",
    ) -> None:
        self.metrics = metrics
        folders = Path(content), Path(style), Path(stylized), None if depth is None else Path(depth)
        self.pairing = pair(*folders, missing=missing)

    @classmethod
    def check(cls, **given: Any) -> None:
        cls(metrics={}, **given)

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        grey = Image.linear_gradient("L").convert("RGB").resize((24, 16))
        for scene, turn in (("one", 0), ("two", 180)):
            for frame in range(2):
                files = [("content", f"{frame}"), ("stylized", f"a_{frame}"), ("stylized", f"b_{frame}")]
                for shade, (kind, name) in enumerate(files):
                    (folder / kind / scene).mkdir(parents=True, exist_ok=True)
                    picture = ImageEnhance.Brightness(grey.rotate(turn)).enhance(1 - 0.2 * shade)
                    picture.save(folder / kind / scene / f"{name}.png")
        (folder / "style").mkdir()
        for name in ("a", "b"):
            grey.transpose(Image.Transpose.ROTATE_90).save(folder / "style" / f"{name}.png")
        return {kind: str(folder / kind) for kind in ("content", "style", "stylized")}

    def run(self, out: Path, on_progress: OnProgress) -> Evaluation:
        return judge_pairing(self.metrics, self.pairing, on_progress)
