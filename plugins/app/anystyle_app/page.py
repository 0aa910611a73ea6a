"""The page: what a scene is made of on the left, the scene on the right."""

import traceback
from pathlib import Path
from typing import Any

import gradio as gr
from gradio.themes import Default
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import Route

from anystyle.cli.run import message
from anystyle.errors import UserError, one_line
from anystyle.examples import PREFIX, examples, resolved
from anystyle.types import Progress
from anystyle_app.making import Maker, files_of
from anystyle_app.markup import EMPTY, said, shown

CSS = Path(__file__).with_name("page.css")
FONT, MONO = ("system-ui", "sans-serif"), ("ui-monospace", "monospace")
"""Fonts of the system: none is asked for from another server."""
LOOPBACK = ("127.0.0.1", "localhost")
FILES = "files"
TEXT, PICTURE, PAINTING = "Text", "Picture", "Painting"
PAINTER = "branch"
METHODS = [("Painter", PAINTER), ("Brush strokes", "brush")]
BEGINS = {
    "load": 0.0, "embed": 0.02, "read": 0.04, "cameras": 0.06, "encode": 0.3, "fit": 0.32,
    "render": 0.8, "restyle": 0.83, "write": 0.92,
}  # fmt: skip
"""The stages of a stylization, and how much of the whole is done as each begins."""


def build(maker: Maker) -> gr.Blocks:
    """The page on which a maker is asked for scenes."""
    known = examples()
    paintings = [name for name, example in known.items() if Path(example.file).suffix]
    scenes = [("Files", FILES), *((f"Example: {name}", PREFIX + name) for name in known if name not in paintings)]

    def run(
        scene: str, files: list[str] | None, kind: str, text: str, picture: str | None, painting: str,
        strength: float, method: str, request: gr.Request, progress: gr.Progress = gr.Progress(),  # noqa: B008
    ) -> tuple[Any, ...]:  # fmt: skip
        """Make a scene; what is said of it, how it is shown, and the list of all."""
        bar = 0.0

        def report(stage: str, state: Progress) -> None:
            nonlocal bar
            bar = max(bar, _fraction(stage, state.done or 0))
            progress(bar, desc=f"{stage} {state.line}")

        with maker.working() as warnings:  # until an error has let go of its tensors
            try:
                inputs, style = (files or []) if scene == FILES else [scene], _style(kind, text, picture, painting)
                how: dict[str, Any] = {"strength": strength, "method": method}
                folder = maker.make(inputs, style, **how, report=report, session=request.session_hash)
            except Exception as error:
                line = _line(error)
                for path in [*(files or []), *([picture] if picture else [])]:  # Gradio's own folders do not matter
                    line = line.replace(path, Path(path).name)
                return said(warnings, line), gr.skip(), gr.skip()
        return said(warnings), shown(folder), gr.Dropdown(maker.made(), value=folder.name)

    def begin(request: gr.Request) -> tuple[str, gr.Button, gr.Button]:
        maker.unwanted.discard(request.session_hash)
        return "", gr.Button(interactive=False), gr.Button("Stop", interactive=True, visible=True)

    def stop_it(request: gr.Request) -> gr.Button:
        maker.unwanted.add(request.session_hash)
        return gr.Button("Stopping …", interactive=False)

    def show_again(name: str) -> tuple[str, str]:
        gone = said([], f"{name} is not there any more")
        return ("", shown(maker.out / name)) if name in maker.made() else (gone, EMPTY)

    def choose(event: gr.SelectData) -> tuple[str, gr.Gallery]:
        name = paintings[event.index]
        return PREFIX + name, gr.Gallery(label=known[name].title)

    with gr.Blocks(title="anystyle", analytics_enabled=False, fill_width=True) as page:
        with gr.Row():
            with gr.Column(scale=2, min_width=320):
                scene = gr.Radio(scenes, value=FILES, label="Scene")
                files = gr.File(label="Photographs, a video or a splat", file_count="multiple", height=150)
                kind = gr.Radio([TEXT, PICTURE, PAINTING], value=TEXT, label="Style")
                text = gr.Textbox(label="What it looks like", placeholder="charcoal drawing", max_length=2000)
                picture = gr.Image(
                    label=PICTURE, type="filepath", image_mode=None, sources=["upload"], height=240, visible=False
                )
                gallery = gr.Gallery(
                    [(str(resolved(Path(PREFIX + name))), known[name].title) for name in paintings],
                    label=known[paintings[0]].title, columns=3, object_fit="cover", allow_preview=False, buttons=[],
                    selected_index=0, interactive=False, visible=False, elem_classes="paintings",
                )  # fmt: skip
                painting = gr.State(PREFIX + paintings[0])
                strength = gr.Slider(0, 1, value=1, step=0.05, label="Strength")
                method = gr.Radio(METHODS, value=PAINTER, label="Made with")
                start = gr.Button("Make the scene", variant="primary")
                stop = gr.Button("Stop", visible=False)
                before = gr.Dropdown(maker.made(), value=None, label="Made before")
            with gr.Column(scale=5, min_width=480):
                lines = gr.HTML(elem_classes="messages")
                result = gr.HTML(EMPTY)

        quick: Any = {"api_visibility": "private", "show_progress": "hidden"}
        page.load(lambda: gr.Dropdown(maker.made()), None, before, **quick)
        scene.change(lambda scene: gr.File(visible=scene == FILES), scene, files, **quick)
        styles = {TEXT: text, PICTURE: picture, PAINTING: gallery}
        kind.change(lambda kind: [gr.update(visible=kind == one) for one in styles], kind, [*styles.values()], **quick)
        method.change(lambda method: gr.Slider(value=1, visible=method == PAINTER), method, strength, **quick)
        gallery.select(choose, None, [painting, gallery], **quick)
        before.input(show_again, before, [lines, result], **quick)
        stop.click(stop_it, None, stop, **quick)
        begun = gr.on([start.click, text.submit], begin, None, [lines, start, stop], **quick)
        given = [scene, files, kind, text, picture, painting, strength, method]
        ended = begun.then(
            run, given, [lines, result, before],
            show_progress_on=result, concurrency_limit=1, api_visibility="private",
        )  # fmt: skip
        ended.then(lambda: (gr.Button(interactive=True), gr.Button(visible=False)), None, [start, stop], **quick)
    return page


def launch(page: gr.Blocks, maker: Maker, host: str, port: int | None, *, share: bool = False) -> str:
    """Serve the page, and the maker's scenes, in a thread; answers with its address."""

    def file(request: Request) -> Response:
        name, wanted = request.path_params["name"], request.path_params["file"]
        files = files_of(maker.out / name).values() if name in maker.made() else ()
        for path in files:
            if path.name == wanted:
                return FileResponse(path, filename=f"{name}{path.suffix}", content_disposition_type="inline")
        return Response("there is no such file", 404)

    middleware = []
    if host in LOOPBACK and not share:  # no page under another name that leads to this machine may ask
        middleware.append(Middleware(TrustedHostMiddleware, allowed_hosts=[*LOOPBACK]))
    theme = Default(primary_hue="blue", font=FONT, font_mono=MONO)
    _, local, public = page.launch(
        server_name=host, server_port=port, share=share, theme=theme, css_paths=CSS, footer_links=[],
        app_kwargs={"routes": [Route("/made/{name}/{file}", file)], "middleware": middleware},
        ssr_mode=False, prevent_thread_lock=True, quiet=True,
    )  # fmt: skip
    return public or local


def _fraction(stage: str, done: float) -> float:
    """How much of the whole is done where this fraction of a stage is."""
    names, begins = [*BEGINS], [*BEGINS.values(), 1.0]
    number = names.index(stage)
    return begins[number] + done * (begins[number + 1] - begins[number])


def _style(kind: str, text: str, picture: str | None, painting: str) -> str | Path:
    """The style that is chosen."""
    if kind == PICTURE and picture is None:
        raise UserError("no picture is given; add one, or choose a text or a painting")
    return text if kind == TEXT else Path(painting if kind == PAINTING else str(picture))


def _line(error: Exception) -> str:
    """Why a scene could not be made; of a bug, the traceback is printed."""
    if (line := message(error)) is None:
        traceback.print_exception(error)
        return f"a bug, whose traceback the terminal shows: {type(error).__name__}: {one_line(error)}"
    return line
