"""Whatever bytes a file holds, reading it gives a recording or one clear line."""

import io
import tempfile
from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from comotion_sources.errors import RecordingError
from comotion_sources.recordings import read_recording, recording_batches
from comotion_sources.recordings.c3d_parser import NotReadableError, read_header


def _archive() -> bytes:
    buffer = io.BytesIO()
    rng = np.random.default_rng(0)
    np.savez(
        buffer,
        positions=rng.normal(size=(6, 3, 2)),
        times=np.arange(6) / 30,
        labels=np.array([1, 2, 2]),
        label_names=np.array(["", "a", "b"]),
    )
    return buffer.getvalue()


ARCHIVE = _archive()


def _read(content: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "take.npz"
        path.write_bytes(content)
        recording, message = None, ""
        try:
            recording = read_recording(path)
        except RecordingError as error:
            message = str(error)
        assert "\n" not in message
        for batch in recording_batches(recording, split=2) if recording else ():
            assert batch.source in {"replay-1", "replay-2"}


@settings(max_examples=200, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, len(ARCHIVE) - 1), st.integers(0, 255)), min_size=1, max_size=8),
    st.integers(0, len(ARCHIVE)),
)
def test_a_damaged_npz_never_crashes(changes, end):
    content = bytearray(ARCHIVE)
    for place, value in changes:
        content[place] = value
    _read(bytes(content))
    _read(ARCHIVE[:end])


@settings(max_examples=100, deadline=None)
@given(st.binary(max_size=400))
def test_any_bytes_are_refused_as_npz(content):
    _read(content)


@given(st.binary(max_size=2000), st.booleans())
def test_any_bytes_give_a_c3d_header_or_are_refused(content, magic):
    raw = b"\x02\x50" + content.ljust(1200, b"U") if magic else content
    try:
        header = read_header(raw)
    except NotReadableError:
        return
    assert header.processor in {84, 85, 86}
