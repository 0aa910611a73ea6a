"""The paper's tables: a model, the renders of other methods, and the photographs, in one go."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from PIL import Image

from anystyle.contracts import Method, Metric
from anystyle.contracts.protocol import Evaluation, Protocol
from anystyle.data.folder import read_picture
from anystyle.data.images import image_size, read_square, to_tensor
from anystyle.data.scene_folder import FolderScenes
from anystyle.data.style_folder import FolderStyles
from anystyle.errors import UserError
from anystyle.evaluation import record
from anystyle.evaluation.judge import judge_pairing
from anystyle.evaluation.pairing import Pairing, StylizedImages
from anystyle.paths import expanded
from anystyle.ranges import AtLeastOne, Count
from anystyle.stylizer import Stylizer
from anystyle.types import OnProgress
from anystyle_paper import published_scores
from anystyle_paper.model_renders import ModelRenders, Variant, suffix_of, write_picture
from anystyle_paper.paper_folder import NUM_FRAMES, NUM_STYLES, SCENES, PaperFolder

PHOTOGRAPHS = "photographs"
STYLE_SIZE = 256

_log = logging.getLogger(__name__)


class Tables(Protocol):
    """Every row of a table of the paper: the model with images and with texts, methods' renders, the photographs.

    ``root`` holds ``content/SCENE/FRAME.png``, ``styles/STYLE.png`` with ``styles/captions.jsonl``, and for a further
    method ``methods/METHOD/SCENE/STYLE/FRAME.png`` (or ``STYLE_FRAME.png``). Photographs are cut to the size of a
    method's renders. Each row's scores lie in ``methods/NAME`` of the results, where ``anystyle report`` reads them.

    Args:
        root: The folder.
        table: The paper's table whose scores are computed, such as ``table_2``; ``None`` takes every metric.
        guides: How styles enter the model: ``image``, ``text``, or both; none leaves the model out.
        methods: Which folders of methods are judged; ``None`` takes all.
        photographs: How many styles the photographs themselves are judged with, as a baseline that changes nothing; 0
            leaves them out.
        variant: As in ``protocol=paper``.
        scene_names: Which scenes, in this order.
        num_styles: How many styles, from the first.
        frames: How many frames of each scene are judged, from its first.
        size: Sides of the square views in pixels.
        missing: ``refuse`` judges nothing until methods have all images; ``allow`` judges those that are there.
    """

    def __init__(
        self,
        *,
        stylizer: Stylizer,
        metrics: Mapping[str, Metric],
        method: Method | None = None,
        root: str | None = None,
        table: str | None = None,
        guides: Sequence[Literal["image", "text"]] = ("image", "text"),
        methods: Sequence[str] | None = None,
        photographs: Count = 1,
        variant: Variant = "reference",
        scene_names: Sequence[str] = SCENES,
        num_styles: AtLeastOne = NUM_STYLES,
        frames: AtLeastOne = NUM_FRAMES,
        size: AtLeastOne = 448,
        missing: Literal["refuse", "allow"] = "refuse",
        inputs: PaperFolder | None = None,
    ) -> None:
        self.stylizer, self.method = stylizer, method
        self.metrics = _metrics_of(metrics, table)
        self.folder = inputs or _complete_folder(root, scene_names, num_styles, frames, guides, methods, missing)
        self.guides: tuple[Literal["image", "text"], ...] = tuple(guides)
        if "text" in self.guides and not stylizer.style_encoder.reads_texts:
            self.guides = tuple(guide for guide in self.guides if guide != "text")
            _log.warning("this model reads no texts: the row model_text is left out")
        self.methods = tuple(self.folder.methods if methods is None else methods)
        self.photographs = min(photographs, num_styles)
        self.variant: Variant = variant
        self.size = size
        if not (self.guides or self.methods or self.photographs):
            raise UserError("nothing is to be judged: name guides or methods, or give photographs=1")

    @classmethod
    def check(cls, **given: Any) -> PaperFolder:
        names = ("root", "scene_names", "num_styles", "frames", "guides", "methods", "missing")
        return _complete_folder(*(given[name] for name in names))

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        grey = Image.linear_gradient("L").convert("RGB").resize((16, 16))
        render = folder / "methods" / "flip" / "garden" / "00"
        for path in (folder / "content" / "Garden", folder / "styles", render):
            path.mkdir(parents=True)
        for frame in range(2):
            grey.rotate(10 * frame).save(folder / "content" / "Garden" / f"{frame}.png")
            grey.rotate(180 + 10 * frame).save(render / f"{frame}.png")
        grey.rotate(90).save(folder / "styles" / "00.png")
        (folder / "styles" / "captions.jsonl").write_text('{"image": "00.png", "text": "grey"}\n')
        return {"root": str(folder), "scene_names": ["Garden"], "num_styles": 1, "frames": 2, "size": 16}

    def run(self, out: Path, on_progress: OnProgress) -> Evaluation:
        rows = {
            (name := f"model_{guide}"): self._model(guide).run(out / "methods" / name, on_progress)
            for guide in self.guides
        }
        renders = {name: self.folder.renders(name) for name in self.methods}
        if self.photographs:
            styles = [path.stem for path in self.folder.style_files[: self.photographs]]
            renders[PHOTOGRAPHS] = {
                (scene, style): dict(enumerate(self._content(out, scene, (self.size, self.size))))
                for scene in self.folder.scene_names
                for style in styles
            }
        for name, images in renders.items():
            gaps = self.folder.gaps(name) if name in self.methods else ()
            cells = tuple(self._cell(out, scene, style, images) for (scene, style), images in images.items() if images)
            rows[name] = judge_pairing(self.metrics, Pairing(cells, tuple(gaps)), on_progress, stage=name)
        for name, row in rows.items():
            folder = out / "methods" / name
            folder.mkdir(parents=True, exist_ok=True)
            record.write(row, folder, {"protocol": f"tables, {name}", "variant": self.variant})
        return self._together(rows)

    def _model(self, guide: Literal["image", "text"]) -> ModelRenders:
        patch_size = self.stylizer.backbone.patch_size
        return ModelRenders(
            stylizer=self.stylizer,
            metrics=self.metrics,
            scenes=FolderScenes(root=str(self.folder.root / "content"), short_side=self.size, multiple=patch_size),
            styles=FolderStyles(root=str(self.folder.styles), size=STYLE_SIZE),
            guide=guide,
            variant=self.variant,
            scene_names=[self.folder.scene_folder_name(scene) for scene in self.folder.scene_names],
            num_styles=self.folder.num_styles,
            frames=self.folder.frames,
            method=self.method,
        )

    def _cell(self, out: Path, scene: str, style: str, images: Mapping[int, Path]) -> StylizedImages:
        """Images of a scene in a style, by the places of their photographs."""
        places, stylized = zip(*sorted(images.items()), strict=True)
        photographs = self._content(out, scene, image_size(stylized[0]))
        frames, content = zip(*((f"{place:03d}", photographs[place]) for place in places), strict=True)
        return StylizedImages(scene, style, frames, content, stylized, self._style(out, style), numbers=places)

    def _content(self, out: Path, scene: str, size: tuple[int, int]) -> list[Path]:
        """The photographs of a scene, cut to a width and height and written as the variant writes images."""
        folder = out / "content" / f"{size[0]}x{size[1]}" / scene
        paths: list[Path] = []
        for index, source in enumerate(self.folder.photographs(scene)):
            paths.append(folder / f"{index:03d}{suffix_of(self.variant)}")
            if not paths[-1].is_file():
                picture, _ = read_picture(source, source.stem, (size[1], size[0]))
                write_picture(paths[-1], to_tensor(picture), self.variant)
        return paths

    def _style(self, out: Path, style: str) -> Path:
        path = out / "styles" / f"{style}{suffix_of(self.variant)}"
        if not path.is_file():
            source = next(file for file in self.folder.style_files if file.stem == style)
            write_picture(path, read_square(source, STYLE_SIZE)[0], self.variant)
        return path

    def _together(self, rows: Mapping[str, Evaluation]) -> Evaluation:
        title, first = next(iter(rows.items()))
        warnings = (text for row in rows.values() for text in row.provenance.get("warnings", []))
        return replace(
            first,
            n=sum(row.n for row in rows.values()),
            groups={name: row.scores for name, row in rows.items() if name != title},
            rows=tuple(replace(item, scene=f"{name}/{item.scene}") for name, row in rows.items() for item in row.rows),
            stand_ins={score: network for row in rows.values() for score, network in row.stand_ins.items()},
            provenance={
                "variant": self.variant,
                "scenes": list(self.folder.scene_names),
                "methods": list(rows),
                "title": title,
                "warnings": list(dict.fromkeys(warnings)),
                "missing": [
                    gap | {"scene": f"{name}/{gap['scene']}"}
                    for name, row in rows.items()
                    for gap in row.provenance["missing"]
                ],
            },
        )


def _complete_folder(
    root: str | None,
    scene_names: Sequence[str],
    num_styles: int,
    frames: int,
    guides: Sequence[str],
    methods: Sequence[str] | None,
    missing: Literal["refuse", "allow"],
) -> PaperFolder:
    """The folder; a UserError if something in it is missing."""
    if root is None:
        raise UserError("root is not given; add root=FOLDER, which holds content, styles and methods")
    folder = PaperFolder(expanded(root), tuple(scene_names), num_styles, frames)
    folder.require(texts="text" in guides, methods=methods, missing=missing)
    return folder


def _metrics_of(metrics: Mapping[str, Metric], table: str | None) -> dict[str, Metric]:
    if table is None:
        return dict(metrics)
    tables = published_scores.tables()
    if table not in tables:
        raise UserError(f"table={table}: the paper has {', '.join(tables)}")
    scores = set(tables[table])
    chosen = {name: metric for name, metric in metrics.items() if scores & {*metric.better, *type(metric).better}}
    if metrics and not chosen:
        raise UserError(f"no metric that is chosen has a score of {table} ({', '.join(tables[table])})")
    return chosen
