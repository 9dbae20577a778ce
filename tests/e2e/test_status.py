"""`comotion status` on a running scene, by its exit status and its output."""

import json
import time
from dataclasses import replace

import pytest
import zenoh

from comotion_deploy.cli import run
from comotion_schemas import Keys, Status, encode
from comotion_schemas.component import Component, StatusFields
from comotion_schemas.transport import SessionSettings, declare_publisher
from comotion_tools.soak import load

from ..command_line import refused
from .conftest import KEYS, TWO_BODIES

AHEAD_S = 0.5


def cam_ahead(component: Component) -> Status:
    """The Status of the source cam, on a host whose clock is ahead."""
    now = component.status()
    return replace(now, component="cam", role="source", stamp_ns=now.stamp_ns + round(AHEAD_S * 1e9))


def test_a_scene_from_nothing_to_well_and_a_wrong_clock(endpoint, start, session, capsys):
    look = ("status", "--connect", endpoint)
    assert run(list(look)) == 3
    assert "no service" in capsys.readouterr().out
    waiting = start(*look, "--wait", "ok", "--timeout", 100, "--expect", "cam", "--json", ready=False)
    settings = SessionSettings(connect=(endpoint,))
    fields = StatusFields(rates={"cam": 30.0})
    with Component(role="service", name="fusion", settings=settings, status=lambda: fields) as service:

        def answer(query: zenoh.Query) -> None:
            with query:
                query.reply(KEYS.query("status"), encode(service.status()))

        queryable = service.session.declare_queryable(KEYS.query("status"), answer)
        with Component(role="source", name="cam", settings=settings):
            assert waiting.wait() == 0
            state = json.loads(waiting.output)
            assert [row["name"] for row in state["components"]] == ["fusion", "cam"]
            assert [router["locators"] for router in state["routers"]] == [[endpoint]]
            for row in state["components"]:
                assert abs(row["clock_s"]) <= row["clock_error_s"] + 0.1
                assert row["version"]
                assert row["host"]
            publisher = declare_publisher(session, Keys().stream("status", "cam"), "status")
            looking = start(*look, ready=False)
            while looking.is_running:
                publisher.put(encode(cam_ahead(service)))
                time.sleep(0.1)
            assert looking.wait() == 1
            assert "ms ahead of the service's, more than half a frame (17 ms)" in looking.output
        queryable.undeclare()


def test_no_router_is_an_error(free_port_endpoint, capsys):
    assert "no router answers" in refused(capsys, "status", "--connect", free_port_endpoint, "--timeout", 0.5)


@pytest.mark.long
def test_a_source_with_a_wrong_clock_is_measured_and_corrected(serve, start):
    service = serve("--correct-clocks", "--no-state")
    start.any(*load.command(service.endpoint, "default", "ahead", replace(TWO_BODIES, ahead_s=0.4)))
    status = service.statuses.until(lambda status: status.clock_offsets.get("ahead", 0.0) > 0.3)
    assert abs(status.clock_offsets["ahead"] - 0.4) < 0.1
    # Its stamps are no longer those of the future.
    service.statuses.until(lambda status: status.ages.get("ahead", -1.0) > 0.0)
