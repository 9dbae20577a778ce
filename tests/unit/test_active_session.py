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


def test_a_leap_of_the_epoch_is_not_followed() -> None:
    heard = [("a", 7, 0.0), ("e", 2**64 - 1, 0.1), ("e", 1008, 0.2), ("a", 7, 0.3), ("b", 1007, 0.4)]
    assert accepted(*heard) == [True, False, False, True, True]


def test_after_ten_seconds_without_an_update_any_epoch_is_followed() -> None:
    # Updates that are not heard keep nothing alive.
    heard = [("e", 2**64 - 1, 0.0), ("a", 7, 9.9), ("e", 2, 9.9), ("a", 7, 10.1), ("a", 8, 10.2)]
    assert accepted(*heard) == [True, False, False, True, True]
