"""Trajectories that jump are cut; those of bodies that move abruptly, and single errors, are not."""

import numpy as np
import pytest

import comotion
from comotion.trajectories.jumps import jumps
from comotion.trajectories.window import Window

RATE, COUNT = 20.0, 30
AT = 20


def _scene(seed: int = 0):
    """Ten features at rest and ten that sway, [T, 20, 3], noise 2 mm."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(-1, 1, (1, 20, 3)).repeat(COUNT, 0)
    places[:, 10:, 0] += 0.2 * np.sin(np.arange(COUNT) / 3)[:, None]
    return places + rng.normal(0, 0.002, places.shape)


def _exchanged(x):
    x[AT:, [3, 14]] = x[AT:, [14, 3]]


def _slipped(x):
    x[AT:, 12] += [0.1, 0, 0]


def _body(x):
    x[AT:, 10:] += [0.0, 0.5, 0.0]


def _pair(x):
    x[AT:, 10:12] += [0.0, 0.5, 0.0]


def _all(x):
    x[AT:] = x[AT:, ::-1]


def _error(x):
    x[AT, 4] += 0.5


def _start(x):
    x[AT:, 4] += 0.1 * np.arange(1, COUNT - AT + 1)[:, None]


def _rounded(x):
    x[:] = np.round(x, 2)


def _found(x):
    window = Window(3, 10**10, 10**9)
    slots = window.open(x.shape[1], 0)
    found = {}
    for k, positions in enumerate(x):
        stamp = 1 + round(k * 1e9 / RATE)
        window.insert(slots, stamp, positions, np.full(len(slots), np.nan), None)
        if k % 2:
            jumping, first = jumps(window, slots, 1 + round((k - 2) * 1e9 / RATE))
            found |= dict(zip(jumping.tolist(), (first - window.start[jumping]).tolist(), strict=True))
    return {int(np.flatnonzero(slots == slot)[0]): k for slot, k in found.items()}


@pytest.mark.parametrize(
    ("happens", "expected"),
    [
        (_exchanged, {3: AT, 14: AT}),
        (_slipped, {12: AT}),
        *((one, {}) for one in (_body, _pair, _all, _error, _start, _rounded)),
    ],
)
def test_only_what_jumps_alone_and_stays_there_is_cut(happens, expected):
    x = _scene()
    happens(x)
    assert _found(x) == expected


def test_features_that_exchange_their_ids_exchange_their_hypotheses():
    x = _scene()
    x = np.concatenate([x, x[::-1], x])
    x[45:, [3, 14]] = x[45:, [14, 3]]
    scene = comotion.Scene(unit="m")
    for k, positions in enumerate(x):
        scene.push(np.arange(20), positions, k / RATE)
    update = scene.update()
    labels = dict(zip(update.track_id.tolist(), update.track_hypothesis.tolist(), strict=True))
    assert labels[3] == labels[10] != labels[0] == labels[14]
    assert len(set(labels.values())) == 2
