"""Which of several services a client hears."""

from dataclasses import replace

from comotion import Fusion
from comotion_clients.active_session import ActiveSession

UPDATE = Fusion().update(0)


def accepted(*heard: tuple[str, int, float]) -> list[bool]:
    active = ActiveSession()
    return [
        active.accepts(replace(UPDATE, session=session * 16, epoch=epoch), now)
        for session, epoch, now in heard
    ]


def test_a_new_session_is_followed_and_the_one_before_is_not_heard_beside_it() -> None:
    heard = [("a", 0, 0.0), ("b", 0, 0.1), ("a", 0, 0.2), ("b", 0, 0.3), ("a", 0, 1.2)]
    assert accepted(*heard) == [True, True, False, True, False]


def test_an_older_session_is_heard_again_when_the_newer_is_silent() -> None:
    assert accepted(("a", 0, 0.0), ("b", 0, 0.1), ("a", 0, 1.2), ("b", 0, 1.3)) == [True, True, True, False]


def test_a_higher_epoch_is_followed_and_a_lower_one_never() -> None:
    assert accepted(("a", 1, 0.0), ("b", 2, 0.1), ("a", 1, 9.0), ("a", 3, 9.1)) == [True, True, False, True]
