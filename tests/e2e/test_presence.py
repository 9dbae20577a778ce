"""Which of several services of a scene goes on, where nobody elects one."""

import time
from dataclasses import replace

import pytest

from comotion import Fusion
from comotion.runtime import presence
from comotion.runtime.presence import Presence, SceneTakenError
from comotion_schemas import Keys, encode
from comotion_schemas.component import Component
from comotion_schemas.transport import SessionSettings

from .tracker import DEADLINE

KEYS = Keys()
OTHER = "b" * 16
UPDATE = Fusion(session=OTHER).update(0)
OLD_CLAIM = f"x-{1:016x}-{OTHER}"


@pytest.fixture(autouse=True)
def _impatient(monkeypatch):
    monkeypatch.setattr(presence, "_PATIENCE_S", 0.3)
    monkeypatch.setattr(presence, "_START_S", 0.3)
    monkeypatch.setattr(presence, "_SETTLE_NS", 50_000_000)


@pytest.fixture
def component(free_port_endpoint):
    settings = SessionSettings(mode="router", connect=(), listen=(free_port_endpoint,))
    with Component(role="service", name="fusion", settings=settings, has_token=False) as found:
        yield found


@pytest.fixture
def other(component, free_port_endpoint, connect):
    return connect(free_port_endpoint)


def say(other, seq, session=OTHER):
    other.put(KEYS.hypotheses, encode(replace(UPDATE, seq=seq, session=session)))


def looks(mine, meanwhile, seconds=0.5):
    """Look again and again, as the loop does."""
    end, k = time.monotonic() + seconds, 0
    while time.monotonic() < end:
        meanwhile(k)
        mine.look(time.monotonic_ns())
        k += 1
        time.sleep(0.005)


def test_a_token_alone_makes_nobody_yield(component, other):
    token = other.liveliness().declare_token(KEYS.live("service", OLD_CLAIM))
    with Presence(component) as mine:
        mine.require()
        looks(mine, lambda _: None)
        # Neither does one update that comes again, nor a session without a token.
        looks(mine, lambda _: say(other, 7))
        looks(mine, lambda k: say(other, k, "c" * 16))
        assert mine.epoch == 0
    token.undeclare()


def test_a_service_yields_to_an_older_claim_that_speaks(component, other):
    with Presence(component) as mine:
        mine.require()
        token = other.liveliness().declare_token(KEYS.live("service", OLD_CLAIM))
        with pytest.raises(SceneTakenError, match="already served by 'x'"):
            looks(mine, lambda k: say(other, k), DEADLINE)
        token.undeclare()


def test_a_younger_claim_that_speaks_does_not_matter(component, other):
    with Presence(component) as mine:
        token = other.liveliness().declare_token(KEYS.live("service", f"x-{2**63:016x}-{OTHER}"))
        looks(mine, lambda k: say(other, k))
        assert mine.epoch == 0
        token.undeclare()
