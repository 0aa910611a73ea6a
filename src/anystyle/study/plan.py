"""What a study asks, of how many: the part that a configuration file holds."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from anystyle.errors import did_you_mean
from anystyle.study.contract import Scale


@dataclass(frozen=True)
class Question:
    """A question asked of every set.

    Args:
        name: As it stands in the answers.
        text: As participants read it.
    """

    name: str
    text: str


@dataclass(frozen=True)
class Plan:
    """The sizes and the words of a study.

    Args:
        title: Of the page.
        instructions: What participants read first; paragraphs are separated by blank lines.
        participants: How many there will be; even, so that every set is seen in both positions equally often.
        sets: How many sets each one judges; even, so that ours is A in half of them.
        questions: Asked of every set.
        labels: The answers from low to high; the first says that A is much better.
        low: The lowest score.
        attention_checks: How many sets tell the participant what to answer.
        image_size: The longer side of every picture, in pixels.
        seed: Of every draw.
    """

    title: str = "Comparison of stylized images"
    instructions: str = (
        "You will see a photograph, a style, and two pictures A and B: the photograph in that style, made by two "
        "methods. Please answer the questions below each pair.\n\nThere are no right or wrong answers. Your answers "
        "are kept after every step: you may close the page and go on later on the same device."
    )
    participants: int = 40
    sets: int = 20
    questions: tuple[Question, ...] = (
        Question("style", "Which picture matches the style better?"),
        Question("content", "Which picture preserves the content of the photograph better?"),
        Question("overall", "Which picture do you prefer overall?"),
    )
    labels: tuple[str, ...] = ("A is much better", "A is better", "No difference", "B is better", "B is much better")
    low: int = 1
    attention_checks: int = 2
    image_size: int = 512
    seed: int = 0

    def __post_init__(self) -> None:
        if self.participants < 2 or self.participants % 2:
            near = max(2, self.participants - 1)
            raise ValueError(
                f"{self.participants} participants cannot see every set in both positions equally often; "
                f"plan an even number, such as {near} or {near + 2}"
            )
        if self.sets < 2 or self.sets % 2:
            near = max(2, self.sets - 1)
            raise ValueError(
                f"with {self.sets} sets ours cannot be A in half of them; plan an even number, such as {near} or "
                f"{near + 2}"
            )
        names = [question.name for question in self.questions]
        if not names or len(set(names)) < len(names) or not all(name.isidentifier() for name in names):
            raise ValueError(f"questions are named {names}; expected different names of letters, digits and '_'")
        if len(self.labels) < 2 or not all(label.strip() for label in self.labels):
            raise ValueError(f"{len(self.labels)} labels; expected one for each of at least two answers")
        if not 0 <= self.attention_checks <= self.sets // 2:
            raise ValueError(f"attention_checks={self.attention_checks}; expected 0 to {self.sets // 2}, half the sets")
        if not 64 <= self.image_size <= 4096:
            raise ValueError(f"image_size={self.image_size}; expected 64 to 4096 pixels")

    @property
    def scale(self) -> Scale:
        """The answer scale."""
        return Scale(float(self.low), float(self.low + len(self.labels) - 1))


def plan_from(options: Mapping[str, Any]) -> Plan:
    """A plan from a configuration's plain values, each of the right type.

    Raises:
        ValueError: An option is unknown or of the wrong type, or the plan cannot be balanced.
    """
    field_types = {field.name: field.type for field in fields(Plan)}
    for name, value in options.items():
        if name not in field_types:
            names = ", ".join(sorted(field_types))
            raise ValueError(f"a study has no option {name!r}.{did_you_mean(name, field_types)} Options: {names}")
        expected = field_types[name]
        is_integer = isinstance(value, int) and not isinstance(value, bool)
        if (expected is int and not is_integer) or (expected is str and not isinstance(value, str)):
            raise ValueError(f"{name}={value!r}; expected {'a whole number' if expected is int else 'text'}")
    values = dict(options)
    if "questions" in values:
        values["questions"] = tuple(_question(item) for item in _list("questions", values["questions"]))
    if "labels" in values:
        values["labels"] = tuple(str(label) for label in _list("labels", values["labels"]))
    return Plan(**values)


def _list(name: str, value: Any) -> list[Any]:
    if not isinstance(value, (list, tuple)):
        raise ValueError(f"{name}={value!r}; expected a list")
    return list(value)


def _question(item: Any) -> Question:
    if not isinstance(item, Mapping) or set(item) != {"name", "text"}:
        raise ValueError(f"question {item!r}; expected a name and a text")
    return Question(str(item["name"]), str(item["text"]))
