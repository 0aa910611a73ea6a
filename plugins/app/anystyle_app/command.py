"""``anystyle app``: a page in the browser on which scenes are made."""

import argparse
import signal
import socket
import time
from collections.abc import Sequence
from pathlib import Path

from anystyle.cli.arguments import new_parser, split
from anystyle.cli.run import show
from anystyle.contracts import Command
from anystyle.errors import UserError, of_extra


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle app``; all other words are Hydra's, as those of ``anystyle stylize``."""
    flags = new_parser(
        "app",
        "Open a page on which photographs, a video or a splat become a scene in a style. Arguments such as key=value "
        "are Hydra overrides, as those of anystyle stylize, and hold for every scene.",
    )
    add = flags.add_argument
    add("--out", type=Path, default=Path("out/app"), help="where scenes go, each in its folder (default: %(default)s)")
    add("--host", default="127.0.0.1", help="the address to answer at, such as 0.0.0.0 (default: %(default)s)")
    add("--port", type=int, help="the port to answer at (default: the first free one from 7860)")
    add("--share", action="store_true", help="answer also at a public address of gradio.live, through its servers")
    return flags


class App(Command):
    """A page on which photographs, a video or a splat become a scene in a style."""

    def __call__(self, words: Sequence[str]) -> None:
        arguments, overrides = split(parser(), words)
        of_extra("gradio", "anystyle app needs", "app")
        try:  # Gradio would try a hundred ports, each for seconds
            socket.create_server((arguments.host, arguments.port or 0)).close()
        except (OSError, OverflowError) as error:
            port, why = arguments.port or "any", getattr(error, "strerror", error)
            raise UserError(f"cannot answer at {arguments.host}, port {port}: {why}") from error
        from anystyle_app.making import Maker
        from anystyle_app.page import build, launch

        maker = Maker(arguments.out, overrides)
        address = launch(build(maker), maker, arguments.host, arguments.port, share=arguments.share)
        print(f"{address} makes scenes, which go to {maker.out}; Ctrl-C ends it", flush=True)
        show(address)
        try:
            while True:
                time.sleep(1)
                # Libraries that are imported where scenes are made replace Python's handler.
                signal.signal(signal.SIGTERM, signal.getsignal(signal.SIGTERM))
        finally:
            maker.close()
