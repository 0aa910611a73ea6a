"""``anystyle benchmark ladder``: how the metrics of a track order known distortions of a method's results."""

import argparse
from collections.abc import Sequence
from pathlib import Path

import msgspec
import torch

from anystyle.cli.arguments import new_parser, parse
from anystyle.cli.progress import progress_lines
from anystyle.errors import UserError, check_known
from anystyle.evaluation.tables import STAND_IN, Table, number, titled
from anystyle.io.atomic import atomic_directory, write_json, write_text
from anystyle.io.documents import as_number, kept_json
from anystyle.io.sheet import save_png, to_pil
from anystyle.types import Cameras, Gaussians, OnProgress, Progress
from anystyle_benchmark.command_judge import add_judging, processes_of, words_of
from anystyle_benchmark.distortions import DISTORTIONS, RANDOM, Shot
from anystyle_benchmark.judge import Judge
from anystyle_benchmark.ladder import BLIND, LADDER, STEPS, UNDISTORTED, Verdict, judged, rung
from anystyle_benchmark.ours import stylized
from anystyle_benchmark.results import FIGURES, Cell, Figures, Record, bind, is_done
from anystyle_benchmark.run import make_job
from anystyle_benchmark.spec import Spec, read_spec
from anystyle_benchmark.track import Inputs, SceneEntry, StyleEntry


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle benchmark ladder``."""
    flags = new_parser(
        "benchmark ladder",
        "Distort a method's scenes and views in rungs of known order, and count how many rungs each metric puts in "
        "order. Writes ladder.json, ladder.md and ladder.csv; what is done is not done again.",
    )
    add = flags.add_argument
    add("results", type=Path, help="a folder of its own for the rungs, which are kept as methods of a benchmark")
    add("--track", default="open", metavar="NAME", help="a track, or a track.toml (default %(default)s)")
    add("--method", default="branch", metavar="NAME", help="a preset that leaves a splat (default %(default)s)")
    for name, what in (("scenes", "all"), ("styles", "all images"), ("distortions", "all")):
        add(f"--{name}", default="", metavar="A,B", help=f"only these (default: {what})")
    add("--seeds", type=int, default=1, metavar="N", help="of random distortions, 0 to N - 1 (default %(default)s)")
    add_judging(flags)
    return flags


def main(args: Sequence[str]) -> None:
    """Run ``anystyle benchmark ladder``."""
    arguments = parse(parser(), args)
    root, inputs = arguments.results, Inputs(arguments.track, arguments.root)
    spec, _ = read_spec(arguments.method)
    if spec.preset is None:
        raise UserError(f"method {spec.name} is not a preset of anystyle stylize, and leaves no splat to distort")
    scenes = [inputs.scene(name) for name in words_of(arguments.scenes)] or list(inputs.track.scenes)
    styles = [inputs.style(name) for name in words_of(arguments.styles)]
    styles = styles or [style for style in inputs.track.styles if style.guide == "image"]
    names = words_of(arguments.distortions) or list(DISTORTIONS)
    check_known("distortion", names, DISTORTIONS)
    judge = Judge(inputs, root, words_of(arguments.metrics), processes=processes_of(arguments))
    lock, specs = bind(inputs, root), rungs(spec, names, {style.guide for style in styles}, arguments.seeds)
    for one in specs:
        kept = kept_json(root / one.name / "method.json", Spec)
        if kept is not None and kept.preset != one.preset:
            raise UserError(f"{root} holds rungs of another method ({' '.join(kept.preset or ())}); use another folder")
        write_json(root / one.name / "method.json", msgspec.to_builtins(one))
    on_progress = progress_lines()
    for scene in scenes:
        render(inputs, spec, names, scene, styles, root, arguments.seeds, on_progress)
    figures = judge(specs, lock, on_progress)
    write_json(root / FIGURES, msgspec.to_builtins(figures))
    verdicts = judged(figures, names)
    write_json(root / LADDER, msgspec.to_builtins({"track": lock, "method": spec, "verdicts": verdicts}))
    listed = table(verdicts, figures, spec)
    write_text(root / "ladder.md", listed.markdown())
    write_text(root / "ladder.csv", listed.csv())
    print(f"{listed.markdown()}\nin {root}: {LADDER}, ladder.md, ladder.csv")


def rungs(spec: Spec, names: Sequence[str], guides: set[str], seeds: int = 1) -> list[Spec]:
    """A method for each rung of each distortion, after that of none at all."""
    common = {"guides": tuple(sorted(guides)), "baseline": True, "preset": spec.preset}
    found = [Spec(UNDISTORTED, f"{spec.title}, as it is", f"The lowest rung of every ladder. {spec.about}", **common)]
    for name in names:
        one = DISTORTIONS[name]
        for index, strength in enumerate(one.strengths, 1):
            title = f"{one.title}, {strength:g}"
            drawn = seeds if name in RANDOM else 1
            found.append(Spec(rung(name, index), title, f"{strength:g} {one.unit}.", seeds=drawn, **common))
    return found


def render(
    inputs: Inputs,
    spec: Spec,
    names: Sequence[str],
    scene: SceneEntry,
    styles: Sequence[StyleEntry],
    root: Path,
    seeds: int,
    on_progress: OnProgress,
) -> None:
    """Write the views of a scene on every rung, in those styles in which one is missing."""
    steps = [(UNDISTORTED, 0, None, 0.0)]
    steps += [
        (rung(name, index), seed, DISTORTIONS[name], strength)
        for name in names
        for index, strength in enumerate(DISTORTIONS[name].strengths, 1)
        for seed in range(seeds if name in RANDOM else 1)
    ]
    missing = {
        style.name: [step for step in steps if not is_done(Cell(*step[:2], scene.name, style.name), root)]
        for style in styles
    }
    wanted = [style for style in styles if missing[style.name]]
    if not wanted:
        return
    on_progress(Progress.count(f"rungs of {scene.name}", 0, len(wanted)))
    results, cameras = stylized(make_job(inputs, scene, wanted, 0, root), spec.preset or ())

    def views(gaussians: Gaussians, cameras: Cameras) -> torch.Tensor:
        return torch.stack(list(results.encoded.render(gaussians, cameras)))

    for done, (style, result) in enumerate(zip(wanted, results, strict=True), 1):
        shots = [Shot(result.gaussians, results.run.unstyled, cameras, views, seed) for seed in range(seeds)]
        for name, seed, distortion, strength in missing[style.name]:
            cell = Cell(name, seed, scene.name, style.name)
            images = shots[0].views if distortion is None else distortion.apply(shots[seed], strength)
            with atomic_directory(cell.images(root)) as folder:
                for view, image in zip(scene.views, images, strict=True):
                    save_png(to_pil(image), folder / f"{view}.png")
            write_json(cell.record(root), msgspec.to_builtins(Record("done")))
        on_progress(Progress.count(f"rungs of {scene.name}", done, len(wanted)))


def table(verdicts: Sequence[Verdict], figures: Figures, method: Spec) -> Table:
    """Scores down, distortions across: how many steps are in order, and the verdict in words."""
    found = {(one.figure, one.distortion): one for one in verdicts}
    present = [name for name in DISTORTIONS if any(one.distortion == name for one in verdicts)]
    names = list(dict.fromkeys(one.figure for one in verdicts))
    better = {name: figures.metrics[name].better for name in names}
    rows = [(titled(name, better), *(_told(found.get((name, each))) for each in present)) for name in names]
    networks = {name: figures.metrics[name].stand_in for name in names if figures.metrics[name].stand_in}
    notes = (
        f"How many of {STEPS} steps to the next rung move the score as it should (to the worse, where nothing is "
        f"claimed). Verdicts are of Kendall's tau of rung and score: its 95 % interval for new scenes and styles "
        f"leaves 0 out; lies within {BLIND:g} of 0 (blind); or neither (undecided). Method {method.name}, track "
        f"{figures.track.name} {figures.track.version}.",
        *(f"{name}: {network} ({STAND_IN})." for name, network in networks.items()),
    )
    return Table(("score", *(DISTORTIONS[name].title for name in present)), tuple(rows), notes=notes)


def _told(verdict: Verdict | None) -> str:
    return "–" if verdict is None else f"{number(round(as_number(verdict.ordered.mean), 1))} {verdict.words}"
