"""Pictures that browsers give: limited in size, decoded as any file from outside, kept as PNG."""

import hashlib
import tempfile
from pathlib import Path

from anystyle.data.images import open_image
from anystyle.errors import one_line

LARGEST = 32 * 1024 * 1024
"""Bytes of a picture."""
LONGEST = 2048
"""Pixels of the longer side; larger pictures are reduced to less than twice of it."""


def keep_picture(folder: Path, name: str, content: bytes) -> Path:
    """Keep a picture under its name and the beginning of its digest.

    Args:
        folder: Where to; it is made.
        name: As the browser says it.
        content: The file.

    Raises:
        ValueError: It is too large, or none.
    """
    if len(content) > LARGEST:
        raise ValueError(f"a picture of {len(content):,} bytes; at most {LARGEST:,} are taken")
    stem = "".join(letter if letter.isalnum() else "-" for letter in Path(name).stem)[:40] or "picture"
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=folder, prefix=".given-") as file:
        file.write(content)
        file.flush()
        try:
            picture = open_image(Path(file.name), longest=LONGEST)
        except (ValueError, OSError) as error:
            raise ValueError(one_line(error).replace(file.name, f"the picture {stem}")) from None
    target = folder / f"{stem}-{hashlib.sha256(content).hexdigest()[:8]}.png"
    picture.save(target)
    return target
