"""Text from outside, whatever it holds: nothing that shows it obeys it."""

import io
import logging
import re
from importlib.util import find_spec

import msgpack
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from rich.console import Console

from comotion_clients.scene_model import SceneModel
from comotion_clients.status import show
from comotion_clients.viewing.paths import plain
from comotion_clients.watch_view import WHOLE, plain_line, render
from comotion_schemas import DecodeError, Status, decode, encode
from comotion_schemas.text import LogFormatter, shown
from comotion_tools.soak.attacks import MARKUP

from .. import builders
from ..builders import SESSION

# All planes but lone surrogates, which are no UTF-8; those that formats and terminals obey come often.
texts = st.text(
    st.sampled_from("[]/\\<>!`*|\x1b\x9b\r\n\t\x00\u202e\u2066\u200b\u2028 ab")
    | st.characters(exclude_categories=("Cs",)),
    max_size=60,
)


def status(text, **changes):
    """As it arrives: what the sender has checked is not relied on."""
    fields = {
        "schema": "comotion.Status/1", "component": "fusion", "role": "service", "session": SESSION,
        "stamp_ns": 0, "state": "degraded", "rates": {text: 1.0}, "ages": {text: 1.0},
        "counters": {text: 1}, "rejected": {}, "message": text, "version": text, "host": text,
        "clock_offsets": {text: 0.5},
        "problems": [{"kind": "limit", "since_ns": 0, "text": text}],
    }  # fmt: skip
    decoded = decode(msgpack.packb(fields | changes))
    assert isinstance(decoded, Status)
    return decoded


def lines_of(*what):
    """What a console prints, all in one line each."""
    out = io.StringIO()
    console = Console(file=out, width=2000, color_system=None)
    for one in what:
        console.print(one)
    lines = out.getvalue().split("\n")
    assert all(line.isprintable() for line in lines)
    return lines


@given(texts, st.integers(1, 80))
@example(MARKUP, 500)
def test_what_is_shown_has_glyphs_only_and_is_bounded_and_stays_as_it_is(text, most):
    printed = shown(text, most)
    assert printed.isprintable()
    assert len(printed) <= most
    assert shown(printed, most) == printed
    if text.isprintable() and len(text) <= most:
        assert printed == text


@given(texts)
@example(MARKUP)
def test_every_text_of_a_decoded_status_can_be_shown(text):
    received = status(text)
    maps = (received.rates, received.ages, received.counters, received.clock_offsets)
    given_ = [
        received.message,
        received.version,
        received.host,
        received.problems[0].text,
        *(k for m in maps for k in m),
    ]
    assert given_ == [shown(text)] * 8


@given(texts.filter(lambda text: not text.isprintable()))
@example(MARKUP)
def test_a_space_whose_name_cannot_be_shown_is_refused(space):
    content = msgpack.unpackb(encode(builders.batch())) | {"space": space}
    with pytest.raises(DecodeError) as refusal:
        decode(msgpack.packb(content))
    assert refusal.value.reason == "schema"
    assert str(refusal.value).isprintable()


@given(texts)
@example(MARKUP)
def test_status_prints_texts_as_they_are_each_in_its_line(text):
    model = SceneModel("lab")
    model.on_presence("service", "fusion", alive=True)
    model.on_status(status(text), 0.0)
    model.on_router(
        {"zid": text, "version": text, "metadata": {"name": text, "host": text}, "locators": [text] * 99}
    )
    received = model.status(0.0)
    out = io.StringIO()
    show(received, Console(file=out, width=4000, color_system=None))
    lines = out.getvalue().split("\n")
    assert all(line.isprintable() for line in lines)
    # The row of a router begins with its name.
    marked = len(received.problems) + shown(text, 80).strip().startswith("!")
    assert sum(line.startswith("! ") for line in lines) in {len(received.problems), marked}
    assert any(shown(text, 80).strip() in line for line in lines)


@given(texts.filter(bool))
@example(MARKUP)
def test_watch_and_the_page_of_a_viewer_show_texts_as_they_are(text):
    space = shown(text) or "x"
    model = SceneModel("lab")
    model.on_status(status(text))
    model.on_batch(builders.batch(space=space), 0.0, 0)
    snapshot = model.snapshot(0.0)
    lines = lines_of(render(snapshot, 160, WHOLE, "size", keys=False))
    assert any(line.rstrip().endswith(f"limit {shown(text)}".rstrip()) for line in lines)
    assert any(line.startswith("cam") and shown(space)[:5].strip() in line for line in lines)
    assert plain_line(snapshot).isprintable()
    if find_spec("rerun") is None:
        return
    from comotion_clients.viewing.health import summary

    page = list(summary(snapshot))
    assert all(plain(line).isprintable() for line in page)
    assert not re.search(r"(?<!\\)[\[\]<>!`]", next(line for line in page if line.startswith("|cam|")))


@given(texts)
@example(MARKUP)
def test_a_log_line_is_one_line_and_a_trace_is_indented(text):
    formatter = LogFormatter("%(levelname)s: %(message)s")
    record = logging.LogRecord("x", logging.WARNING, "x.py", 1, "rejected %s", (text,), None)
    assert formatter.format(record).isprintable()
    try:
        raise ValueError(text)
    except ValueError as error:
        record.exc_info = ValueError, error, error.__traceback__
    first, *trace = formatter.format(record).split("\n")
    assert first.startswith("WARNING: rejected")
    assert all(line.startswith("  ") and line.isprintable() for line in trace)
