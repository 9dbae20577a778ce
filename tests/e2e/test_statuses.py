"""What the service reads of Statuses: each component's newest, about itself alone."""

from collections.abc import Callable
from contextlib import closing

import pytest

from comotion.runtime.statuses import Statuses
from comotion_schemas import Keys, Status, encode

from .. import builders
from .tracker import until

KEYS = Keys()


def status(component: str, sent: int = 0, **fields: object) -> Status:
    return builders.status(component, **({"role": "source", "counters": {"sent": sent}} | fields))


@pytest.fixture
def reader(router):
    with closing(Statuses(router, KEYS, most=100)) as statuses:
        yield Reader(statuses)


class Reader:
    """Reads until enough has come."""

    def __init__(self, statuses: Statuses) -> None:
        self.statuses = statuses
        self.got: list[tuple[str, int]] = []

    def until(self, fulfilled: Callable[[], bool]) -> None:
        until(fulfilled, self._read)

    def _read(self) -> None:
        found = self.statuses.read()
        assert len(found) <= 16
        self.got += [(one.component, one.counters["sent"]) for one, _ in found]


@pytest.fixture
def put(reader, session):
    return lambda name, one: session.put(KEYS.stream("status", name), encode(one))


def test_of_a_storm_the_newest_is_read_and_others_with_it(reader, put):
    for k in range(3000):
        put("loud", status("loud", k))
    put("quiet", status("quiet", 7))
    reader.until(lambda: {("loud", 2999), ("quiet", 7)} <= set(reader.got))
    # Twice a second at most: what the storm took is some of 3000.
    assert sum(name == "loud" for name, _ in reader.got) < 100
    assert reader.statuses.refused == 0


def test_a_status_about_another_component_is_refused_and_counted(reader, put):
    put("liar", status("cam", 2**31))
    put("cam", status("cam", 5))
    reader.until(lambda: reader.statuses.refused == 1 and bool(reader.got))
    assert reader.got == [("cam", 5)]


def test_what_is_no_status_or_too_large_and_names_beyond_the_bound_are_refused(reader, put, session):
    put("large", status("large", rates={f"stream-{k}": 1.0 for k in range(30_000)}))
    session.put(KEYS.stream("status", "cam"), b"\x00")
    reader.until(lambda: reader.statuses.refused == 2)
    for k in range(300):
        put(f"cam-{k}", status(f"cam-{k}"))
    reader.until(lambda: len(reader.got) + reader.statuses.refused == 302)
    assert len(reader.got) >= 100
