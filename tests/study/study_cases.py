"""Studies and answers for the tests."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from anystyle.study.design import Sources, design
from anystyle.study.plan import Plan, Question
from anystyle.study.protocol import Study

HEADER = "participant,item,question,score,ours_is"


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
) -> Sources:
    """Small pictures of every method, of photographs and of styles."""
    random = np.random.default_rng(0)

    def picture(path: Path, size: tuple[int, int] = (48, 36)) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(random.integers(0, 255, (size[1], size[0], 3), dtype=np.uint8)).save(path)

    for scene in range(scenes):
        picture(root / "contents" / f"scene{scene}.png")
        for style in range(styles):
            for method in methods:
                picture(root / method / f"scene{scene}" / f"style{style}.png", (sizes or {}).get(method, (48, 36)))
    for style in range(styles):
        picture(root / "styles" / f"style{style}.png", (30, 50))
    return Sources(
        methods={method: root / method for method in methods},
        ours=methods[0],
        styles=root / "styles",
        contents=root / "contents",
    )


def small_plan(**changes: object) -> Plan:
    options = {"participants": 4, "sets": 4, "attention_checks": 1, "image_size": 64, **changes}
    return Plan(**options)


def small_study(root: Path, **changes: object) -> tuple[Study, Path]:
    """A designed study of four sets for four participants, and its folder."""
    return design(write_results(root), small_plan(**changes), root / "study"), root / "study"
