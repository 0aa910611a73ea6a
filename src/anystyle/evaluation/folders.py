"""Any method's images, in three folders."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from PIL import Image, ImageEnhance

from anystyle.contracts import Metric
from anystyle.contracts.protocol import Evaluation, Protocol
from anystyle.evaluation.judge import judge_pairing
from anystyle.evaluation.pairing import Pairing, pair
from anystyle.types import OnProgress


class Folders(Protocol):
    """Judge stylized images of any method against their photographs and styles.

    Photographs are ``SCENE/FRAME.png`` (of one scene also ``FRAME.png``), styles ``STYLE.png``.

    Args:
        content: A folder of photographs.
        style: A folder of style images.
        stylized: A folder of results.
        depth: A folder of depth maps ``SCENE/FRAME.npy``, with ``SCENE/cameras.npz`` where cameras are known.
        layout: How results are named, such as ``{scene}_{style}/*/{frame}``: names of photographs and styles, and any
            text. ``None`` tries ``{scene}/{style}/{frame}``, ``{scene}/{style}_{frame}`` and ``{style}/{frame}``.
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
        layout: str | None = None,
        missing: Literal["refuse", "allow"] = "refuse",
        inputs: Pairing | None = None,
    ) -> None:
        self.metrics = metrics
        self.pairing = inputs or self.check(
            content=content, style=style, stylized=stylized, depth=depth, layout=layout, missing=missing
        )

    @classmethod
    def check(cls, **given: Any) -> Pairing:
        content, style, stylized = (Path(given[name]) for name in ("content", "style", "stylized"))
        depth = None if given["depth"] is None else Path(given["depth"])
        pairing = pair(content, style, stylized, depth, layout=given["layout"], missing=given["missing"])
        pairing.refuse_numbered_anew()
        return pairing

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
