"""Row 3: a source that says what the space of the others is."""

import pytest

from comotion_tools.soak.attacks import NAME

pytestmark = [pytest.mark.e2e, pytest.mark.long, pytest.mark.timeout(900)]


def test_an_empty_batch_claims_no_space(enter) -> None:
    arena = enter(held=True)
    with arena.attacked_by("claim", 60.0):
        arena.watch(3.0)
        arena.begin()
    assert all(not one["rejected"] for one in arena.accounts() if one["source"] != NAME)


def test_one_source_makes_no_space_a_carried_one(fair, enter) -> None:
    fair("carry")


def test_after_that_the_space_is_at_rest(enter) -> None:
    arena = enter()
    arena.attack("carry", 3.0)
    assert arena.last is not None
    assert not arena.last.frames
