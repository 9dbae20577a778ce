"""Row 8: a session that ends while the service is away."""

import signal

import pytest

pytestmark = [pytest.mark.e2e, pytest.mark.long, pytest.mark.timeout(900)]


@pytest.mark.parametrize("ends_by", [signal.SIGTERM, signal.SIGKILL])
def test_accounts_across_an_outage_are_right_or_unknown(enter, ends_by) -> None:
    arena = enter()
    service, gone, stays = (arena.processes[name] for name in ("service", "left", "right"))
    session = gone.account["session"]
    service.end()
    arena.watch(3.0)
    gone.signal(ends_by)
    gone.end()
    arena.watch(2.0)
    service.start()
    before = arena.last.session
    arena.until(lambda: arena.last.session != before)
    arena.watch(5.0)
    stays.send({"do": "pause"})
    arena.until(lambda: bool(stays.account.get("paused")))
    arena.watch(4.0)
    accounts = {(one["source"], one["session"]): one for one in arena.accounts()}
    assert accounts["left", session]["lost"] is None
    mine = accounts["right", stays.account["session"]]
    assert mine["batches"] - mine["duplicates"] + mine["lost"] == stays.account["sent"]


def test_a_session_that_ends_while_the_service_listens_is_exact(enter) -> None:
    arena = enter()
    gone = arena.processes["left"]
    arena.watch(2.0)
    session = gone.account["session"]
    gone.end()
    arena.watch(4.0)
    mine = {(one["source"], one["session"]): one for one in arena.accounts()}["left", session]
    assert mine["lost"] == 0
    assert mine["batches"] >= gone.account["sent"]
