#!/usr/bin/env bash
# openskill 6.2.0 and trueskill 0.4.5: of the same thirty answers, read from the other end, the other method is best.
#
# Two methods in a user study: 18 of 30 people prefer a to b, 12 b to a. Ratings of a and b (and their spread) where
# those for a come first in the table, where they come last, and in how many of 300 random orders a is above b:
#                                    a's first           a's last            a above b
#   trueskill, rate_1vs1             20.5, 29.5 (2.4)    30.6, 19.4 (2.3)    90 %
#             tau=0                  20.5, 29.5          30.6, 19.4          90 %
#   openskill, PlackettLuce          17.9, 32.1 (5.1)    35.1, 14.9 (5.0)    84 %
#              with tau=0            17.9, 32.1          35.1, 14.9          84 %
#              Thurstone-Mosteller   18.1, 31.9 (3.8)   33.0, 17.0 (3.8)    73 %
#   Bradley-Terry of all at once     a, by 0.41 in log odds, whatever the order
# Both follow players who learn: what was answered last counts most, with a fixed skill (tau=0), too, so a table that is
# sorted by answer, method or participant decides. No warning. Fit all answers at once.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet trueskill==0.4.5 openskill==6.2.0 choix==0.4.1 scipy==1.17.1 numpy==2.4.6
env/bin/python -W error::UserWarning - <<'PYTHON'
import choix
import numpy as np
import trueskill
from openskill.models import PlackettLuce, ThurstoneMostellerFull

answers = np.array([True] * 18 + [False] * 12)  # whether a is preferred


def by_trueskill(answers, **options):
    world = trueskill.TrueSkill(draw_probability=0, **options)
    a, b = world.create_rating(), world.create_rating()
    for for_a in answers:
        if for_a:
            a, b = world.rate_1vs1(a, b)
        else:
            b, a = world.rate_1vs1(b, a)
    return a.mu, b.mu, a.sigma


def by_openskill(answers, model=PlackettLuce, **options):
    world = model(**options)
    a, b = world.rating(), world.rating()
    for for_a in answers:
        [[a], [b]] = world.rate([[a], [b]], ranks=[1, 2] if for_a else [2, 1])
    return a.mu, b.mu, a.sigma


for title, rated, first, last, share in (
    ("trueskill", by_trueskill, (20.5, 29.5, 2.4), (30.6, 19.4, 2.3), 0.90),
    ("trueskill, tau=0", lambda x: by_trueskill(x, tau=0), (20.5, 29.5, 2.4), (30.6, 19.4, 2.3), 0.90),
    ("PlackettLuce", by_openskill, (17.9, 32.1, 5.1), (35.1, 14.9, 5.0), 0.84),
    ("PlackettLuce, tau=0", lambda x: by_openskill(x, tau=0), (17.9, 32.1, 5.1), (35.1, 14.9, 5.0), 0.84),
    ("Thurstone", lambda x: by_openskill(x, ThurstoneMostellerFull), (18.15, 31.85, 3.8), (33.0, 17.0, 3.8), 0.73),
):
    random = np.random.default_rng(0)
    orders = [rated(random.permutation(answers)) for _ in range(300)]
    above = np.mean([a > b for a, b, _ in orders])
    found = rated(answers), rated(answers[::-1])
    print(f"{title:20} first {np.round(found[0], 1)}, last {np.round(found[1], 1)}, a above b in {above:.0%}")
    assert np.allclose(found[0], first, atol=0.1) and np.allclose(found[1], last, atol=0.1)
    assert abs(above - share) < 0.07

for order in (answers, answers[::-1]):
    pairs = [(0, 1) if for_a else (1, 0) for for_a in order]
    fitted = choix.opt_pairwise(2, pairs)
    print("all at once:", fitted[0] - fitted[1])
    assert abs(fitted[0] - fitted[1] - np.log(18 / 12)) < 1e-3
PYTHON
echo "as described"
