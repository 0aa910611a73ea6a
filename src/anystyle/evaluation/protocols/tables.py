"""The paper's tables: a model, the renders of other methods, and the photographs, in one go."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from PIL import Image

from anystyle.contracts import Metric
from anystyle.data.folder import read_picture
from anystyle.data.images import image_size, read_square, to_tensor
from anystyle.data.scene_folder import FolderScenes
from anystyle.data.style_folder import FolderStyles
from anystyle.evaluation import published, record
from anystyle.evaluation.contract import Evaluation, Progress, Protocol
from anystyle.evaluation.folders import Cell, Pairing
from anystyle.evaluation.layout import NUM_FRAMES, NUM_STYLES, SCENES, Layout
from anystyle.evaluation.model_renders import ModelRenders, Variant, suffix_of, write_picture
from anystyle.evaluation.resume import judge_pairing
from anystyle.methods.contract import Method
from anystyle.stylizer import Stylizer

PHOTOGRAPHS = "photographs"
STYLE_SIZE = 256


class Tables(Protocol):
    """Every row of a table of the paper: the model with images and with texts, methods' renders, the photographs.

    ``root`` holds ``content/SCENE/FRAME.png``, ``styles/STYLE.png`` with ``styles/captions.jsonl``, and for a further
    method ``methods/METHOD/SCENE/STYLE/FRAME.png`` (or ``STYLE_FRAME.png``). Photographs are cut to the size of a
    method's renders. Each row's figures lie in ``methods/NAME`` of the results, where ``anystyle report`` reads them.

    Args:
        root: The folder.
        table: The paper's table whose figures are computed, such as ``table_2``; ``None`` takes every metric.
        guides: How styles enter the model: ``image``, ``text``, or both; none leaves the model out.
        methods: Which folders of methods are judged; ``None`` takes all.
        photographs: With how many styles the photographs are judged, as a method that changes nothing; 0 leaves
            them out.
        variant: As in ``protocol=paper``.
        scene_names: Which scenes, in this order.
        num_styles: The first so many.
        frames: Of each scene, the first so many are judged.
        size: Sides of the square views in pixels.

    Raises:
        ValueError: The folder lacks something, or no metric has the table's figures.
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
        photographs: int = 1,
        variant: Variant = "reference",
        scene_names: Sequence[str] = SCENES,
        num_styles: int = NUM_STYLES,
        frames: int = NUM_FRAMES,
        size: int = 448,
    ) -> None:
        if root is None:
            raise ValueError("root is not given; add root=FOLDER, which holds content, styles and methods")
        for name, value in (("num_styles", num_styles), ("frames", frames), ("size", size)):
            if value < 1:
                raise ValueError(f"{name}={value}: give at least 1")
        self.stylizer, self.method = stylizer, method
        self.metrics = _metrics_of(metrics, table)
        self.layout = Layout(Path(root).expanduser(), tuple(scene_names), num_styles, frames)
        self.guides = tuple(guides)
        self.methods = tuple(self.layout.methods if methods is None else methods)
        self.photographs = min(photographs, num_styles)
        self.variant: Variant = variant
        self.size = size
        if not (self.guides or self.methods or self.photographs):
            raise ValueError("nothing is to be judged: name guides or methods, or give photographs=1")
        self.layout.require(texts="text" in self.guides, methods=self.methods)

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
        return {
            "root": str(folder), "scene_names": ["Garden"], "num_styles": 1, "frames": 2, "size": 16,
        }  # fmt: skip

    def run(self, out: Path, progress: Progress) -> Evaluation:
        rows: dict[str, Evaluation] = {}
        for guide in self.guides:
            name = f"model_{guide}"
            rows[name] = self._model(guide).run(out / "methods" / name, progress)
        for name in self.methods:
            pairing = self._pairing(out, self.layout.renders(name))
            rows[name] = judge_pairing(self.metrics, pairing, out / "methods" / name, progress, stage=name)
        if self.photographs:
            pairing = self._photographs(out)
            rows[PHOTOGRAPHS] = judge_pairing(self.metrics, pairing, out / "methods" / PHOTOGRAPHS, progress)
        for name, row in rows.items():
            folder = out / "methods" / name
            folder.mkdir(parents=True, exist_ok=True)
            record.write(row, folder, {"protocol": f"tables, {name}", "variant": self.variant})
        return self._together(rows)

    def _model(self, guide: Literal["image", "text"]) -> ModelRenders:
        patch = self.stylizer.backbone.patch_size
        return ModelRenders(
            stylizer=self.stylizer,
            metrics=self.metrics,
            scenes=FolderScenes(root=str(self.layout.content), short_side=self.size, multiple=patch),
            styles=FolderStyles(root=str(self.layout.styles), size=STYLE_SIZE),
            guide=guide,
            variant=self.variant,
            scene_names=[self.layout.scene_folder_name(scene) for scene in self.layout.scene_names],
            num_styles=self.layout.num_styles,
            frames=self.layout.frames,
            method=self.method,
        )

    def _pairing(self, out: Path, renders: Mapping[tuple[str, str], Sequence[Path]]) -> Pairing:
        return Pairing(
            tuple(
                Cell(
                    scene=scene,
                    style=style,
                    frames=tuple(f"{index:03d}" for index in range(len(paths))),
                    content=self._content(out, scene, image_size(paths[0])),
                    stylized=tuple(paths),
                    reference=self._style(out, style),
                )
                for (scene, style), paths in renders.items()
            )
        )

    def _photographs(self, out: Path) -> Pairing:
        styles = [path.stem for path in self.layout.style_files[: self.photographs]]
        renders = {
            (scene, style): self._content(out, scene, (self.size, self.size))
            for scene in self.layout.scene_names
            for style in styles
        }
        return self._pairing(out, renders)

    def _content(self, out: Path, scene: str, size: tuple[int, int]) -> tuple[Path, ...]:
        """The photographs of a scene, cut to a width and height and written as the variant writes images."""
        folder = out / "content" / f"{size[0]}x{size[1]}" / scene
        paths = []
        for index, source in enumerate(self.layout.photographs(scene)):
            paths.append(folder / f"{index:03d}{suffix_of(self.variant)}")
            if not paths[-1].is_file():
                picture, _ = read_picture(source, source.stem, (size[1], size[0]))
                write_picture(paths[-1], to_tensor(picture), self.variant)
        return tuple(paths)

    def _style(self, out: Path, style: str) -> Path:
        path = out / "styles" / f"{style}{suffix_of(self.variant)}"
        if not path.is_file():
            source = next(file for file in self.layout.style_files if file.stem == style)
            write_picture(path, read_square(source, STYLE_SIZE)[0], self.variant)
        return path

    def _together(self, rows: Mapping[str, Evaluation]) -> Evaluation:
        name, first = next(iter(rows.items()))
        return Evaluation(
            figures=first.figures,
            n=sum(row.n for row in rows.values()),
            better=first.better,
            groups={other: row.figures for other, row in rows.items() if other != name},
            rows=tuple(
                replace(item, scene=f"{method}/{item.scene}") for method, row in rows.items() for item in row.rows
            ),
            stand_ins={figure: network for row in rows.values() for figure, network in row.stand_ins.items()},
            times=first.times,
            provenance={
                "variant": self.variant,
                "scenes": list(self.layout.scene_names),
                "methods": list(rows),
                "title": name,
                "warnings": list(
                    dict.fromkeys(text for row in rows.values() for text in row.provenance.get("warnings", []))
                ),
            },
        )


def _metrics_of(metrics: Mapping[str, Metric], table: str | None) -> dict[str, Metric]:
    if table is None:
        return dict(metrics)
    tables = published.tables()
    if table not in tables:
        raise ValueError(f"table={table}: the paper has {', '.join(tables)}")
    figures = set(tables[table].figures)
    chosen = {name: metric for name, metric in metrics.items() if figures & set(metric.better)}
    if metrics and not chosen:
        raise ValueError(f"no metric that is chosen has a figure of {table} ({', '.join(tables[table].figures)})")
    return chosen
