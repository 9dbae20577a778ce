"""Bounds of docs/limits.md that no other test shows, and that every sentence there has a test."""

import json
import re
import time
from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest

from comotion import Fusion, FusionConfig
from comotion.event_time.faults import Faults
from comotion.event_time.stats import MAX_ACCOUNTS, Ledger, Stats
from comotion.runtime import output
from comotion.runtime.health import Problems
from comotion.runtime.log_limit import limited
from comotion.runtime.output import Output
from comotion.tracks import MAX_ENDED, Tracks
from comotion.trajectories.window import Window
from comotion_schemas import Keys
from comotion_schemas.keys import QueryName

from ..builders import MS, T0, S, batch

ROOT = Path(__file__).parents[2]
SHOWN = re.findall(
    r"^\| ([^|]+) \| (`(?:unit|property|e2e|adversary)/[^|]+) \|$",
    Path(__file__).with_name("limits_shown.md").read_text(),
    re.MULTILINE,
)


def sentences():
    """What docs/limits.md says: the first cells of its rows, and its sentences but definitions and links."""
    for part in re.split(r"\n\n+", (ROOT / "docs/limits.md").read_text()):
        if part.startswith("|"):
            cells = [line.split(" | ")[0].removeprefix("| ") for line in part.splitlines()]
            yield from cells[2:]
        elif not part.startswith("#"):
            sentences = re.split(r"(?<=[.:;]) (?=[A-Z`[*])", " ".join(part.split()))
            yield from (sentence for sentence in sentences if not sentence.startswith(("[", "*", "sent =")))


@pytest.mark.parametrize("sentence", list(sentences()))
def test_what_is_said_of_a_bound_has_a_test(sentence):
    assert any(sentence == what or sentence.startswith(f"{what} ") for what, _ in SHOWN)


@pytest.mark.parametrize(("what", "tests"), SHOWN, ids=[what for what, _ in SHOWN])
def test_what_shows_it_is_there(what, tests):
    assert any(f"{sentence} ".startswith(f"{what} ") for sentence in sentences()), (
        "docs/limits.md does not say so"
    )
    named = re.findall(r"`([a-z0-9_/]+\.py)`: ((?:`[a-z0-9_]+`(?:, )?)+)", tests)
    assert named
    for where, names in named:
        text = (ROOT / "tests" / where).read_text()
        for name in re.findall(r"`([a-z0-9_]+)`", names):
            assert f"def {name}(" in text, (where, name)


def test_accounts_of_the_sessions_seen_last_are_kept_and_the_totals_hold_all():
    ledger = Ledger(Stats())
    ledger.book(("waits", ""), {"batches": 1, "waiting": 1})
    for k in range(MAX_ACCOUNTS + 10):
        ledger.book(("cam", f"{k:016x}"), {"batches": 1, "limit": 1})
    accounts = ledger.accounts
    assert len(accounts) == MAX_ACCOUNTS
    assert ("waits", "") in accounts
    assert ("cam", f"{MAX_ACCOUNTS + 9:016x}") in accounts
    assert ledger.total.batches == MAX_ACCOUNTS + 11


def test_of_ids_that_have_ended_the_newest_are_remembered():
    tracks = Tracks(Window(3, S, S), None, Stats(), None)
    tracks.end(np.arange(MAX_ENDED, dtype=np.uint64), 1)
    tracks.end(np.arange(MAX_ENDED, MAX_ENDED + 5, dtype=np.uint64), 1)
    ((session, ids),) = tracks.state()["ended"]
    assert (session, ids.tolist()) == (1, list(range(5, MAX_ENDED + 5)))


class TestSpaces:
    def run(self, fusion: Fusion, seconds: float, space: str, source: str) -> None:
        start = fusion.timeline.at_ns or T0
        for k in range(round(seconds * 5)):
            now = start + (k + 1) * 200 * MS
            fusion.ingest(batch(source, now // (200 * MS), now, space=space))
            fusion.update(now)

    def test_one_without_data_for_5_s_gives_way_to_another(self, monkeypatch):
        monkeypatch.setattr("comotion.spaces._MAX_SPACES", 2)
        fusion = Fusion()
        self.run(fusion, 1, "one", "a")
        self.run(fusion, 1, "two", "b")
        self.run(fusion, 1, "three", "c")
        assert sorted(fusion.spaces) == ["one", "two"]
        self.run(fusion, 4, "two", "b")
        self.run(fusion, 1, "three", "c")
        assert sorted(fusion.spaces) == ["three", "two"]

    def test_one_that_is_empty_is_forgotten_after_60_s(self):
        fusion = Fusion()
        self.run(fusion, 1, "one", "a")
        # Without any source event time stands still, and nothing leaves the window.
        self.run(fusion, 58, "two", "b")
        assert sorted(fusion.spaces) == ["one", "two"]
        self.run(fusion, 4, "two", "b")
        assert list(fusion.spaces) == ["two"]


class TestQueries:
    """A session whose queryables give what waits."""

    def declared(self, handler, monkeypatch):
        self.replies: list[bytes] = []
        self.waiting = {"config": 3, "schema": 1}
        monkeypatch.setattr(output, "declare_publisher", lambda *_: None)
        component = SimpleNamespace(session=self, keys=Keys())
        declared = Output(component, None, {"config": handler, "schema": handler}, Faults(Stats()))
        declared._switch(0)
        return declared

    def declare_queryable(self, key, ring):
        name = key.rpartition("/")[2]

        def try_recv():
            self.waiting[name] -= 1
            return None if self.waiting[name] < 0 else self

        return SimpleNamespace(try_recv=try_recv)

    parameters = ""

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def reply(self, *key_and_payload, encoding):
        self.replies.append(key_and_payload[-1])

    reply_err = reply

    def test_one_is_answered_in_any_case_and_the_names_have_turns(self, monkeypatch):
        queryables = self.declared(lambda _: (b"done", "text/plain"), monkeypatch)
        queryables.answer(1)
        assert (self.replies, self.waiting) == ([b"done"], {"config": 2, "schema": 1})
        queryables.answer(1)
        assert (len(self.replies), self.waiting) == (2, {"config": 2, "schema": 0})
        queryables.answer(10**9)
        assert len(self.replies) == 4

    def test_64_of_a_name_wait(self, monkeypatch):
        rings = []
        monkeypatch.setattr(output, "RingChannel", rings.append)
        self.declared(None, monkeypatch)
        assert rings == [64, 64]

    def test_a_reply_that_is_too_large_and_a_defect_are_errors_that_say_so(self, monkeypatch):
        monkeypatch.setattr(output, "MAX_BYTES", 3)
        self.declared(lambda _: (b"done", "text/plain"), monkeypatch).answer(10**9)
        assert set(self.replies) == {b"the answer has 4 bytes, the limit is 3"}
        self.declared(lambda _: 1 / 0, monkeypatch).answer(10**9)
        assert set(self.replies) == {b"internal error: ZeroDivisionError('division by zero')"}

    def test_affinities_of_too_many_trajectories_are_refused_before_they_are_computed(self, monkeypatch):
        fusion = Fusion()
        fusion.ingest(batch("cam", 0, T0, np.zeros((5, 3))))
        fusion.update(T0)
        monkeypatch.setattr(output, "MAX_BYTES", 99)
        monkeypatch.setattr(fusion, "affinity", None)
        answers = output.handlers(fusion, lambda: fusion.update(T0), lambda: None)
        with pytest.raises(output.QueryError, match="5 trajectories exceed"):
            answers["affinity"]({})


def test_a_session_of_which_nobody_knows_is_null_in_the_accounts():
    fusion = Fusion()
    for name in ("gone", "stays"):
        fusion.ingest(batch(name, 0, T0))
    fusion.update(T0)
    fusion = Fusion.restore(FusionConfig(), fusion.snapshot())
    fusion.ingest(batch("stays", 3, T0 + S))
    handlers = output.handlers(fusion, lambda: fusion.update(T0), lambda: None)
    assert set(handlers) == set(get_args(QueryName))
    payload, _ = handlers["accounts"]({})
    assert {account["source"]: account["lost"] for account in json.loads(payload)["accounts"]} == {
        "gone": None,
        "stays": 2,
    }


def test_of_many_problems_64_are_listed():
    problems = Problems()
    kinds = ("silent", "no-data", "limit", "scale", "drifts")
    texts = {(f"cam-{k}", kind): "no data" for kind in kinds for k in range(200)}
    # A storm of one kind leaves room for the others.
    assert Counter(problem.kind for problem in problems.update(texts, 0)) == dict.fromkeys(kinds[:4], 16)
    assert problems.update({}, 11 * S) == []


def test_lines_are_left_out_and_one_says_how_many(caplog, monkeypatch):
    times, logger = [0.0], limited("comotion.test")
    monkeypatch.setattr(time, "monotonic", lambda: times[0])
    for k in range(25):
        logger.warning("again %d", k)
    logger.warning("of another kind")
    times[0] = 61.0
    logger.warning("again %d", 25)
    last = ["of another kind", "5 more lines like these were left out", "again 25"]
    assert caplog.messages == [*(f"again {k}" for k in range(20)), *last]
