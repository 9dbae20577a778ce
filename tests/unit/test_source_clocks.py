"""How far the clocks of sources are ahead, steps of them, and the correction of stamps."""

from types import SimpleNamespace

import numpy as np
import pytest

from comotion.runtime.source_clocks import SourceClocks
from comotion_schemas import Keys

from ..builders import batch, status

NOW = 1_700_000_000.0
DELAY = 0.002


def clocks(*, correct: bool = True) -> SourceClocks:
    """Without answers to queries but those that a test makes up."""
    session = SimpleNamespace(get=lambda *_, **__: None)
    return SourceClocks(SimpleNamespace(session=session, keys=Keys()), correct=correct)  # type: ignore[arg-type]


def hear(found: SourceClocks, ahead: float, times: int, delays=None) -> None:
    """Statuses of a source whose clock is ahead, and the round trips between them."""
    for k in range(times):
        delay = DELAY if delays is None else delays[k]
        found.on_status(status("cam", "source", stamp_ns=round((NOW + k + ahead) * 1e9)), NOW + k + delay)
        found.on_trip("cam", 2.5 * delay)


@pytest.mark.parametrize("ahead", [0.0, 0.08, -3.0])
def test_the_offset_is_known_within_the_round_trip(ahead) -> None:
    found = clocks()
    hear(found, ahead, 3)
    assert found.offsets()["cam"] == pytest.approx(ahead, abs=2.5 * DELAY)
    assert found.steps == 0


@pytest.mark.parametrize("step", [0.5, -0.5, 0.03, -0.03])
def test_a_clock_that_is_set_is_noticed_once_and_followed(step) -> None:
    found = clocks()
    hear(found, 0.08, 8)
    hear(found, 0.08 + step, 8)
    assert found.steps == 1
    assert f"{step:+.3f}"[:5] in found.notes()[0] or abs(step) < 0.1
    assert found.offsets()["cam"] == pytest.approx(0.08 + step, abs=2.5 * DELAY)


def test_delays_that_vary_and_a_link_that_becomes_slow_are_no_steps() -> None:
    found = clocks()
    rng = np.random.default_rng(3)
    hear(found, 0.0, 40, DELAY + rng.exponential(0.003, 40))
    hear(found, 0.0, 10, np.full(10, 0.3))
    assert found.steps == 0


def test_stamps_are_corrected_if_that_is_wanted() -> None:
    found, kept = clocks(), clocks(correct=False)
    stamp = round(NOW * 1e9)
    original = batch(stamp_ns=stamp, positions=np.zeros((2, 3)), stamps_ns=np.array([stamp - 10, stamp]))
    assert found.correct(original) is original
    for one in (found, kept):
        hear(one, 0.08, 3)
    corrected = found.correct(original)
    assert (stamp - corrected.stamp_ns) / 1e9 == pytest.approx(0.08, abs=2.5 * DELAY)
    assert corrected.stamps_ns.tolist() == [corrected.stamp_ns - 10, corrected.stamp_ns]
    assert kept.correct(original) is original
