"""What stands where in a procedural scene: rooms and gardens, furniture and toys, materials and light."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, TypeVar

import numpy as np
from numpy.typing import NDArray

from anystyle.ranges import Range
from anystyle_tiny.procedural import raycast as rc
from anystyle_tiny.procedural import solids as sd
from anystyle_tiny.procedural import textures as tx
from anystyle_tiny.procedural.volumes import sine

Float64Array = NDArray[np.float64]
ImageSide = Annotated[int, Range(ge=8, le=4096)]
T = TypeVar("T")
SPLITS = ("train", "validation", "heldout")

# Natural colours in sRGB; a scene mixes some of them with vivid ones.
NATURAL = (
    (232, 226, 212), (201, 186, 160), (168, 140, 106), (120, 84, 54), (84, 60, 44), (156, 148, 138),
    (110, 112, 112), (188, 176, 168), (150, 84, 62), (176, 108, 78), (104, 122, 84), (74, 92, 66),
    (124, 140, 148), (86, 102, 120), (214, 200, 176), (60, 58, 62), (198, 156, 100), (222, 214, 222),
)  # fmt: skip

CLEARANCE = 0.6
"""How near a camera a group of solids may stand, in sizes of a group."""


@dataclass(frozen=True)
class World:
    """The tables of :mod:`anystyle_tiny.procedural.solids`, ``raycast`` and ``textures``."""

    settings: Float64Array
    solids: Float64Array
    materials: Float64Array


class Draw:
    """Draws from one seeded stream, with uniform numbers only: their bits are the same everywhere."""

    def __init__(self, seed: tuple[int, ...]) -> None:
        self._generator = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed)))

    def between(self, low: float, high: float) -> float:
        """A number in [low, high)."""
        return low + (high - low) * float(self._generator.random())

    def below(self, count: int) -> int:
        """An integer in [0, count)."""
        return min(int(self._generator.random() * count), count - 1)

    def chance(self, probability: float) -> bool:
        """True with a probability."""
        return float(self._generator.random()) < probability

    def shuffled(self, items: Sequence[T]) -> list[T]:
        """The same items in a random order."""
        order = list(items)
        for last in range(len(order) - 1, 0, -1):
            other = self.below(last + 1)
            order[last], order[other] = order[other], order[last]
        return order

    def turn(self) -> tuple[float, float]:
        """Cosine and sine of a uniform angle."""
        return unit_circle(self.between(-np.pi, np.pi))

    def color(self, vividness: float) -> Float64Array:
        """A linear colour; natural or, with probability ``vividness``, of any hue."""
        if self.chance(vividness):
            hue, saturation, value = self.between(0.0, 6.0), self.between(0.45, 0.9), self.between(0.45, 0.95)
            ramp = np.abs((hue + np.array([0.0, 4.0, 2.0])) % 6.0 - 3.0) - 1.0
            srgb = value * (1.0 - saturation * (1.0 - np.clip(ramp, 0.0, 1.0)))
        else:
            srgb = np.array(NATURAL[self.below(len(NATURAL))]) / 255.0
            srgb = np.clip(srgb * self.between(0.85, 1.1) + self.between(-0.02, 0.02), 0.03, 0.97)
        return srgb * srgb


def unit_circle(angle: float) -> tuple[float, float]:
    """Cosine and sine with bits that depend on no library, of exactly unit length but for rounding."""
    s, c = float(sine(angle)), float(tx.sine(angle + 0.5 * np.pi))
    length = float(np.sqrt(c * c + s * s))
    return c / length, s / length


class Builder:
    """Collects the solids and materials of a scene while it is laid out."""

    def __init__(self, draw: Draw, vividness: float) -> None:
        self.draw = draw
        self.vividness = vividness
        self.solids: list[Float64Array] = []
        self.materials: list[Float64Array] = []

    def material(self, kinds: tuple[int, ...], period: tuple[float, float], vividness: float | None = None) -> int:
        """Add a material of one of ``kinds``, its columns in the order of ``textures``, and return its index."""
        draw, vividness = self.draw, self.vividness if vividness is None else vividness
        kind, scale = kinds[draw.below(len(kinds))], draw.between(*period)
        base = draw.color(vividness)
        # Half of the second colours are shades of the first: most surfaces have one hue.
        shaded = draw.chance(0.45)
        other = np.clip(base * draw.between(0.35, 0.8), 0.01, 0.9) if shaded else draw.color(vividness)
        third = draw.color(0.3 * vividness)
        offset = [draw.between(0.0, 4.0) for _ in range(3)]
        turn = draw.turn() if draw.chance(0.3) else (1.0, 0.0)
        rough = draw.between(0.1, 0.35) if draw.chance(0.75) else draw.between(0.0, 0.1)
        gloss = draw.between(0.1, 0.5) if draw.chance(0.25) else 0.0
        self.materials.append(np.array([kind, scale, *base, *other, *third, *offset, *turn, rough, gloss], np.float64))
        return len(self.materials) - 1

    def solid(
        self, shape: int, centre: sd.Vector, half: sd.Vector, material: int, turn: tuple[float, float] = (1.0, 0.0)
    ) -> None:
        """Add a solid, its columns in the order of :mod:`anystyle_tiny.procedural.solids`."""
        x, y, z = half
        bounds = {sd.SPHERE: max(half), sd.BOX: np.sqrt(x * x + y * y + z * z)}
        bound = bounds.get(shape, np.sqrt(max(x, z) ** 2 + y * y)) * 1.0001
        bulk = 0.75 * min(sorted(half)[1], 1.5 * min(half))
        inverse = (1.0 / side for side in half)
        self.solids.append(np.array([shape, *centre, *half, *inverse, *turn, bound, bulk, material], np.float64))

    def thing(self, x: float, y: float, z: float, size: float) -> float:
        """Stand a simple object of about ``size`` on the height ``y``; return the height of a flat top or -1."""
        draw = self.draw
        texture = self.material(tuple(range(len(tx.TEXTURES))), (0.18 * size + 0.05, 0.6 * size + 0.1))
        shape = (sd.SPHERE, sd.BOX, sd.BOX, sd.CYLINDER, sd.CYLINDER, sd.CONE, sd.SPHERE)[draw.below(7)]
        a, b, c = size * draw.between(0.6, 1.0), size * draw.between(0.6, 1.4), size * draw.between(0.6, 1.0)
        if shape == sd.SPHERE:
            b = a if draw.chance(0.6) else b
            a, b, c = 0.85 * a, 0.85 * b, 0.85 * a
        elif shape != sd.BOX:
            a = c = 0.8 * a
        self.solid(shape, (x, y + b, z), (a, b, c), texture, draw.turn())
        return y + 2 * b if shape in (sd.BOX, sd.CYLINDER) else -1.0


def _stack(build: Builder, x: float, z: float, size: float) -> None:
    top = build.thing(x, 0.0, z, size)
    if top > 0 and build.draw.chance(0.7):
        shift = 0.2 * size
        build.thing(x + build.draw.between(-shift, shift), top, z + build.draw.between(-shift, shift), 0.6 * size)


def _table(build: Builder, x: float, z: float, size: float) -> None:
    draw = build.draw
    wood = build.material((tx.WOOD, tx.PLANKS, tx.PLAIN, tx.MARBLE), (0.1, 0.4))
    turn, height = draw.turn(), size * draw.between(0.8, 1.2)
    a, c, thick = size * draw.between(1.0, 1.5), size * draw.between(0.7, 1.1), 0.07 * size
    build.solid(sd.BOX, (x, height, z), (a, thick, c), wood, turn)
    for sx in (-1, 1):
        for sz in (-1, 1):
            px, pz = sx * 0.88 * a, sz * 0.88 * c
            wx, wz = turn[0] * px + turn[1] * pz, -turn[1] * px + turn[0] * pz
            leg = (0.07 * size, 0.5 * (height - thick), 0.07 * size)
            build.solid(sd.CYLINDER, (x + wx, leg[1], z + wz), leg, wood)
    for side in (-1, 1):
        px, pz = side * 0.5 * a, draw.between(-0.4, 0.4) * c
        wx, wz = turn[0] * px + turn[1] * pz, -turn[1] * px + turn[0] * pz
        build.thing(x + wx, height + thick, z + wz, size * draw.between(0.25, 0.4))


def _chair(build: Builder, x: float, z: float, size: float) -> None:
    draw = build.draw
    cloth = build.material((tx.STRIPES, tx.CHECKER, tx.NOISE, tx.PLAIN, tx.DOTS), (0.1, 0.3))
    turn, half, low = draw.turn(), 0.7 * size, 0.4 * size
    build.solid(sd.BOX, (x, low, z), (half, low, half), cloth, turn)
    for sx, sz, a, b, c in ((0, -1, 1.0, 1.7, 0.18), (-1, 0, 0.18, 1.25, 1.0), (1, 0, 0.18, 1.25, 1.0)):
        px, pz = sx * half, sz * half
        position = (x + turn[0] * px + turn[1] * pz, b * low, z - turn[1] * px + turn[0] * pz)
        build.solid(sd.BOX, position, (a * half, b * low, c * half), cloth, turn)


def _lamp(build: Builder, x: float, z: float, size: float) -> None:
    pole = build.material((tx.PLAIN, tx.WOOD), (0.1, 0.3), 0.2)
    shade = build.material((tx.PLAIN, tx.STRIPES, tx.NOISE), (0.1, 0.3))
    height = size * build.draw.between(1.8, 2.6)
    build.solid(sd.CYLINDER, (x, 0.5 * height, z), (0.06 * size, 0.5 * height, 0.06 * size), pole)
    build.solid(sd.CYLINDER, (x, 0.05 * size, z), (0.4 * size, 0.05 * size, 0.4 * size), pole)
    build.solid(sd.CONE, (x, height + 0.2 * size, z), (0.6 * size, 0.5 * size, 0.6 * size), shade)


def _plant(build: Builder, x: float, z: float, size: float) -> None:
    draw = build.draw
    pot = build.material((tx.PLAIN, tx.BRICKS, tx.STRIPES, tx.CELLS), (0.1, 0.3))
    green = build.material((tx.LEAVES, tx.NOISE), (0.5, 1.2), 0.0)
    for start, scale in ((tx.COLOR_A, 0.5), (tx.COLOR_B, 1.0), (tx.COLOR_C, 0.25)):
        build.materials[green][start : start + 3] = scale * np.array([draw.between(0.1, 0.35), 0.36, 0.08])
    build.solid(sd.CYLINDER, (x, 0.35 * size, z), (0.4 * size, 0.35 * size, 0.4 * size), pot)
    for _ in range(1 + draw.below(3)):
        r, shift = size * draw.between(0.45, 0.7), 0.3 * size
        position = (x + draw.between(-shift, shift), size * draw.between(1.0, 1.5), z + draw.between(-shift, shift))
        build.solid(sd.SPHERE, position, (r, r * draw.between(0.8, 1.3), r), green, draw.turn())


def _tree(build: Builder, x: float, z: float, size: float) -> None:
    draw = build.draw
    bark = build.material((tx.WOOD, tx.NOISE), (0.1, 0.3), 0.0)
    green = build.material((tx.LEAVES, tx.NOISE), (0.6, 1.5), 0.0)
    autumn = draw.between(0.05, 0.5) if draw.chance(0.4) else 0.12
    for start, scale in ((tx.COLOR_A, 0.6), (tx.COLOR_B, 1.0), (tx.COLOR_C, 0.3)):
        build.materials[green][start : start + 3] = scale * np.array([autumn, 0.28, 0.06])
    height = size * draw.between(1.0, 1.6)
    build.solid(sd.CYLINDER, (x, 0.5 * height, z), (0.15 * size, 0.5 * height, 0.15 * size), bark)
    if draw.chance(0.35):
        for k in range(2):
            r = size * (0.95 - 0.25 * k)
            build.solid(sd.CONE, (x, height + 0.7 * size * (k + 0.5), z), (r, 0.8 * size, r), green, draw.turn())
        return
    for k in range(2 + draw.below(2)):
        r, shift = size * draw.between(0.55, 0.85), 0.45 * size * min(k, 1)
        at = x + draw.between(-shift, shift)
        position = (at, height + size * draw.between(0.2, 0.6), z + draw.between(-shift, shift))
        build.solid(sd.SPHERE, position, (r, 0.85 * r, r), green, draw.turn())


def _house(build: Builder, x: float, z: float, size: float) -> None:
    draw = build.draw
    wall = build.material((tx.BRICKS, tx.PLANKS, tx.TILES, tx.PLAIN, tx.CELLS), (0.2, 0.5), 0.3)
    roof = build.material((tx.BRICKS, tx.PLANKS, tx.STRIPES), (0.15, 0.4), 0.3)
    dark = build.material((tx.PLAIN,), (0.2, 0.4), 0.1)
    build.materials[dark][tx.COLOR_A : tx.COLOR_A + 3] *= 0.3
    turn = draw.turn()
    a, b, c = size * draw.between(0.9, 1.3), size * draw.between(0.8, 1.3), size * draw.between(0.8, 1.1)
    build.solid(sd.BOX, (x, b, z), (a, b, c), wall, turn)
    reach = 1.15 * np.sqrt(a * a + c * c)
    if draw.chance(0.6):
        build.solid(sd.CONE, (x, 2 * b + 0.5 * size, z), (reach, 0.5 * size, reach), roof, turn)
    else:
        build.solid(sd.BOX, (x, 2 * b + 0.08 * size, z), (1.15 * a, 0.08 * size, 1.15 * c), roof, turn)
    for side in (-0.5, 0.5):
        px, pz = side * a, c
        position = (x + turn[0] * px + turn[1] * pz, 1.1 * b, z - turn[1] * px + turn[0] * pz)
        build.solid(sd.BOX, position, (0.2 * a, 0.3 * b, 0.03 * size), dark, turn)


def _boulder(build: Builder, x: float, z: float, size: float) -> None:
    draw = build.draw
    stone = build.material((tx.NOISE, tx.MARBLE, tx.CELLS, tx.LEAVES), (0.3, 1.0), 0.1)
    a, b, c = size * draw.between(0.7, 1.1), size * draw.between(0.4, 0.8), size * draw.between(0.6, 1.0)
    build.solid(sd.SPHERE, (x, 0.7 * b, z), (a, b, c), stone, draw.turn())


def _pillar(build: Builder, x: float, z: float, size: float) -> None:
    stone = build.material((tx.STRIPES, tx.MARBLE, tx.PLAIN, tx.TILES, tx.CELLS), (0.15, 0.5))
    height, r = size * build.draw.between(1.0, 1.7), 0.35 * size
    build.solid(sd.CYLINDER, (x, height, z), (r, height, r), stone)
    for y in (0.1 * size, 2 * height):
        build.solid(sd.BOX, (x, y, z), (1.4 * r, 0.1 * size, 1.4 * r), stone)


Makers = tuple[Callable[[Builder, float, float, float], None], ...]
INDOORS: Makers = (_stack, _stack, _table, _chair, _lamp, _plant)
OUTDOORS: Makers = (_stack, _tree, _house, _boulder, _pillar, _table)


def _spread(build: Builder, eyes: Float64Array, *, room: bool) -> None:
    """Stand groups of solids on the floor around the middle, none inside another or before a camera."""
    draw, (makers, reach) = build.draw, (INDOORS, 2.3) if room else (OUTDOORS, 3.1)
    taken: list[tuple[float, float, float]] = [(float(x), float(z), CLEARANCE) for x, _, z in eyes]
    for _ in range(5 + draw.below(4)):
        size = draw.between(0.34, 0.72) * (1.0 if room else 1.25)
        for _ in range(12):
            # The first group stands near the middle, where the cameras look.
            wide = reach if len(taken) > len(eyes) else 0.3 * reach
            x, z = draw.between(-wide, wide), draw.between(-wide, wide)
            apart = all((x - a) ** 2 + (z - b) ** 2 > (1.25 * (size + s)) ** 2 for a, b, s in taken)
            if apart and x * x + z * z < reach * reach:
                taken.append((x, z, size))
                makers[draw.below(len(makers))](build, x, z, size)
                break


def _light(draw: Draw, settings: Float64Array, *, room: bool, height: float) -> None:
    strength, warm = draw.between(0.7, 1.3), draw.between(-0.12, 0.16)
    settings[rc.SUN : rc.SUN + 3] = strength * np.array([1.0 + warm, 1.0, 1.0 - 1.4 * warm])
    dim, cool = draw.between(0.3, 0.75), -0.5 * warm
    settings[rc.ABOVE : rc.ABOVE + 3] = dim * np.array([1.0 + cool, 1.0, 1.0 - cool])
    settings[rc.BELOW : rc.BELOW + 3] = dim * draw.between(0.4, 0.75) * np.array([1.05, 1.0, 0.9])
    if room and draw.chance(0.6):
        settings[rc.LIGHT : rc.LIGHT + 3] = [draw.between(-1.5, 1.5), 0.95 * height, draw.between(-1.5, 1.5)]
        settings[rc.NEARBY] = draw.between(0.7, 1.1) * height
        settings[rc.SPREAD] = draw.between(0.05, 0.6)
        return
    (c, s), slant = draw.turn(), draw.between(0.35, 1.3)
    settings[rc.LIGHT : rc.LIGHT + 3] = [slant * c, 1.0, slant * s]
    settings[rc.SPREAD] = draw.between(0.0, 0.16)


def lay_out(draw: Draw, eyes: Float64Array) -> World:
    """Compose one scene around the origin, its floor at y = 0, for cameras at ``eyes`` (views x 3, metres, y up)."""
    room = draw.chance(0.55)
    build = Builder(draw, vividness=draw.between(0.1, 0.75))
    settings, height = np.zeros(rc.SETTING_COLUMNS), draw.between(2.6, 4.2)
    settings[rc.ROOM] = float(room)
    if room:
        build.material((tx.PLANKS, tx.TILES, tx.CHECKER, tx.NOISE, tx.WOOD, tx.STRIPES, tx.MARBLE), (0.25, 0.9), 0.3)
        walls = (tx.PLAIN, tx.PLAIN, tx.BRICKS, tx.STRIPES, tx.NOISE, tx.TILES, tx.DOTS, tx.LEAVES)
        build.material(walls, (0.3, 1.1), 0.35)
        build.material((tx.PLAIN, tx.PLANKS), (0.4, 0.9), 0.1)
        settings[rc.EXTENT : rc.EXTENT + 3] = [draw.between(3.2, 4.8), height, draw.between(3.2, 4.8)]
    else:
        build.material((tx.NOISE, tx.NOISE, tx.LEAVES, tx.CELLS, tx.PLANKS, tx.TILES, tx.BRICKS), (0.5, 1.8), 0.15)
        build.materials[0][tx.GLOSS] = 0.0
        for _ in range(2):
            build.material((tx.PLAIN,), (1.0, 2.0))
        settings[rc.EXTENT] = draw.between(8.0, 12.0)
    _spread(build, eyes, room=room)
    if room and draw.chance(0.6):
        rug = build.material((tx.STRIPES, tx.DOTS, tx.CHECKER, tx.LEAVES, tx.CELLS), (0.2, 0.7))
        place = draw.between(-0.8, 0.8), 0.01, draw.between(-0.8, 0.8)
        half = draw.between(0.9, 1.7), 0.015, draw.between(0.9, 1.7)
        build.solid(sd.BOX, place, half, rug, draw.turn())
    if room:
        _pictures(build, settings, height)
    _light(draw, settings, room=room, height=height)
    haze = draw.between(0.55, 0.95)
    settings[rc.HORIZON : rc.HORIZON + 3] = haze * np.array([0.95, 0.95, 0.92 + draw.between(-0.2, 0.1)])
    blue = draw.between(0.45, 1.0)
    settings[rc.ZENITH : rc.ZENITH + 3] = haze * np.array([0.75 - 0.6 * blue, 0.8 - 0.4 * blue, 0.95])
    settings[rc.CLOUDS] = draw.between(-0.1, 0.6)
    settings[rc.HILLS : rc.HILLS + 3] = draw.color(0.1) * 0.7
    settings[rc.HILL_HEIGHT] = draw.between(0.0, 0.22)
    return World(settings, np.stack(build.solids), np.stack(build.materials))


def _pictures(build: Builder, settings: Float64Array, height: float) -> None:
    """Hang pictures and shelves on the walls."""
    draw = build.draw
    for axis in (0, 2):
        for side in (-1.0, 1.0):
            if draw.chance(0.35):
                continue
            canvas = build.material((tx.LEAVES, tx.CELLS, tx.NOISE, tx.MARBLE, tx.DOTS), (0.3, 1.0), 0.6)
            along, up = draw.between(-1.8, 1.8), draw.between(0.4, 0.6) * height
            half = (draw.between(0.35, 0.8), draw.between(0.3, 0.6), 0.04)
            wall = side * (settings[rc.EXTENT + axis] - 0.03)
            position = (wall, up, along) if axis == 0 else (along, up, wall)
            build.solid(sd.BOX, position, half, canvas, (0.0, 1.0) if axis == 0 else (1.0, 0.0))
