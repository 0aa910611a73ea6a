"""Files of Gaussians by rule, as programs write them and people have them, each with the Gaussians that it holds.

Numbers are drawn as files store them, integers where these quantise, so that what a file holds follows from the
specifications in float64. No reader or writer of the project is used.
"""

import gzip
import io
import itertools
import json
import struct
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

Array = NDArray[Any]
COUNT = 300
"""More than the 256 that share bounds in compressed files."""
C0 = 0.28209479177387814
INF, NAN = np.inf, np.nan
KINDS = {"f4": "float", "f8": "double", "u1": "uchar", "i1": "char", "u2": "ushort", "i2": "short", "u4": "uint"}
FORMATS = {"<": "binary_little_endian", ">": "binary_big_endian", "": "ascii"}


@dataclass(frozen=True)
class Held:
    """What a file holds, in its own axes: rows in the order of the file."""

    means: Array
    rotations: Array
    scales: Array
    opacities: Array
    harmonics: Array
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def rows(self, kept: Array) -> "Held":
        columns = (self.means, self.rotations, self.scales, self.opacities, self.harmonics)
        return Held(*(column[kept] for column in columns), offset=self.offset)


@dataclass(frozen=True)
class Strange:
    """A file, what it holds, and the lines that its reader says; ``held`` is what is wrong with it if it is refused."""

    data: bytes
    held: Held | str
    lines: tuple[str, ...] = ()
    activated: bool = False


Case = tuple[str, Callable[[], Strange]]


def cases() -> dict[str, Callable[[], Strange]]:
    """All by name; the suffix of a name is that of the file."""
    return dict(itertools.chain(plys(), compressed(), spzs(), sogs(), ksplats()))


def drawn(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


def sigmoid(logits: Array) -> Array:
    return 1 / (1 + np.exp(-logits))


# PLY


def columns(degree: int = 0, count: int = COUNT) -> dict[str, Array]:
    """Float32 columns of the layout of 3DGS, none of which is alike."""
    draw = drawn(degree)
    higher = 3 * ((degree + 1) ** 2 - 1)
    names = [*"xyz", "nx", "ny", "nz", *(f"f_dc_{i}" for i in range(3)), *(f"f_rest_{i}" for i in range(higher))]
    found = {name: draw.normal(0, 0.4, count) for name in names}
    found |= {"opacity": draw.normal(0, 2, count)} | {f"scale_{i}": draw.normal(-4, 0.5, count) for i in range(3)}
    found |= {f"rot_{i}": draw.normal(0, 1, count) for i in range(4)}
    return {name: column.astype("f4").astype("f8") for name, column in found.items()}


def held_by(values: Mapping[str, Array]) -> Held:
    rest = sum(name.startswith("f_rest_") for name in values) // 3
    higher = np.array([values[f"f_rest_{index}"] for index in range(3 * rest)]).reshape(3, rest, len(values["x"]))
    harmonics = np.concatenate([[[values[f"f_dc_{channel}"]] for channel in range(3)], higher], 1).T

    def stack(stem: str, number: int) -> Array:
        return np.stack([values[f"{stem}_{index}"] for index in range(number)], 1)

    with np.errstate(over="ignore"):
        return Held(
            np.stack([values[axis] for axis in "xyz"], 1), stack("rot", 4), np.exp(stack("scale", 3)),
            sigmoid(values["opacity"]), harmonics,
        )  # fmt: skip


def element(name: str, values: Mapping[str, Array], kinds: Mapping[str, str], order: str) -> tuple[str, bytes]:
    """The lines of a header on one element, and its data."""
    table = np.empty(len(next(iter(values.values()))), [(key, (order or "<") + kinds.get(key, "f4")) for key in values])
    for key, column in values.items():
        table[key] = column
    lines = [f"element {name} {len(table)}", *(f"property {KINDS[kinds.get(key, 'f4')]} {key}" for key in values)]
    text = "".join(" ".join(map(repr, row.tolist())) + "\n" for row in table) if not order else ""
    return "\n".join(lines) + "\n", text.encode() or table.tobytes()


def ply(
    values: Mapping[str, Array],
    order: str = "<",
    kinds: Mapping[str, str] | None = None,
    *,
    before: tuple[tuple[str, bytes], ...] = (),
    after: tuple[tuple[str, bytes], ...] = (),
    comments: bytes = b"",
) -> bytes:
    return joined([*before, element("vertex", values, kinds or {}, order), *after], order, comments)


def joined(parts: Sequence[tuple[str, bytes]], order: str, comments: bytes = b"") -> bytes:
    """A file of elements."""
    start, lines = f"ply\nformat {FORMATS[order]} 1.0\n", "".join(lines for lines, _ in parts)
    return start.encode() + comments + lines.encode() + b"end_header\n" + b"".join(data for _, data in parts)


def plain(values: Mapping[str, Array]) -> Strange:
    return Strange(ply(values), held_by(values))


def header(data: bytes, change: Callable[[bytes], bytes]) -> bytes:
    """A PLY file with another header."""
    before, end, after = data.partition(b"end_header\n")
    return change(before + end) + after


def plys() -> Iterator[Case]:
    def arranged(degree: int, names: list[str], order: str = "<") -> Callable[[], Strange]:
        values = columns(degree)
        return lambda: Strange(ply({name: values[name] for name in names}, order), held_by(values))

    for degree in range(5):
        yield f"degree {degree}.ply", arranged(degree, list(columns(degree)))
    names = list(columns(2))
    yield "backwards, big endian.ply", arranged(2, names[::-1], ">")
    yield "shuffled, ascii.ply", arranged(2, [names[i] for i in drawn(7).permutation(len(names))], "")
    yield "without normals.ply", arranged(2, [name for name in names if name not in ("nx", "ny", "nz")])
    for what, change in typed().items():

        def typed_as(change=change) -> Strange:
            values, kinds, lines = change(columns(1))
            stored = {key: np.array(column, kinds.get(key, "f4")) for key, column in values.items()}
            return Strange(ply(stored, "<", kinds), told(stored), lines)

        yield f"{what}.ply", typed_as
    yield from headers()
    yield from elements()
    yield from strange_rows()
    yield from refused_plys()


def told(stored: Mapping[str, Array]) -> Held:
    """What columns of any type hold."""
    values = {name: column.astype("f8") for name, column in stored.items()}
    if "f_dc_0" not in values:
        largest = max(values[name].max() for name in ("red", "green", "blue"))
        top = 65535.0 if largest > 255 else 255.0 if largest > 1 else 1.0
        for index, name in enumerate(("red", "green", "blue")):
            values[f"f_dc_{index}"] = (values[name] / top - 0.5) / C0
    return held_by(values)


def typed() -> dict[str, Callable[[dict[str, Array]], tuple[dict[str, Array], dict[str, str], tuple[str, ...]]]]:
    draw = drawn(3)

    def colors(kind: str, top: float, both: bool = False):
        given = {name: draw.integers(0, 256, COUNT) * (top / 255) for name in ("red", "green", "blue")}
        line = f"red, green and blue are read as numbers from 0 to {top:g}"
        guessed = () if both or (kind, top) in (("u1", 255), ("u2", 65535)) else (line,)

        def change(values: dict[str, Array]):
            kept = {name: column for name, column in values.items() if both or not name.startswith("f_dc")}
            return kept | given, dict.fromkeys(given, kind), guessed

        return change

    def rounded(values: dict[str, Array]):
        """Normals as bytes, colours as whole numbers."""
        whole = {name: np.round(values[name] * 100) for name in ("nx", "ny", "nz")}
        return values | whole, dict.fromkeys(whole, "i1"), ()

    return {
        "double": lambda values: (values, dict.fromkeys(values, "f8"), ()),
        "positions in double": lambda values: (values, dict.fromkeys("xyz", "f8"), ()),
        "normals in bytes": rounded,
        "colours in bytes": colors("u1", 255),
        "colours in 16 bits": colors("u2", 65535),
        "bytes in 16 bits": colors("u2", 255),
        "bytes in 32 bits": colors("u4", 255),
        "colours to 1": colors("f4", 1),
        "colours to 255": colors("f4", 255),
        "colours twice": colors("u1", 255, both=True),
        "more properties": lambda values: (
            {"id": np.arange(COUNT), "f_0": values["y"], **values, "confidence": values["x"], "label": values["z"] > 0},
            {"id": "u4", "label": "u1", "confidence": "f8"}, (),
        ),
    }  # fmt: skip


def headers() -> Iterator[Case]:
    changes: dict[str, Callable[[bytes], bytes]] = {
        "lines of Windows": lambda text: text.replace(b"\n", b"\r\n"),
        "comment in UTF-8": lambda text: text.replace(b"element", "comment scène de Noël\nelement".encode(), 1),
        "comment in Latin-1": lambda text: text.replace(b"element", "comment scène\nelement".encode("latin-1"), 1),
        "comment that says end_header": lambda text: text.replace(b"element", b"comment no end_header yet\nelement", 1),
        "empty comment": lambda text: text.replace(b"element", b"comment\nelement", 1),
        "comment before the format": lambda text: text.replace(b"format", b"comment Generated\nformat", 1),
        "comments among properties": lambda text: text.replace(b"property", b"comment logit\nproperty"),
        "70 kB of comments": lambda text: text.replace(b"element", b"comment much\n" * 5500 + b"element", 1),
        "obj_info": lambda text: text.replace(b"element", b"obj_info made by hand\nelement", 1),
        "names of types with bits": lambda text: text.replace(b" float ", b" float32 "),
        "more spaces": lambda text: text.replace(b"property float", b"property   float "),
        "spaces at the ends": lambda text: text.replace(b"\nproperty", b" \nproperty"),
    }  # fmt: skip
    for what, change in changes.items():

        def changed(change=change) -> Strange:
            values = columns(1)
            return Strange(header(ply(values), change), held_by(values))

        yield f"{what}.ply", changed


def elements() -> Iterator[Case]:
    def beside() -> Strange:
        """As SHARP writes it: matrices and a colour space after the vertices."""
        values = columns(0)
        more = [("extrinsic", np.eye(4).ravel(), "f4"), ("image_size", np.array([640, 480]), "u4")]
        more += [("color_space", np.array([1]), "u1"), ("version", np.array([1, 5, 0]), "u1")]
        after = tuple(element(name, {name: column}, {name: kind}, "<") for name, column, kind in more)
        return Strange(ply(values, after=after), held_by(values))

    def before() -> Strange:
        values, camera = columns(2), {"fx": np.array([500.0]), "fy": np.array([501.0])}
        return Strange(ply(values, "", before=(element("camera", camera, {}, ""),)), held_by(values))

    def faces() -> Strange:
        face = ("element face 1\nproperty list uchar int vertex_indices\n", struct.pack("<Biii", 3, 0, 1, 2))
        return Strange(ply(columns(0), after=(face,)), held_by(columns(0)))

    yield "elements after.ply", beside
    yield "elements before, ascii.ply", before
    yield "faces.ply", faces
    yield "bytes behind the end.ply", lambda: Strange(ply(columns(1)) + b"\0" * 100, held_by(columns(1)))


def strange_rows() -> Iterator[Case]:
    def changed(change: Callable[[dict[str, Array]], object], what: str = ""):
        def make() -> Strange:
            values = columns(1)
            change(values)
            held = held_by(values)
            sound = (held.means, held.rotations, held.scales, held.opacities, held.harmonics)
            largest = np.sqrt(np.finfo("f4").max)
            kept = np.logical_and.reduce([(np.abs(each.reshape(COUNT, -1)) < largest).all(1) for each in sound])
            kept &= values["opacity"] != -INF
            lost = COUNT - int(kept.sum())
            line = f"{lost} of {COUNT} Gaussians are left out ({what})" if lost else what
            return Strange(ply(values), held.rows(kept), (line,) if line else ())

        return make

    def put(name: str, value: float, rows: slice | int = 0):
        def change(values: dict[str, Array]) -> None:
            values[name] = values[name].copy()
            values[name][rows] = value

        return change

    scale = "with an infinite, negative or missing scale"
    table = {
        "NaN in a position": (put("y", NAN, slice(0, 9, 2)), "5 without a position"),
        "infinite position": (put("z", -INF), "1 without a position"),
        "position of 1e30": (put("x", 1e30), "1 without a position"),
        "NaN in an opacity": (put("opacity", NAN), "1 without an opacity"),
        "opacity of -inf": (put("opacity", -INF, slice(3)), "3 with opacity -inf"),
        "NaN in a scale": (put("scale_1", NAN), f"1 {scale}"),
        "scale of +inf": (put("scale_2", INF), f"1 {scale}"),
        "scale of 300": (put("scale_0", 300), f"1 {scale}"),
        "NaN in a rotation": (put("rot_3", NAN), "1 without a rotation"),
        "NaN in a colour": (put("f_dc_1", NAN), "1 without a colour"),
        "NaN in a harmonic": (put("f_rest_8", NAN), "1 without a colour"),
        "opacity of +inf": (put("opacity", INF), f"of {COUNT} Gaussians, all kept, 1 with opacity +inf, as opaque"),
        "scale of -inf": (put("scale_2", -INF), f"of {COUNT} Gaussians, all kept, 1 with scale -inf, as flat"),
        "opacity of 1000": (put("opacity", 1000), ""),
        "scale of -1000": (put("scale_2", -1000), ""),
        "position of 1e6 in single": (put("x", 1e6, slice(None)), ""),
        "everything at one place": (lambda v: [put(axis, 1.0, slice(None))(v) for axis in "xyz"], ""),
    }
    for what, (change, line) in table.items():
        yield f"{what}.ply", changed(change, line)

    def flat() -> Strange:
        values = columns(2)
        held = held_by(values)
        held.scales[:, 2] = 0
        del values["scale_2"]
        return Strange(ply(values), held, ("without scale_2, its Gaussians are flat discs, as 2DGS writes them",))

    def lengths() -> Strange:
        values, draw = columns(0), drawn(5)
        values |= {f"scale_{index}": draw.random(COUNT) * 0.02 for index in range(3)} | {"opacity": draw.random(COUNT)}
        values = {name: column.astype("f4").astype("f8") for name, column in values.items()}
        stored = values | {"opacity": np.log(values["opacity"]) - np.log1p(-values["opacity"])}
        held = held_by(stored | {f"scale_{index}": np.log(values[f"scale_{index}"]) for index in range(3)})
        return Strange(ply(values), held, activated=True)

    def globe() -> Strange:
        values = columns(1)
        values |= {"x": 4.5e6 + 0.01 * np.arange(COUNT), "y": 5.4e5 + values["y"], "z": values["z"]}
        held = held_by(values)
        offset = np.median(held.means, 0).round() * (1, 1, 0) + 0.0
        line = "{:.17g} {:.17g} {:.17g} is taken off all positions, which float32 would round".format(*offset)
        x, y, z = offset.tolist()
        moved = Held(held.means - offset, held.rotations, held.scales, held.opacities, held.harmonics, (x, y, z))
        return Strange(ply(values, kinds=dict.fromkeys("xyz", "f8")), moved, (line,))

    turns = {name: column for name, column in columns(1).items() if name.startswith("rot_")}
    opposite = {name: -3 * column for name, column in turns.items()}
    yield "quaternions of other signs and lengths.ply", lambda: plain(columns(1) | opposite)
    yield "quaternions of 0.ply", lambda: plain(columns(0) | dict.fromkeys(turns, np.zeros(COUNT)))

    def uneven() -> Strange:
        """Four coefficients a colour above the constant one: degree 1 takes three."""
        values, held = columns(1), held_by(columns(1))
        for index in reversed(range(9)):
            values[f"f_rest_{index + index // 3}"] = values[f"f_rest_{index}"]
        values |= {f"f_rest_{index}": np.full(COUNT, 9.0) for index in (3, 7, 11)}
        return Strange(ply(values), held, ("of 4 coefficients a colour in f_rest_*, the first 3 are read, degree 1",))

    yield "an uneven number of harmonics.ply", uneven
    yield "two scales.ply", flat
    yield "lengths and fractions.ply", lengths
    yield "coordinates of UTM.ply", globe
    for count in (1, 2):
        yield f"{count} rows.ply", lambda count=count: plain(columns(3, count))


def refused_plys() -> Iterator[Case]:
    def without(name: str):
        def make() -> Strange:
            values = {key: column for key, column in columns(0).items() if key != name}
            return Strange(ply(values), f"without the properties {name}")

        return make

    for name in ("x", "f_dc_1", "opacity", "scale_0", "rot_2"):
        yield f"without {name}.ply", without(name)
    colors = ("red", "green", "blue")
    points = {axis: columns(0)[axis] for axis in "xyz"} | dict.fromkeys(colors, np.zeros(COUNT))
    yield "a point cloud.ply", lambda: Strange(ply(points, kinds=dict.fromkeys(colors, "u1")), "without the properties")
    yield "no rows.ply", lambda: Strange(ply(columns(1, 0)), "it is empty")
    yield "cut.ply", lambda: Strange(ply(columns(1))[:-7], "is not a valid PLY file of Gaussians")
    ten = {f"f_rest_{index}": np.zeros(COUNT) for index in range(10)}
    yield "10 harmonics.ply", lambda: Strange(ply(columns(0) | ten), "10")


# PLY, compressed


def compressed() -> Iterator[Case]:
    def packed(degree: int, count: int = COUNT, order: str = "<", bounded: bool = True, edges: bool = False) -> Strange:
        draw = drawn(degree)
        chunks = -(-count // 256)
        names = [*"xyz", "scale_x", "scale_y", "scale_z", *("rgb" if bounded else "")]
        low = {name: draw.normal(-4 if "scale" in name else 0, 0.5, chunks).astype("f4") for name in names}
        high = {name: low[name] + draw.random(chunks).astype("f4") for name in names}
        groups = (names[:3], names[3:6], names[6:])  # in SuperSplat's order
        both = (("min", low), ("max", high))
        chunk = {f"{bound}_{name}": values[name] for group in groups for bound, values in both for name in group}
        packs = ("position", "rotation", "scale", "color")
        words = {f"packed_{name}": draw.integers(0, 1 << 32, count, np.uint64) for name in packs}
        if edges:
            words = {name: np.where(np.arange(count) % 2, 0, 0xFFFFFFFF) for name in words}
            words["packed_rotation"] = np.arange(count, dtype=np.uint64) % 4 << 30 | 0x1FF7FDFF
        higher = 3 * ((degree + 1) ** 2 - 1)
        rest = {f"f_rest_{index}": draw.integers(0, 256, count) for index in range(higher)}
        group = np.arange(count) // 256

        def bits(name: str, shift: int, number: int) -> Array:
            top = 2**number - 1
            return (words[f"packed_{name}"].astype(np.uint64) >> np.uint64(shift) & np.uint64(top)) / top

        def between(fraction: Array, name: str) -> Array:
            return low[name][group].astype("f8") * (1 - fraction) + high[name][group].astype("f8") * fraction

        layout = ((21, 11), (11, 10), (0, 11))
        values = {axis: between(bits("position", *layout[i]), axis) for i, axis in enumerate("xyz")}
        values |= {f"scale_{i}": between(bits("scale", *layout[i]), f"scale_{axis}") for i, axis in enumerate("xyz")}
        others = np.stack([(bits("rotation", shift, 10) - 0.5) * np.sqrt(2) for shift in (20, 10, 0)], 1)
        turns = smallest_three((words["packed_rotation"].astype(np.uint64) >> np.uint64(30)).astype(int), others)
        values |= {f"rot_{index}": turns[:, index] for index in range(4)}
        for index, (channel, shift) in enumerate(zip("rgb", (24, 16, 8), strict=True)):
            fraction = bits("color", shift, 8)
            values[f"f_dc_{index}"] = ((between(fraction, channel) if bounded else fraction) - 0.5) / C0
        values["opacity"] = np.zeros(count)
        for name, column in rest.items():
            values[name] = (np.select([column == 0, column == 255], [0.0, 1.0], (column + 0.5) / 256) - 0.5) * 8
        held = held_by(values)
        opaque = Held(held.means, held.rotations, held.scales, bits("color", 0, 8), held.harmonics)
        parts = [element("chunk", chunk, {}, order), element("vertex", words, dict.fromkeys(words, "u4"), order)]
        if rest:
            parts.append(element("sh", rest, dict.fromkeys(rest, "u1"), order))
        return Strange(joined(parts, order), opaque)

    for degree in range(4):
        yield f"degree {degree}.compressed.ply", lambda degree=degree: packed(degree)
    yield "colours to 1.compressed.ply", lambda: packed(1, bounded=False)
    yield "big endian.compressed.ply", lambda: packed(1, order=">")
    for count in (1, 257):
        yield f"{count} rows.compressed.ply", lambda count=count: packed(1, count)
    yield "edges.compressed.ply", lambda: packed(2, edges=True)


def smallest_three(largest: Array, others: Array) -> Array:
    """Quaternions from the index of the largest component and the other three in order."""
    rows = zip(largest, others, strict=True)
    return np.array([np.insert(three, index, np.sqrt(max(0.0, 1 - three @ three))) for index, three in rows])


# SPZ


def spzs() -> Iterator[Case]:
    def packed(version: int, degree: int, *, bits: int = 12, flags: int = 0, members: int = 1) -> Strange:
        draw, higher = drawn(10 * version + degree), (degree + 1) ** 2 - 1
        if version == 1:
            halves = draw.normal(size=(COUNT, 3)).astype("<f2")
            means, positions = halves.astype("f8"), halves.tobytes()
        else:
            fixed = draw.integers(-(2**23), 2**23, (COUNT, 3))
            fixed[0], fixed[1] = -(2**23), 2**23 - 1
            means, positions = fixed / 2**bits, fixed.astype("<i4")[..., None].view("u1")[..., :3].tobytes()
        alpha, color, scale = (draw.integers(0, 256, shape) for shape in (COUNT, (COUNT, 3), (COUNT, 3)))
        rest = draw.integers(0, 256, (COUNT, higher, 3))
        if version < 3:
            xyz = draw.integers(40, 216, (COUNT, 3))
            imaginary = xyz / 127.5 - 1
            real = np.sqrt(np.maximum(0, 1 - np.square(imaginary).sum(1, keepdims=True)))
            turns = np.concatenate([real, imaginary], 1)
            rotations = xyz.astype("u1").tobytes()
        else:
            largest, size, sign = (draw.integers(0, *ends) for ends in ((4, COUNT), (460, (COUNT, 3)), (2, (COUNT, 3))))
            turns = smallest_three(largest, size / 511 / np.sqrt(2) * (1 - 2 * sign))[:, [3, 0, 1, 2]]
            fields = size | sign << 9
            rotations = (largest << 30 | fields[:, 0] << 20 | fields[:, 1] << 10 | fields[:, 2]).astype("<u4").tobytes()
        alphas, colors, sizes, more = (part.astype("u1").tobytes() for part in (alpha, color, scale, rest))
        streams = [positions, alphas, colors, sizes, rotations, more]
        harmonics = np.concatenate([(color[:, None] / 255 - 0.5) / 0.15, (rest - 128) / 128], 1)
        held = Held(means, turns, np.exp(scale / 16 - 10), alpha / 255, harmonics)
        head = struct.pack("<IIIBBBB", 0x5053474E, version, COUNT, degree, bits, flags, 0)
        if version < 4:
            body = head + b"".join(streams)
            ends = np.linspace(0, len(body), members + 1).astype(int)
            parts = (gzip.compress(body[start:end], mtime=0) for start, end in itertools.pairwise(ends))
            return Strange(b"".join(parts), held)
        import zstandard

        streams = [stream for stream in streams if stream]
        short = [zstandard.ZstdCompressor().compress(stream) for stream in streams]
        table = b"".join(struct.pack("<QQ", len(a), len(b)) for a, b in zip(short, streams, strict=True))
        head = head[:15] + struct.pack("<BI12x", len(streams), 32)
        return Strange(head + table + b"".join(short), held)

    for version, degree in ((1, 1), (2, 2), (3, 0), (3, 3), (4, 0), (4, 4)):
        yield f"version {version}, degree {degree}.spz", lambda v=version, d=degree: packed(v, d)
    for bits in (0, 23):
        yield f"{bits} fractional bits.spz", lambda bits=bits: packed(2, 1, bits=bits)
    yield "two members.spz", lambda: packed(3, 1, members=2)
    yield "antialiased.spz", lambda: packed(3, 2, flags=1)
    head = struct.pack("<IIIBBBB", 0x5053474E, 3, 0, 0, 12, 0, 0)
    yield "no rows.spz", lambda: Strange(gzip.compress(head, mtime=0), "it has no Gaussians")
    yield "version 9.spz", lambda: Strange(gzip.compress(head[:4] + b"\t" + head[5:], mtime=0), "version 9")


# SOG


def sogs() -> Iterator[Case]:
    def webp(pixels: Array) -> bytes:
        stream = io.BytesIO()
        Image.fromarray(pixels.astype("u1")).save(stream, "WEBP", lossless=True, exact=True)
        return stream.getvalue()

    def archived(degree: int, *, inside: str = "", version: int = 2, centroids: int = 70) -> Strange:
        draw, width, height = drawn(20 + degree), 20, 16  # more than there are Gaussians

        def image(values: Array) -> bytes:
            pixels = np.concatenate([values, draw.integers(0, 256, (width * height - COUNT, values.shape[1]))])
            return webp(pixels.reshape(height, width, -1))

        words = draw.integers(0, 65536, (COUNT, 3))
        low, high = draw.normal(-1, 0.1, 3), draw.normal(1, 0.1, 3)
        far = low + (high - low) * words / 65535
        turn, largest = draw.integers(45, 211, (COUNT, 3)), draw.integers(0, 4, COUNT)
        turns = smallest_three(largest, (turn / 255 - 0.5) * np.sqrt(2))
        scale, color, alpha = (draw.integers(0, 256, shape) for shape in ((COUNT, 3), (COUNT, 3), COUNT))
        scale_book, color_book, rest_book = (np.sort(draw.normal(at, 0.5, 256)) for at in (-4, 0, 0))
        files = {"means_l.webp": image(words & 255), "means_u.webp": image(words >> 8), "scales.webp": image(scale)}
        files["quats.webp"] = image(np.concatenate([turn, 252 + largest[:, None]], 1))
        files["sh0.webp"] = image(np.concatenate([color, alpha[:, None]], 1))
        meta: dict[str, Any] = {
            "means": {"mins": low.tolist(), "maxs": high.tolist(), "files": ["means_l.webp", "means_u.webp"]},
            "quats": {"files": ["quats.webp"]},
            "scales": {"files": ["scales.webp"]},
            "sh0": {"files": ["sh0.webp"]},
        }
        if version == 2:
            meta |= {"version": 2, "count": COUNT}
            meta["scales"]["codebook"], meta["sh0"]["codebook"] = scale_book.tolist(), color_book.tolist()
            scales, constant, opacities = np.exp(scale_book[scale]), color_book[color], alpha / 255
        else:
            meta["means"] |= {"shape": [COUNT, 3], "dtype": "float32"}
            meta["scales"] |= {"mins": [-6.0] * 3, "maxs": [-2.0] * 3}
            meta["sh0"] |= {"mins": [-2.0, -2.0, -2.0, -5.0], "maxs": [2.0, 2.0, 2.0, 5.0]}
            scales, constant = np.exp(-6 + 4 * scale / 255), -2 + 4 * color / 255
            opacities = sigmoid(-5 + 10 * alpha / 255)
        rest = np.zeros((COUNT, 0, 3))
        if degree:
            higher = (degree + 1) ** 2 - 1
            labels = draw.integers(0, centroids, COUNT)
            table = draw.integers(0, 256, (-(-centroids // 64) * 64, higher, 3))
            files["shN_centroids.webp"] = webp(table.reshape(-1, 64 * higher, 3))
            files["shN_labels.webp"] = image(np.stack([labels & 255, labels >> 8, 0 * labels], 1))
            meta["shN"] = {"files": ["shN_centroids.webp", "shN_labels.webp"]}
            if version == 2:
                meta["shN"] |= {"count": centroids, "bands": degree, "codebook": rest_book.tolist()}
                rest = rest_book[table[labels]]
            else:
                meta["shN"] |= {"mins": -1.5, "maxs": 1.5, "quantization": 8}
                rest = -1.5 + 3 * table[labels] / 255
        harmonics = np.concatenate([constant[:, None], rest], 1)
        held = Held(np.sign(far) * np.expm1(np.abs(far)), turns, scales, opacities, harmonics)
        stream = io.BytesIO()
        with zipfile.ZipFile(stream, "w") as archive:
            for name, data in {"meta.json": json.dumps(meta).encode(), **files}.items():
                archive.writestr(zipfile.ZipInfo(inside + name), data)
        return Strange(stream.getvalue(), held)

    for version, degree in ((1, 1), (2, 0), (2, 3)):
        yield f"version {version}, degree {degree}.sog", lambda v=version, d=degree: archived(d, version=v)
    yield "in a folder.sog", lambda: archived(1, inside="scene/")
    yield "300 centroids.sog", lambda: archived(2, centroids=300)


# KSPLAT


def ksplats() -> Iterator[Case]:
    def packed(level: int, degree: int, *, sections: int = 1, room: int = 0) -> Strange:
        draw, higher = drawn(40 + degree + 5 * level), (degree + 1) ** 2 - 1
        kind, number = ("<f4", "<f4") if level == 0 else ("<u2", "<f2")
        fields = [("mean", kind, 3), ("scale", number, 3), ("turn", number, 4), ("color", "u1", 4)]
        row = np.dtype([*fields, ("rest", ("<f4", "<f2", "u1")[level], 3 * higher)])
        low, high, block = -1.25, 1.75, 5.0
        heads, bodies, parts = [], [], []
        for _ in range(sections):
            table = np.zeros(COUNT + room, row)
            rows = table[:COUNT]
            rows["scale"], rows["turn"] = draw.random((COUNT, 3)) * 0.1, draw.normal(size=(COUNT, 4))
            rows["color"] = draw.integers(0, 256, (COUNT, 4))
            shape, sizes = (COUNT, 3 * higher), [256, 30, 14]
            rows["rest"] = draw.integers(0, 256, shape) if level == 2 else draw.normal(size=shape)
            centers = draw.normal(size=(len(sizes) * (level > 0), 3)).astype("<f4")
            if level:
                rows["mean"] = draw.integers(0, 65536, (COUNT, 3))
                middle = np.repeat(centers.astype("f8"), sizes, 0)
                means = (rows["mean"].astype("f8") - 32767) * (block / 2 / 32767) + middle
            else:
                rows["mean"] = draw.normal(size=(COUNT, 3))
                means = rows["mean"].astype("f8")
            # Bands follow each other; in each the coefficients of red, green, blue.
            rest = np.zeros((COUNT, higher, 3))
            stored = rows["rest"].astype("f8")
            stored = low + stored / 255 * (high - low) if level == 2 else stored
            for band in range(1, degree + 1):
                first, wide = band**2 - 1, 2 * band + 1
                values = stored[:, 3 * first : 3 * (first + wide)].reshape(COUNT, 3, wide)
                rest[:, first : first + wide] = np.moveaxis(values, 1, 2)
            color = rows["color"] / 255
            turns, scales = (rows[name].astype("f8") for name in ("turn", "scale"))
            harmonics = np.concatenate([(color[:, None, :3] - 0.5) / C0, rest], 1)
            parts.append((means, turns, scales, color[:, 3], harmonics))
            lengths = np.array(sizes[1:] if level else [], "<u4")
            body = lengths.tobytes() + centers.tobytes() + table.tobytes()
            buckets = (256, len(centers), block, 12, 32767) if level else (0, 0, 0.0, 0, 0)
            head = (COUNT, COUNT + room, *buckets, len(body), 1 if level else 0, len(lengths), degree)
            heads.append(struct.pack("<IIIIfHxxIIIIH", *head).ljust(1024, b"\0"))
            bodies.append(body)
        total = COUNT * sections
        counts = (sections, sections, total + room * sections, total)
        start = struct.pack("<BBxxIIIIHxx3fff", 0, 1, *counts, level, 0, 0, 0, low, high)
        data = start.ljust(4096, b"\0") + b"".join(heads) + b"".join(bodies)
        means, turns, scales, opacities, harmonics = (np.concatenate(columns) for columns in zip(*parts, strict=True))
        return Strange(data, Held(means, turns, scales, opacities, harmonics))

    for level, degree in ((0, 0), (0, 2), (1, 1), (2, 2)):
        yield f"level {level}, degree {degree}.ksplat", lambda level=level, degree=degree: packed(level, degree)
    yield "two sections.ksplat", lambda: packed(1, 1, sections=2)
    yield "room for more.ksplat", lambda: packed(1, 1, room=7)

    def cut() -> Strange:
        whole = packed(0, 1)
        assert isinstance(whole.held, Held)
        line = "the file ends after 298 of 300 Gaussians of a section"
        return Strange(whole.data[:-100], whole.held.rows(np.arange(298)), (line,))

    yield "cut.ksplat", cut
    yield "version 1.ksplat", lambda: Strange(b"\1" + packed(0, 0).data[1:], "version 1")
    yield "no rows.ksplat", lambda: Strange(b"\0\1".ljust(4096, b"\0"), "it has no Gaussians")
