"""Studies and answers for the tests."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from anystyle_study.contract import Responses
from anystyle_study.design import Sources, design
from anystyle_study.protocol import Plan, Study, plan_from
from tests.support.pictures import save

HEADER = "participant,item,question,score,ours_is"

LOADED = "!!document.querySelector('[data-loaded]')"
"""A set of the form is shown, with every picture."""


def answer_rows(
    people: int = 12, items: int = 6, questions: Sequence[str] = ("style",), shift: float = -0.5, seed: int = 0
) -> list[tuple[str, str, str, int, str]]:
    """Answers as participants give them, ours as A in a checkerboard."""
    random = np.random.default_rng(seed)
    rows = []
    for question in questions:
        latent = shift + random.normal(0, 1, (people, items)) + random.normal(0, 0.4, (people, 1))
        deviations = np.clip(np.round(latent), -2, 2).astype(int)
        for person in range(people):
            for item in range(items):
                ours_is_a = (person + item) % 2 == 0
                score = 3 + deviations[person, item] * (1 if ours_is_a else -1)
                rows.append((f"P{person:02d}", f"S{item:02d}", question, int(score), "A" if ours_is_a else "B"))
    return rows


def table(deviations, ours_is_a=None) -> Responses:
    """Responses of a complete table, participants by items."""
    deviations = np.asarray(deviations, dtype=float)
    people, items = deviations.shape
    participant, item = np.divmod(np.arange(people * items), items)
    return Responses(
        question="style",
        deviations=deviations.ravel(),
        participants=participant,
        items=item,
        ours_is_a=None if ours_is_a is None else np.asarray(ours_is_a).ravel(),
        participant_names=tuple(f"P{index}" for index in range(people)),
        item_names=tuple(f"S{index}" for index in range(items)),
    )


def write_csv(path: Path, rows: Sequence[Sequence[object]], header: str = HEADER) -> Path:
    path.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows)]) + "\n", encoding="utf-8")
    return path


def write_results(
    root: Path,
    *,
    methods: Sequence[str] = ("ours", "other"),
    scenes: int = 4,
    styles: int = 3,
    sizes: Mapping[str, tuple[int, int]] | None = None,
    frames: int = 0,
) -> Sources:
    """Small pictures of every method, of photographs and of styles; with ``frames``, as many views of each."""
    random = np.random.default_rng(0)

    def picture(path: Path, size: tuple[int, int] = (48, 36), frames: int = frames) -> None:
        if frames:
            for frame in range(frames):
                picture(path.with_suffix("") / f"{frame:03d}.png", size, 0)
            return
        save(path, random.integers(0, 255, (size[1], size[0], 3), dtype=np.uint8))

    for scene in range(scenes):
        picture(root / "contents" / f"scene{scene}.png")
        for style in range(styles):
            for method in methods:
                picture(root / method / f"scene{scene}" / f"style{style}.png", (sizes or {}).get(method, (48, 36)))
    for style in range(styles):
        picture(root / "styles" / f"style{style}.png", (30, 50), 0)
    folders = {method: root / method for method in methods}
    return Sources(methods=folders, ours=methods[0], styles=root / "styles", contents=root / "contents")


AB = ("A is much better", "A is better", "No difference", "B is better", "B is much better")
QUESTIONS = (
    {"name": "style", "text": "Which matches <b>the style</b> better?", "labels": AB},
    {"name": "content", "kind": "rating", "text": "How easy to recognize is {method}?", "labels": ("Hard", "", "Easy")},
)


def small_plan(**changes: object) -> Plan:
    options = {"instructions": "Look.\n\nAnswer.", "questions": QUESTIONS, "participants": 4, "sets": 4, "degraded": 1}
    return plan_from({**options, "image_size": 64, **changes})


def small_study(root: Path, frames: int = 0, **changes: object) -> tuple[Study, Path]:
    """A designed study of four sets for four participants, and its folder."""
    return design(write_results(root, frames=frames), small_plan(**changes), root / "study"), root / "study"


def begin(page, url, clear=True):
    """Open the form as in a browser that has never been there, and begin."""
    page.goto(url)
    if clear:
        page.evaluate("localStorage.clear()")
    page.click("#start")
