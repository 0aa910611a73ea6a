"""Whether a cell's figures can be made again: what they rest on, compared with what is there now, and the figures."""

import shutil
from collections.abc import Sequence
from functools import cache, cached_property
from pathlib import Path

from anystyle.errors import UserError, one_line
from anystyle.evaluation.verify import Verification, changes, compared
from anystyle.io.checkpoint import sha256
from anystyle.io.documents import as_number, kept_json
from anystyle.types import OnProgress
from anystyle.vision import weights
from anystyle_benchmark.judge import Judge
from anystyle_benchmark.results import CellFigures, Figures, Origin, Record, bind, is_done
from anystyle_benchmark.run import origin_now, run_scene
from anystyle_benchmark.spec import Spec, read_spec
from anystyle_benchmark.track import PROTOCOL, Inputs


class Verifier:
    """Makes cells of judged results again.

    Args:
        figures: What the judge found.
        inputs: The track as it is now.
        out: A fresh folder for what is made.
        programs: Files of the methods that are not bundled, by the methods' names.
        results: The folder of the judged images; without it all styles of a cell's scene are made, not the cell's
            alone, as some of its figures compare it with those.
    """

    def __init__(
        self, figures: Figures, inputs: Inputs, out: Path, programs: dict[str, str], results: Path | None
    ) -> None:
        self.figures, self.inputs, self.out, self.programs, self.results = figures, inputs, out, programs, results

    def cheaply(self, cell: CellFigures) -> Verification:
        """Compare what a cell rests on with what is there now; nothing is run."""
        try:
            spec, _ = self._program(cell)
        except UserError as error:
            return Verification(_name(cell), failure=one_line(error))
        now = origin_now(spec, {file: _hash(file) for file in self._origin(cell).weights})
        return Verification(_name(cell), changed=self._changed(cell, spec, now))

    def again(self, cells: Sequence[CellFigures], on_progress: OnProgress) -> list[Verification]:
        """Make cells of one method and seed, scene and guide again, and compare their figures."""
        method, seed, scene, guide = cells[0].method, cells[0].seed, cells[0].scene, cells[0].guide
        try:
            spec, home = self._program(cells[0])
        except UserError as error:
            return [Verification(_name(cell), failure=one_line(error)) for cell in cells]
        judged = [cell for cell in self.figures.cells_of(method, guide) if (cell.seed, cell.scene) == (seed, scene)]
        styles = [self.inputs.style(cell.style) for cell in judged if cell.status == "done"]
        for cell in judged:
            if self.results is not None and cell not in cells and is_done(cell.cell, self.results):
                shutil.copytree(cell.cell.images(self.results), cell.cell.images(self.out), dirs_exist_ok=True)
                shutil.copy(cell.cell.record(self.results), cell.cell.record(self.out))
        run_scene(self.inputs, spec, home, self.inputs.scene(scene), styles, seed, self.out, say=lambda line: None)
        found = self._judge([spec], bind(self.inputs, self.out), on_progress)
        made = {cell.cell: cell for cell in found.cells}
        return [self._compared(cell, made[cell.cell], spec) for cell in cells]

    def _compared(self, cell: CellFigures, made: CellFigures, spec: Spec) -> Verification:
        changed = self._changed(cell, spec, (kept_json(cell.cell.record(self.out), Record) or Record("missing")).origin)
        if made.status != "done":
            return Verification(_name(cell), failure=made.message, changed=changed)
        if made.images != cell.images:
            changed = ("images", *changed)
        before, now = ({name: as_number(one.figures.get(name)) for name in cell.figures} for one in (cell, made))
        return compared(_name(cell), before, now, changed)

    def _program(self, cell: CellFigures) -> tuple[Spec, Path]:
        """A method's spec as it is now, with its folder."""
        spec, home = read_spec(self.programs.get(cell.method, cell.method))
        if spec.name != cell.method:
            raise UserError(f"{self.programs[cell.method]} is the spec of {spec.name}, not of {cell.method}")
        return spec, home

    def _origin(self, cell: CellFigures) -> Origin:
        return self.figures.origins.get(cell.origin, Origin())

    def _metrics(self, cell: CellFigures) -> list[str]:
        return list(dict.fromkeys(info.metric for name, info in self.figures.metrics.items() if name in cell.figures))

    def _changed(self, cell: CellFigures, spec: Spec, now: Origin) -> tuple[str, ...]:
        """What a cell's images and figures rest on that is not what it was, in words."""
        lock, metrics = self.figures.track, self._metrics(cell)
        judges = {
            file: digest
            for info in self.figures.metrics.values()
            if info.metric in metrics
            for file, digest in info.weights.items()
        }
        judges_now = {file: digest for name in metrics for file, digest in self._judge.metrics[name].weights.items()}
        before = _rests_on(self._origin(cell), self.figures.methods[cell.method], lock.hashes, lock.protocol, judges)
        return changes(before, _rests_on(now, spec, self._inputs, PROTOCOL, judges_now))

    @cached_property
    def _inputs(self) -> dict[str, str]:
        return self.inputs.computed_hashes()

    @cached_property
    def _judge(self) -> Judge:
        return Judge(self.inputs, self.out, list(dict.fromkeys(info.metric for info in self.figures.metrics.values())))


def _rests_on(
    origin: Origin, spec: Spec, inputs: dict[str, str], protocol: int, judges: dict[str, str]
) -> dict[str, str]:
    """Versions and hashes by what they are of."""
    found = {"code": origin.code, "judge": str(protocol)}
    found |= {f"method's {name}": str(getattr(spec, name) or "") for name in ("preset", "command", "requirements")}
    found |= {f"library {name}": version for name, version in origin.versions.items()}
    found |= {f"input {name}": digest for name, digest in inputs.items()}
    found |= {f"weights {file}": digest for file, digest in origin.weights.items()}
    return found | {f"judge's weights {file}": digest for file, digest in judges.items()}


@cache
def _hash(file: str) -> str:
    """The SHA-256 of a file of weights as it is now, by its name."""
    for name, row in weights.files().items():
        if row.file == file and any(path.is_file() for path in weights.candidates(name)):
            return sha256(weights.find(name))
    return "missing"


def _name(cell: CellFigures) -> str:
    return "/".join(map(str, cell.cell))
