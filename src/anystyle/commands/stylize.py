"""Photographs and a style in, a stylized Gaussian scene out."""

import argparse
import sys
from collections.abc import Sequence

from omegaconf import DictConfig

from anystyle.cli.launch import describe, job_folder, launch
from anystyle.cli.run import run, show, words_of
from anystyle.pipeline.flags import parsed, parser
from anystyle.registry.catalog import catalog
from anystyle.registry.jobs import job_overrides

_EXAMPLES = "Examples that come with anystyle, for any path of photographs or of an image:"


def main(args: Sequence[str] | None = None) -> None:
    """Run ``anystyle stylize``."""

    def command() -> None:
        flags, words = parser(), words_of(args)
        if {"-h", "--help"} & {*words}:
            from anystyle.examples import listed

            describe(flags)
            flags.epilog = f"{flags.epilog}\n{_EXAMPLES}\n{listed()}"
        arguments, overrides = parsed(words, flags)
        launch("stylize", lambda config: job(config, arguments), overrides, out=arguments.out)

    run(command)


def job(config: DictConfig, arguments: argparse.Namespace) -> None:
    """Stylize as one composed configuration says, and print where the results are."""
    from anystyle.io.sheet import to_pil  # torch takes seconds, in which a mistyped word is answered
    from anystyle.pipeline.stages import Stages
    from anystyle.pipeline.stylize import stylize
    from anystyle.pipeline.words import request_of
    from anystyle.types import Progress

    request = request_of(arguments, job_overrides(), config)
    target = job_folder(arguments.out)
    thumbnail = target.with_name(f"{target.name}.progress.png")

    def report(stage: str, progress: Progress) -> None:
        print(f"{stage} {progress.line} …", file=sys.stderr, flush=True)
        if progress.thumbnail is not None:
            to_pil(progress.thumbnail).save(thumbnail)

    stages = Stages(report)
    try:
        results = stylize(request, out=target, overwrite=arguments.overwrite, stages=stages)
    finally:
        thumbnail.unlink(missing_ok=True)
    scenes = f"{len(results)} stylized scene{'s' if len(results) > 1 else ''}"
    # Among the files of all styles, one that nothing reads back is a page to look at.
    formats = [(name, catalog().find("format", name).load()) for name in request.export.formats]
    pages = [target / f"scene.{name}" for name, kind in formats if kind.many_styles and not kind.reads]
    page = next((path for path in pages if path.is_file()), target / "sheet.png")
    own = "".join(f"; each style has a {path.name} in its folder" for path in pages if not path.is_file())
    took = f"{sum(stages.seconds.values()):.0f} s, {stages.write_share:.0%} of them for files"
    held_out = {"": "", "aligned_": " with poses aligned", "matched_": " with colours matched"}
    values = {told: results.run.encoded.reconstruction.get(f"heldout_{name}psnr") for name, told in held_out.items()}
    words = [f"{value:.1f} dB{told}" for told, value in values.items() if value is not None]
    quality = f"; PSNR of held-out photographs: {', '.join(words)}" if words else ""
    print(f"{scenes} in {target} in {took}{quality}; look at {page}{own}")
    if arguments.open:
        show(page.resolve().as_uri())


if __name__ == "__main__":
    main()
