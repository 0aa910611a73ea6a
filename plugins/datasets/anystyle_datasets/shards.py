"""Samples in shards: tar files of WebDataset's layout, with an index of the bytes in them.

A folder of shards, on a disk or in object storage, holds ``000000.tar`` and so on, ``index.json``, a
:class:`ShardIndex`, and ``index.npy``, a row of :data:`ROW` for each sample. A sample is the members
``GROUP/NUMBER.json``, what is known of it, and ``GROUP/NUMBER.SUFFIX``, its picture as it was, where it has one; its
group is a scene, or a style alone. The bytes of a sample are in one piece, so that any of them is one request of a
range, and WebDataset reads all of them in order.
"""

import io
import time
import zlib
from typing import Any, Literal, TypeVar

import msgspec
import numpy as np
from fsspec.core import url_to_fs
from numpy.typing import NDArray

from anystyle.errors import UserError, one_line
from anystyle.io.documents import parse_json

T = TypeVar("T", bound=msgspec.Struct)
Kind = Literal["scenes", "styles"]
VERSION = 1
INDEX, ROWS = "index.json", "index.npy"
ROW = np.dtype({
    "names": ["group", "shard", "start", "length", "text", "picture", "crc", "width", "height"],
    "formats": ["<u4", "<u4", "<u8", "<u4", "<u4", "<u4", "<u4", "<u4", "<u4"],
})  # fmt: skip
"""Where a sample lies: ``length`` bytes from ``start`` of a shard, whose CRC-32 is ``crc``; the first ``text`` of them
are its JSON, those from ``picture`` on its picture, of so many pixels upright. ``picture`` is 0 where there is none."""
PAUSES = (0, 1, 4)
"""Seconds before each request of the same bytes; then storage is taken to be out of reach."""


class ShardIndex(msgspec.Struct):
    """The content of ``index.json``."""

    kind: Kind
    names: list[str]
    """Of the groups."""
    options: dict[str, Any]
    """Those of the source that was packed, which a reader takes where it is given none."""
    megabytes: int
    """After which a shard is closed."""
    shards: list[int] = []
    """The bytes of each."""
    crc: int = 0
    """The CRC-32 of ``index.npy``."""
    version: int = VERSION


class SceneSample(msgspec.Struct, omit_defaults=True):
    """What is known of a sample of a scene; the camera is as in :class:`anystyle.contracts.StoredCamera`."""

    name: str
    world_from_camera: list[list[float]] | None = None
    intrinsics: list[list[float]] | None = None
    size: tuple[int, int] | None = None


class StyleSample(msgspec.Struct):
    """What is known of a style."""

    name: str
    text: str


def shard_name(number: int) -> str:
    """The file name of a shard."""
    return f"{number:06d}.tar"


class Shards:
    """A folder of shards at a path, or at an address that fsspec knows, such as ``s3://bucket/folder``.

    Raises:
        UserError: There is no complete folder of shards of this kind, or a shard is missing or cut off.
    """

    def __init__(self, root: str, kind: Kind | None = None) -> None:
        self.root = root.rstrip("/")
        where = f"{self.root}/{INDEX}"
        self.index: ShardIndex = parse_json(self._whole(INDEX), ShardIndex, source=where, what="index of shards")
        if self.index.version != VERSION or kind not in (None, self.index.kind):
            found = f"shards of {self.index.kind}, version {self.index.version}"
            raise UserError(f"{where} is of {found}; {kind or 'shards'} of version {VERSION} are expected")
        self.rows = self._rows(self._whole(ROWS))
        self._first = np.searchsorted(self.rows["group"], np.arange(len(self.index.names) + 1))
        self._check_sizes()

    def name(self, group: int) -> str:
        """The name of a group."""
        if not 0 <= group < len(self.index.names):
            raise UserError(f"{self.index.kind[:-1]} {group}: there are {len(self.index.names)}, counted from 0")
        return self.index.names[group]

    def group(self, group: int) -> NDArray[np.void]:
        """The rows of a group."""
        self.name(group)
        return self.rows[self._first[group] : self._first[group + 1]]

    def read(self, rows: NDArray[np.void], shape: type[T]) -> list[tuple[T, bytes | None]]:
        """Samples by their rows, in one batch of requests: what is known of each, as a ``shape``, and its picture.

        Raises:
            UserError: Bytes cannot be read, or are not those that were written.
        """
        samples = []
        for row, content in zip(rows, self._ranges(rows), strict=True):
            if len(content) > row["length"]:
                raise UserError(f"{self.place(row)}: {len(content)} bytes came; the server has to answer ranges")
            if zlib.crc32(content) != row["crc"]:
                raise UserError(f"{self.place(row)}: the shard is damaged; copy it again, or write it again")
            about: T = parse_json(content[: row["text"]], shape, source=self.place(row))
            samples.append((about, content[row["picture"] :] if row["picture"] else None))
        return samples

    def place(self, row: np.void) -> str:
        """Where a sample lies, for messages."""
        where = f"{self.root}/{shard_name(row['shard'])}, {row['length']} bytes from {row['start']}"
        return f"{where} ({self.name(row['group'])})"

    def _storage(self) -> tuple[Any, str]:
        """The file system and the path in it; looked up each time, for its connections do not outlive a fork."""
        try:
            return url_to_fs(self.root)
        except ImportError as error:
            raise ImportError(f'{self.root}: {error}; pip install "anystyle[shards]" brings that of s3://') from None
        except ValueError as error:
            raise UserError(f"{self.root}: {one_line(error)}") from None

    def _whole(self, name: str) -> bytes:
        fs, path = self._storage()
        try:
            return fs.cat_file(f"{path}/{name}")
        except FileNotFoundError:
            raise UserError(f"there is no {self.root}/{name}; `anystyle data shard` writes it when it ends") from None
        except Exception as error:  # each client of storage has errors of its own
            raise UserError(f"{self.root}/{name} cannot be read ({_reason(error)})") from error

    def _rows(self, content: bytes) -> NDArray[np.void]:
        """The rows, which must be those that the index was written with, and lie in the shards."""
        rows: NDArray[Any] = np.empty(0)
        if zlib.crc32(content) == self.index.crc:
            rows = np.load(io.BytesIO(content), allow_pickle=False)
        sizes = np.array([*self.index.shards, 0], dtype=np.uint64)
        if (
            rows.dtype != ROW
            or (rows["group"] >= len(self.index.names)).any()
            or (rows["start"] + rows["length"] > sizes[np.minimum(rows["shard"], len(sizes) - 1)]).any()
        ):
            raise UserError(f"{self.root}/{ROWS} does not belong to {INDEX}; copy both again")
        return rows

    def _check_sizes(self) -> None:
        """Whether all shards are there, whole."""
        fs, path = self._storage()
        names = [shard_name(number) for number in range(len(self.index.shards))]
        try:
            sizes = fs.sizes([f"{path}/{name}" for name in names])
        except Exception as error:  # each client of storage has errors of its own
            raise UserError(f"{self.root}: a shard is not there, or out of reach ({_reason(error)})") from error
        for name, size, expected in zip(names, sizes, self.index.shards, strict=True):
            if size is not None and size != expected:  # some servers do not tell
                raise UserError(f"{self.root}/{name} has {size:,} bytes of {expected:,}; copy it again")

    def _ranges(self, rows: NDArray[np.void]) -> list[bytes]:
        """The bytes of rows; what fails is asked for again, for storage may be busy, but not what is not there."""
        fs, path = self._storage()
        paths = [f"{path}/{shard_name(number)}" for number in rows["shard"]]
        starts, stops = rows["start"].tolist(), (rows["start"] + rows["length"]).tolist()
        found: list[Any] = [None] * len(rows)
        for pause in PAUSES:
            left = [i for i, content in enumerate(found) if not isinstance(content, (bytes, FileNotFoundError))]
            if not left:
                break
            time.sleep(pause)
            asked = ([values[i] for i in left] for values in (paths, starts, stops))
            for index, content in zip(left, fs.cat_ranges(*asked), strict=True):
                found[index] = content
        for row, content in zip(rows, found, strict=True):
            if not isinstance(content, bytes):
                raise UserError(f"{self.place(row)}: cannot be read ({_reason(content)})")
        return found


def _reason(error: Exception) -> str:
    return one_line(error) or type(error).__name__
