"""Keys and quality of service are those of the protocol."""

import pytest

from comotion_schemas import MESSAGE_TYPES, QOS, Keys
from comotion_schemas.keys import kind_of, last_chunk


def test_keys_are_those_of_the_protocol():
    keys = Keys("lab")
    assert Keys().prefix == "comotion/@v1/default"
    assert keys.stream("obs", "cam-1") == "comotion/@v1/lab/obs/cam-1"
    assert keys.streams("truth") == "comotion/@v1/lab/truth/*"
    assert keys.hypotheses == "comotion/@v1/lab/hypotheses"
    assert keys.live("source", "cam-1") == "comotion/@v1/lab/live/source/cam-1"
    assert keys.all_live() == "comotion/@v1/lab/live/*/*"
    assert keys.query("affinity") == "comotion/@v1/lab/query/affinity"


@pytest.mark.parametrize("name", ["", "A", "a/b", "a b", "ä", "a\n", "*", "$*", "@v1", "x" * 65])
def test_a_name_is_one_chunk_of_plain_characters(name):
    with pytest.raises(ValueError, match="1 to 64 characters"):
        Keys(name)
    with pytest.raises(ValueError, match="1 to 64 characters"):
        Keys().stream("obs", name)
    with pytest.raises(ValueError, match="1 to 64 characters"):
        Keys().live("source", name)


@pytest.mark.parametrize(
    ("key", "kind"),
    [
        ("comotion/@v1/lab/obs/cam", "obs"),
        ("comotion/@v1/lab/status/fusion", "status"),
        ("comotion/@v1/lab/hypotheses", "hypotheses"),
        ("comotion/@v1/lab/live/source/cam", None),
        ("comotion/@v2/lab/obs/cam", None),
        ("obs/cam", None),
    ],
)
def test_the_kind_of_a_key_is_read_off_it(key, kind):
    assert kind_of(key) == kind
    assert last_chunk(key) == key.split("/")[-1]


def test_every_message_has_one_quality_of_service_and_none_blocks():
    assert sorted(qos.message for qos in QOS.values()) == sorted(kind.__name__ for kind in MESSAGE_TYPES)
    assert {qos.congestion for qos in QOS.values()} == {"DROP"}
    assert QOS["obs"].encoding == "application/msgpack;comotion.ObservationBatch/1"
    # A late joiner gets the last update and all truths, but no observations of the past.
    assert QOS["hypotheses"].cache == 1
    assert QOS["truth"].cache > 1000
    assert QOS["obs"].cache == 0
