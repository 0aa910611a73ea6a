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
from anystyle_film.projection import Projection

_CONTAINERS = (b"moov", b"trak", b"mdia", b"minf", b"stbl")
QUALITY = 92


def mark_video(path: Path, projection: Projection) -> None:
    """Write what its frames show into a film of :func:`~anystyle.io.video.write_video`, which ends with its index."""
    with path.open("r+b") as file:
        start = _index_of(file)
        index = file.read()
        file.seek(start)
        file.write(_with_boxes(index, spherical_boxes(projection)))


def spherical_boxes(projection: Projection) -> bytes:
    """The boxes of a projection; none for an ordinary picture."""
    boxes = b""
    if projection.stereo or projection.degrees:
        boxes += _full_box(b"st3d", struct.pack(">B", 2 if projection.stereo else 0))
    if projection.degrees:
        cut = round((1 - projection.degrees / 360) / 2 * (1 << 32))  # of the sphere, left and right: parts of 2**32
        angles, bounds = struct.pack(">iii", 0, 0, 0), struct.pack(">IIII", 0, 0, cut, cut)
        shape = _box(b"proj", _full_box(b"prhd", angles) + _full_box(b"equi", bounds))
        boxes += _box(b"sv3d", _full_box(b"svhd", b"anystyle\0") + shape)
    return boxes


def save_still(image: Image.Image, path: Path, projection: Projection) -> None:
    """Write a frame as JPEG that says whether it is a panorama."""
    options = {"xmp": _gpano(image.size)} if projection.degrees == 360 and not projection.stereo else {}
    with atomic_path(path) as temporary:
        image.save(temporary, "JPEG", quality=QUALITY, subsampling=0, **options)


def _gpano(size: tuple[int, int]) -> bytes:
    width, height = size
    fields = {"ProjectionType": "equirectangular", "UsePanoramaViewer": "True"}
    fields |= {"FullPanoWidthPixels": width, "FullPanoHeightPixels": height}
    fields |= {"CroppedAreaImageWidthPixels": width, "CroppedAreaImageHeightPixels": height}
    fields |= {"CroppedAreaLeftPixels": 0, "CroppedAreaTopPixels": 0}
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


def _index_of(file: BinaryIO) -> int:
    """The position of a file's index, which is read next."""
    start = 0
    while (header := struct.unpack(">I4s", file.read(8)))[1] != b"moov":
        start += struct.unpack(">Q", file.read(8))[0] if header[0] == 1 else header[0]
        file.seek(start)
    return file.seek(start)


def _with_boxes(box: bytes, added: bytes) -> bytes:
    """A box of an index with others added to the sample entry of its one track."""
    name, content = box[4:8], box[8:]
    if name in _CONTAINERS:
        return _box(name, b"".join(_with_boxes(part, added) for part in _parts(content)))
    if name == b"stsd":
        return _box(name, content[:8] + _box(content[12:16], content[16:] + added))
    return box


def _parts(content: bytes) -> Iterator[bytes]:
    while content:
        size = struct.unpack(">I", content[:4])[0]
        yield content[:size]
        content = content[size:]
