"""A folder of style images with captions."""

import logging
from pathlib import Path
from typing import Literal

from PIL import Image

from anystyle.data.captions import captions_file, read_captions
from anystyle.data.folder import visible
from anystyle.data.images import SUFFIXES, readable
from anystyle.data.stored import StoredStyle, StoredStyles
from anystyle.errors import UserError, listing
from anystyle.ranges import AtLeastOne

logger = logging.getLogger(__name__)


class FolderStyles(StoredStyles):
    """The images of a folder in natural order, cut to squares, with captions where there are some.

    Captions are lines ``{"image": "a.jpg", "text": "..."}`` of a JSON Lines file, or lines ``a.jpg;...`` of a text
    file. An image without a caption has an empty one.

    Args:
        root: A folder.
        size: Height and width in pixels.
        captions: A file in ``root``; ``None`` takes :func:`~anystyle.data.captions.captions_file`, if there is one.
        crop: Which square of an image is taken: the ``centre``, or a ``random`` one at every reading.
    """

    def __init__(
        self,
        *,
        root: str = "styles",
        size: AtLeastOne = 256,
        captions: str | None = None,
        crop: Literal["centre", "random"] = "centre",
    ) -> None:
        folder = Path(root)
        if not folder.is_dir():
            raise UserError(f"root={root}: there is no such folder of style images")
        self.paths = readable(visible(folder, SUFFIXES))
        if not self.paths:
            raise UserError(f"root={root}: there are no images in it")
        self.size, self.crop = size, crop
        file = captions_file(folder) if captions is None else folder / captions
        self.captions = read_captions(file) if file else {}
        if lost := sorted(self.captions.keys() - {path.name for path in self.paths}):
            logger.warning("%d captions of %s have no image: %s", len(lost), file, listing(lost))

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        for name in ("a.png", "b.jpg"):
            Image.linear_gradient("L").resize((40, 30)).save(folder / name)
        (folder / "captions.jsonl").write_text('{"image": "a.png", "text": "from black to white"}\n')
        return {"root": str(folder), "size": 16}

    def __len__(self) -> int:
        return len(self.paths)

    def stored(self, style: int) -> StoredStyle:
        path = self.paths[style]
        return StoredStyle(path, self.captions.get(path.name, ""), path.stem)
