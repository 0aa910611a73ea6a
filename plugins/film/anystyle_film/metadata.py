"""What players and viewers look for in files: boxes of Spherical Video V2 in MP4, GPano in pictures.

The boxes ``st3d`` and ``sv3d`` are those of Google's Spherical Video V2 (RFC, 2016), in the entry of the video's sample
description. GPano is Google's Photo Sphere XMP.
"""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from PIL import Image

from anystyle.io.atomic import atomic_path
from anystyle_film.projection import Layout

_CONTAINERS = (b"moov", b"trak", b"mdia", b"minf", b"stbl")
_VISUAL_ENTRY = 78
"""Bytes of a visual sample entry before its boxes, without its own header."""
_GENERATOR = b"anystyle\0"
QUALITY = 92


def mark_video(path: Path, layout: Layout) -> None:
    """Write the layout of its frames into a finished MP4 file; an ordinary one stays as it is."""
    added = spherical_boxes(layout)
    if not added:
        return
    with atomic_path(path) as temporary, path.open("rb") as source, temporary.open("wb") as target:
        spans = list(_spans(source))
        moov = next(span for span in spans if span[0] == b"moov")
        media_follows = any(name == b"mdat" and start > moov[1] for name, start, _ in spans)
        for name, start, size in spans:
            source.seek(start)
            if name == b"moov":
                target.write(_with_entry_boxes(source.read(size), added, len(added) if media_follows else 0))
            else:
                _copy(source, target, size)


def spherical_boxes(layout: Layout) -> bytes:
    """The boxes of a layout; none for an ordinary picture."""
    boxes = b""
    if layout.stereo or layout.degrees:
        boxes += _full_box(b"st3d", struct.pack(">B", 2 if layout.stereo else 0))
    if layout.degrees:
        cut = round((1 - layout.degrees / 360) / 2 * (1 << 32))  # of the sphere, left and right: parts of 2**32
        projection = _box(
            b"proj",
            _full_box(b"prhd", struct.pack(">iii", 0, 0, 0)) + _full_box(b"equi", struct.pack(">IIII", 0, 0, cut, cut)),
        )
        boxes += _box(b"sv3d", _full_box(b"svhd", _GENERATOR) + projection)
    return boxes


def save_still(image: Image.Image, path: Path, layout: Layout) -> None:
    """Write a frame as JPEG that says whether it is a panorama."""
    options = {"xmp": _gpano(image.size)} if layout.degrees == 360 and not layout.stereo else {}
    with atomic_path(path) as temporary:
        image.save(temporary, "JPEG", quality=QUALITY, subsampling=0, **options)


def _gpano(size: tuple[int, int]) -> bytes:
    width, height = size
    sizes = {"FullPanoWidthPixels": width, "FullPanoHeightPixels": height}
    sizes |= {"CroppedAreaImageWidthPixels": width, "CroppedAreaImageHeightPixels": height}
    sizes |= {"CroppedAreaLeftPixels": 0, "CroppedAreaTopPixels": 0}
    fields = {"ProjectionType": "equirectangular", "UsePanoramaViewer": "True", **sizes}
    attributes = " ".join(f'GPano:{name}="{value}"' for name, value in fields.items())
    return (
        '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?><x:xmpmeta xmlns:x="adobe:ns:meta/">'
        '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description rdf:about="" '
        f'xmlns:GPano="http://ns.google.com/photos/1.0/panorama/" {attributes}/></rdf:RDF></x:xmpmeta>'
        '<?xpacket end="w"?>'
    ).encode()


def _box(name: bytes, content: bytes) -> bytes:
    return struct.pack(">I", 8 + len(content)) + name + content


def _full_box(name: bytes, content: bytes) -> bytes:
    return _box(name, bytes(4) + content)


def _spans(file: BinaryIO) -> Iterator[tuple[bytes, int, int]]:
    """Name, position and size of each box of a file; sizes of 64 bits, and that of the rest of the file, included."""
    end = file.seek(0, 2)
    start = 0
    while start + 8 <= end:
        file.seek(start)
        size, name = struct.unpack(">I4s", file.read(8))
        if size == 1:
            (size,) = struct.unpack(">Q", file.read(8))
        size = size or end - start
        yield name, start, size
        start += size


def _with_entry_boxes(box: bytes, added: bytes, moved: int) -> bytes:
    """A box with others added to all visual sample entries in it, and chunks counted as ``moved`` bytes further on."""
    name, content = box[4:8], box[8:]
    if name in _CONTAINERS:
        return _box(name, b"".join(_with_entry_boxes(part, added, moved) for part in _parts(content)))
    if name == b"stsd":
        entries = [_box(part[4:8], part[8:] + added) if _is_visual(part) else part for part in _parts(content[8:])]
        return _box(name, content[:8] + b"".join(entries))
    if name in (b"stco", b"co64") and moved:
        kind = "I" if name == b"stco" else "Q"
        count = struct.unpack(">I", content[4:8])[0]
        offsets = struct.unpack(f">{count}{kind}", content[8:])
        return _box(name, content[:8] + struct.pack(f">{count}{kind}", *(offset + moved for offset in offsets)))
    return box


def _is_visual(entry: bytes) -> bool:
    return entry[4:8] in (b"avc1", b"avc3", b"hvc1", b"hev1", b"av01", b"mp4v") and len(entry) >= 8 + _VISUAL_ENTRY


def _parts(content: bytes) -> Iterator[bytes]:
    start = 0
    while start + 8 <= len(content):
        size = struct.unpack(">I", content[start : start + 4])[0]
        yield content[start : start + size]
        start += size


def _copy(source: BinaryIO, target: BinaryIO, size: int) -> None:
    while size:
        block = source.read(min(size, 1 << 20))
        if not block:
            return
        target.write(block)
        size -= len(block)
