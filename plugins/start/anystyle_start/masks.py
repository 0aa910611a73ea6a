"""Masks of a scene's photographs, drawn on the page or given as files: white counts, black does not."""

import shutil
from pathlib import Path

from PIL import Image

from anystyle.data import images
from anystyle.data.photo_masks import read_mask
from anystyle.errors import UserError
from anystyle.examples import resolved
from anystyle.io.atomic import atomic_path
from anystyle_start.library import ACTIVE, Library
from anystyle_start.uploads import stem_of

SHOWN = 1024
"""The longer side in pixels of a photograph that is drawn on, and so of its mask."""


class Masks:
    """Keeps them in the folder that ``--photo-masks`` takes, each under its photograph's name and ``.png``."""

    def __init__(self, library: Library) -> None:
        self.library = library

    def photographs(self, scene: str) -> dict[str, Path]:
        """The photographs of a scene by name; a film and a splat have none."""
        record = self.library[scene]
        if record.kind == "example":
            return {path.name: path for path in sorted(resolved(Path(record.source)).glob("*.jpg"))}
        return {path.name: path for path in self.library.inputs(scene)} if record.kind == "photographs" else {}

    def of(self, scene: str) -> dict[str, int]:
        """The photographs that have a mask, and when it was drawn, in nanoseconds."""
        masks = {path.name.removesuffix(".png"): path for path in self.library.masks(scene).glob("[!.]*.png")}
        return {name: masks[name].stat().st_mtime_ns for name in self.photographs(scene) if name in masks}

    def keep(self, scene: str, name: str, content: bytes) -> str:
        """Store a mask, or delete it where all of it is white. Returns the photograph whose mask it is.

        ``name`` is the photograph's, or that of a file: ``a.png`` or ``a.jpg.png`` for ``a.jpg``.
        """
        self._refuse_while_made(scene)
        photograph = self._named(scene, name)
        target = self.library.masks(scene) / f"{photograph.name}.png"
        given = target.with_name(f".{target.name}.given")
        given.parent.mkdir(exist_ok=True)
        try:
            given.write_bytes(content)
            width, height = images.image_size(photograph)
            mask = read_mask(given, photograph, (height, width))
            if mask.getextrema() == (255, 255):
                target.unlink(missing_ok=True)
            else:
                with atomic_path(target) as path:
                    mask.save(path, "PNG")
        except UserError as error:
            raise UserError(str(error).replace(str(given), name[:80])) from None
        finally:
            given.unlink(missing_ok=True)
        return photograph.name

    def _named(self, scene: str, name: str) -> Path:
        photographs = self.photographs(scene)
        if name in photographs:
            return photographs[name]
        stems = {path.stem.casefold(): path for path in photographs.values()}
        for stem in (stem_of(name), stem_of(Path(name).stem)):
            if stem.casefold() in stems:
                return stems[stem.casefold()]
        raise UserError(f"{name[:80]} is named like none of the photographs; a mask of a.jpg is a.png or a.jpg.png")

    def _refuse_while_made(self, scene: str) -> None:
        if self.library[scene].job.state in ACTIVE:
            raise UserError("the scene is being made; cancel that to change masks")

    def clear(self, scene: str) -> None:
        """Delete all masks."""
        self._refuse_while_made(scene)
        shutil.rmtree(self.library.masks(scene), ignore_errors=True)

    def forget(self, scene: str, name: str) -> None:
        """Delete the mask of a photograph that goes."""
        self._refuse_while_made(scene)
        if name in self.photographs(scene):
            (self.library.masks(scene) / f"{name}.png").unlink(missing_ok=True)
            self._shown(scene, name).unlink(missing_ok=True)

    def shown(self, scene: str, name: str) -> Path | None:
        """A photograph as it is drawn on."""
        photograph = self.photographs(scene).get(name)
        if photograph is None:
            return None
        target = self._shown(scene, name)
        if not target.is_file():
            target.parent.mkdir(exist_ok=True)
            picture = images.open_image(photograph, longest=SHOWN)
            picture.thumbnail((SHOWN, SHOWN), Image.Resampling.LANCZOS)
            with atomic_path(target) as path:
                picture.save(path, "JPEG", quality=88)
        return target

    def _shown(self, scene: str, name: str) -> Path:
        return self.library.path(scene) / "shown" / f"{name}.jpg"
