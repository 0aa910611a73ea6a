"""Notebooks: the text that is edited (``notebooks/*.py``) and what a forge shows (``notebooks/*.ipynb``, with outputs).

``python tests/support/notebooks.py [NAME ...]`` runs notebooks and writes their outputs. After a change of text only,
``jupytext --to ipynb --update notebooks/NAME.py`` keeps them.
"""

import argparse
import base64
import io
import os
import re
import sys
import tempfile
from pathlib import Path

import jupytext
import nbformat
from PIL import Image, ImageOps, ImageSequence

FOLDER = Path(__file__).parents[2] / "notebooks"
NAMES = [path.stem for path in sorted(FOLDER.glob("*.py"))]
WIDTH = 720
"""Pictures are no wider than this in a file."""


def text(name: str) -> nbformat.NotebookNode:
    """The notebook without outputs."""
    return jupytext.read(FOLDER / f"{name}.py")


def stored(name: str) -> nbformat.NotebookNode:
    """The notebook with its outputs."""
    return nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)


def execute(name: str, folder: Path) -> nbformat.NotebookNode:
    """Run a notebook from top to bottom in a folder."""
    from nbclient import NotebookClient

    notebook = text(name)
    options = {"timeout": 1800, "kernel_name": "python3", "coalesce_streams": True}
    NotebookClient(notebook, resources={"metadata": {"path": folder}}, **options).execute()
    for output in (output for cell in notebook.cells for output in cell.get("outputs", [])):
        small(output)
    return notebook


def write(name: str, notebook: nbformat.NotebookNode) -> None:
    """Store a notebook without what changes from run to run."""
    notebook.metadata = {"kernelspec": notebook.metadata["kernelspec"], "jupytext": {"formats": "ipynb,py:percent"}}
    for number, cell in enumerate(notebook.cells):
        cell.id, cell.metadata = f"cell-{number}", {}
    nbformat.write(notebook, FOLDER / f"{name}.ipynb")


def small(output: nbformat.NotebookNode) -> None:
    """Make the picture of an output a JPEG or, if it moves, a GIF of few frames and colours; text loses its colours."""
    data = output.get("data", {})
    if "text" in output:
        output["text"] = re.sub(r"\x1b\[[\d;]*m", "", output["text"])
    for kind in ("image/png", "image/gif"):
        if kind not in data:
            continue
        picture, file = Image.open(io.BytesIO(base64.b64decode(data.pop(kind)))), io.BytesIO()
        if kind == "image/gif":
            frames = [frame.convert("RGB") for frame in ImageSequence.Iterator(picture)][::4]
            frames = [ImageOps.contain(frame, (144, 144)).quantize(32, dither=Image.Dither.NONE) for frame in frames]
            frames[0].save(file, "GIF", save_all=True, append_images=frames[1:], duration=240, loop=0)
        else:
            kind = "image/jpeg"
            picture = picture.convert("RGB")
            picture.thumbnail((WIDTH, 4 * WIDTH))
            picture.save(file, "JPEG", quality=80, optimize=True)
        data[kind] = base64.b64encode(file.getvalue()).decode() + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=NAMES)
    os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    for name in parser.parse_args().names:
        with tempfile.TemporaryDirectory() as folder:
            write(name, execute(name, Path(folder)))


if __name__ == "__main__":
    main()
