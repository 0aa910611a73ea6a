"""A job: the JSON file that a method's process reads, and what it writes."""

from msgspec import Struct, field

SECONDS, WEIGHTS = "seconds.json", "weights.json"


class AskedStyle(Struct, frozen=True):
    """A style: the path of an image, or a text."""

    name: str
    image: str | None = None
    text: str | None = None


class Job(Struct, frozen=True):
    """A scene in some styles.

    Args:
        track: Name of the track.
        scene: Name of the scene.
        photographs: Paths of all its photographs by their stems, in the order of the capture.
        views: Stems of the photographs at whose cameras images are rendered.
        size: Height and width of these images in pixels.
        styles: In which the scene is wanted.
        seed: For whatever is random.
        out: Folder for ``STYLE/VIEW.png``, 8-bit RGB; a method may also write :class:`Seconds` as ``seconds.json``, and
            the SHA-256 of its networks' files by their names as ``weights.json``.
    """

    track: str
    scene: str
    photographs: dict[str, str]
    views: tuple[str, ...]
    size: tuple[int, int]
    styles: tuple[AskedStyle, ...]
    seed: int
    out: str


class Seconds(Struct, frozen=True):
    """CPU seconds per scene, and of each style; a method may write them.

    Without them the seconds of the whole process are divided evenly by its styles. ``scene`` is ``None`` where the work
    per scene was reused, such as the fit of an earlier method.
    """

    scene: float | None = 0.0
    styles: dict[str, float] = field(default_factory=dict)
