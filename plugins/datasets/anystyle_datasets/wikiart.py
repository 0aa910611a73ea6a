"""WikiArt: paintings in folders of their movements, with a description each."""

import logging
from collections.abc import Collection, Sequence
from itertools import islice
from pathlib import Path
from typing import Literal

from PIL import Image

from anystyle.data.captions import read_captions
from anystyle.data.images import SUFFIXES, readable
from anystyle.data.stored import StoredStyle, StoredStyles
from anystyle.errors import UserError, listing
from anystyle.io.documents import read_text
from anystyle.ranges import AtLeastOne, Count

logger = logging.getLogger(__name__)

DESCRIPTIONS = "wikiarts_descriptions.txt"
TEST_FILES = "wikiarts_test_files.txt"
PAINTINGS = frozenset({".jpg", ".jpeg", ".png"})


class WikiArtStyles(StoredStyles):
    """Paintings below a folder, as the published training reads them.

    A description is a line ``Movement/painter_title.jpg;free text``; a painting without one is described by its
    folder's name. Descriptions of paintings that are not there become styles of text only. Files that are not pictures
    are left out; one that turns out to be damaged when it is decoded raises, and a training draws another and lists it.

    Args:
        root: A folder, walked to any depth for jpg, jpeg and png files.
        descriptions: A file; ``None`` takes ``wikiarts_descriptions.txt`` in ``root`` where there is one.
        test_files: A file with one path below ``root`` a line; ``None`` takes ``wikiarts_test_files.txt`` in ``root``
            where there is one.
        exclude: Other files of that kind, for other test sets whose paintings no split has. A line without a folder
            is a file name, wherever it lies. :func:`~anystyle_datasets.duplicates.same_pictures` finds them.
        files: A file of that kind with the paintings to take; ``None`` takes all.
        split: ``train`` leaves the listed paintings out, ``test`` takes only them, ``all`` takes both.
        text_only: So many descriptions, from the first, are searched for styles without an image, as published; these
            follow the paintings.
        size: Height and width in pixels.
        crop: Which square of a painting is taken: the ``centre``, or a ``random`` one at every reading, as published.
    """

    def __init__(
        self,
        *,
        root: str = "wikiart",
        descriptions: str | None = None,
        test_files: str | None = None,
        exclude: Sequence[str] = (),
        files: str | None = None,
        split: Literal["train", "test", "all"] = "train",
        text_only: Count = 15000,
        size: AtLeastOne = 256,
        crop: Literal["centre", "random"] = "centre",
    ) -> None:
        self.crop = crop
        self.root = Path(root)
        if not self.root.is_dir():
            raise UserError(f"root={root}: there is no such folder of paintings")
        self.size = size
        path = self.root / DESCRIPTIONS if descriptions is None else Path(descriptions)
        self.descriptions: dict[str, str] = {}
        if descriptions is None and not path.is_file():
            logger.warning("%s is not there: paintings are described by their folders", path)
        else:
            self.descriptions = {name: text for name, text in read_captions(path).items() if text}
        path = self.root / TEST_FILES if test_files is None else Path(test_files)
        listed = frozenset(read_list(path) if test_files is not None or path.is_file() else ())
        held = frozenset().union(*(read_list(Path(name), "exclude") for name in exclude))
        if split == "test" and not listed:
            raise UserError(f"split=test needs a list of paintings; {self.root / TEST_FILES} is not there or empty")
        names = sorted(path.relative_to(self.root).as_posix() for path in pictures_below(self.root, PAINTINGS))
        chosen = [name for name in names if split == "all" or (name in listed) == (split == "test")]
        if files is not None:
            allowed = frozenset(read_list(Path(files), "files"))
            kept = sorted(name for name in allowed if _named(name, held) or (name in listed and split == "train"))
            if kept:
                raise UserError(
                    f"files={files} and the test lists have {len(kept)} paintings in common: {listing(kept, 5)}; take "
                    f"them out of files"
                )
            chosen = [name for name in chosen if name in allowed]
        chosen = [name for name in chosen if not _named(name, held)]
        self.paths = readable([self.root / name for name in chosen])
        if not self.paths:
            raise UserError(f"root={root}: there are no paintings for split={split} in it")
        first = islice(self.descriptions, text_only if split != "test" else 0)
        present = {*names, *listed}
        self.texts = tuple(name for name in first if name not in present and not _named(name, held))

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        (folder / "Op_Art").mkdir()
        for name in ("a.png", "b.jpg"):
            Image.linear_gradient("L").resize((40, 30)).save(folder / "Op_Art" / name)
        (folder / DESCRIPTIONS).write_text("Op_Art/a.png;from black to white\nOp_Art/c.png;a grid of dots\n")
        return {"root": str(folder), "size": 16}

    def __len__(self) -> int:
        return len(self.paths) + len(self.texts)

    def stored(self, style: int) -> StoredStyle:
        if style >= len(self.paths):
            name = self.texts[style - len(self.paths)]
            return StoredStyle(None, self.descriptions[name], Path(name).stem)
        path = self.paths[style]
        text = self.descriptions.get(path.relative_to(self.root).as_posix()) or path.parent.name.replace("_", " ")
        return StoredStyle(path, text, path.stem)


def pictures_below(root: Path, suffixes: Collection[str] = SUFFIXES) -> list[Path]:
    """The pictures of a folder at any depth, in order."""
    return sorted(path for path in root.rglob("*") if path.suffix.lower() in suffixes and path.is_file())


def read_list(path: Path, option: str = "test_files") -> list[str]:
    """The lines of a list of paintings, which an option names."""
    lines = read_text(path, what=f"list of paintings ({option})").splitlines()
    return [line.strip().replace("\\", "/") for line in lines if line.strip()]


def _named(painting: str, held: frozenset[str]) -> bool:
    return painting in held or painting.rpartition("/")[2] in held
