"""Every promise is one that a plugin can break: those broken on purpose are found."""

import pytest
from jaxtyping import TypeCheckError

from anystyle.placements import Full
from anystyle.registry.catalog import kinds
from anystyle.testing import composition, subject
from anystyle.testing.composition import Composition
from anystyle.testing.run import promises
from tests.contracts.mutants import COMPOSED, MUTANTS

# Not Exception: a mutant that is itself broken, by a NameError, would count as found.
BROKEN = (AssertionError, pytest.fail.Exception, TypeCheckError, RuntimeError)
CASES = [(kind, cls, name) for kind, rows in MUTANTS.items() for cls, name in rows]


def test_every_kind_has_mutants():
    assert set(MUTANTS) == set(kinds())


@pytest.mark.parametrize(("kind", "cls", "name"), CASES, ids=[f"{kind}-{name}" for kind, _, name in CASES])
def test_a_broken_promise_is_found(kind, cls, name):
    (promise,) = [promise for promise in promises(kind) if promise.__name__ == f"test_{name}"]
    with pytest.raises(BROKEN):
        promise(subject(kind, cls))


@pytest.mark.parametrize(("backbone", "injector", "name"), COMPOSED, ids=[name for *_, name in COMPOSED])
def test_a_broken_composition_is_found(backbone, injector, name):
    parts = (subject("backbone", backbone), subject("placement", Full), subject("injector", injector))
    with pytest.raises(BROKEN):
        getattr(composition, f"test_{name}")(Composition(*parts))
