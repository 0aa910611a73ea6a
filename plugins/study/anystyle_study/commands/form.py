"""``anystyle study form``: the page that participants see."""

import argparse
from contextlib import closing
from pathlib import Path

from anystyle.commands._flags import new_parser
from anystyle.errors import UserError
from anystyle_study.protocol import read_study
from anystyle_study.server import serve, write_page
from anystyle_study.store import Store


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle study form``."""
    words = new_parser(
        "study form",
        "Write the study as one page that works offline, keeps answers in the browser and saves them as JSON at the "
        "end; or serve it, with every answer stored before the next.",
    )
    add = words.add_argument
    add("study", type=Path, help="the folder that `anystyle study design` made")
    add("--out", type=Path, help="the page to write (default: form.html in the study's folder)")
    add("--serve", action="store_true", help="serve the page instead, until interrupted")
    add("--host", default="127.0.0.1", help="address to serve at; 0.0.0.0 lets other machines in")
    add("--port", type=int, default=8765, help="port to serve at; 0 takes a free one")
    add("--database", type=Path, help="answers when serving (default: answers.sqlite in the folder)")
    add("--release", metavar="ID", help="let this code or id go on in another browser, and stop")
    return words


def command(arguments: argparse.Namespace) -> None:
    """Run it."""
    study = read_study(arguments.study)
    folder = arguments.study if arguments.study.is_dir() else arguments.study.parent
    database = arguments.database or folder / "answers.sqlite"
    first, last = study.participants[0].id, study.participants[-1].id
    if arguments.release:
        if not database.is_file():
            raise UserError(f"there are no answers at {database}; name the file with --database")
        with closing(Store(study=study, path=database)) as store:
            store.release(arguments.release)
        print(f"{arguments.release} can go on in the browser that asks next")
    elif arguments.serve:
        if not 0 <= arguments.port <= 65535:
            raise UserError(f"--port {arguments.port}: expected 0 to 65535")

        def ready(url: str) -> None:
            names = study.plan.id_parameters
            query = f"{names[0]}=ID" if names else f"p={first} (codes {first} to {last})"
            print(f"serving at {url}?{query}; answers go to {database}", flush=True)

        serve(study, folder, database, host=arguments.host, port=arguments.port, ready=ready)
        print(f"next: anystyle study analyze {database} --study {arguments.study} --out analysis")
    else:
        out = arguments.out or folder / "form.html"
        write_page(study, folder, out)
        size = out.stat().st_size / 1e6
        print(f"{out}: {size:.1f} MB; participants open it and enter their code, or use {out.name}#{first}")
        print(f"next: anystyle study analyze ANSWERS... --study {arguments.study} --out analysis")
