"""Tracks whose ids jump, as real trackers give them, are cut; what jumps together is not."""

import numpy as np
import pytest

import comotion
from comotion.trajectories.jumps import jumps
from comotion.trajectories.window import Window

from ..builders import labels_of

RATE, COUNT = 20.0, 30
AT = 20
SOME, BODY = np.s_[AT:, [3, 14]], np.s_[AT:, 10:]


def scene(seed=0):
    """Ten features at rest and ten that sway, [T, 20, 3], noise 2 mm."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(-1, 1, (1, 20, 3)).repeat(COUNT, 0)
    places[:, 10:, 0] += 0.2 * np.sin(np.arange(COUNT) / 3)[:, None]
    return places + rng.normal(0, 0.002, places.shape)


# Rows of a scene x, what they become, and which features are cut at which frame.
HAPPENS = {
    "two exchange their ids": (SOME, lambda x: x[AT:, [14, 3]], {3: AT, 14: AT}),
    "one slips": (np.s_[AT:, 12], lambda x: x[AT:, 12] + [0.1, 0, 0], {12: AT}),
    "a body jumps": (BODY, lambda x: x[BODY] + [0.0, 0.5, 0.0], {}),
    "two jump together": (np.s_[AT:, 10:12], lambda x: x[AT:, 10:12] + [0.0, 0.5, 0.0], {}),
    "all ids are others": (np.s_[AT:], lambda x: x[AT:, ::-1], {}),
    "a single error": (np.s_[AT, 4], lambda x: x[AT, 4] + 0.5, {}),
    "one starts": (np.s_[AT:, 4], lambda x: x[AT:, 4] + 0.1 * np.arange(1, COUNT - AT + 1)[:, None], {}),
    "all is rounded": (np.s_[:], lambda x: np.round(x, 2), {}),
}


@pytest.mark.parametrize(("rows", "become", "expected"), HAPPENS.values(), ids=HAPPENS)
def test_only_what_jumps_alone_and_stays_there_is_cut(rows, become, expected):
    x = scene()
    x[rows] = become(x.copy())
    window = Window(3, 10**10, 10**9)
    slots, found = window.open(x.shape[1], 0), {}
    for k, positions in enumerate(x):
        window.insert(slots, 1 + round(k * 1e9 / RATE), positions, np.full(len(slots), np.nan), None)
        if k % 2:
            jumping, first = jumps(window, slots, 1 + round((k - 2) * 1e9 / RATE))
            found |= dict(zip(jumping.tolist(), (first - window.start[jumping]).tolist(), strict=True))
    assert {int(np.flatnonzero(slots == slot)[0]): k for slot, k in found.items()} == expected


def test_features_that_exchange_their_ids_exchange_their_hypotheses():
    x = scene()
    x = np.concatenate([x, x[::-1], x])
    x[45:, [3, 14]] = x[45:, [14, 3]]
    online = comotion.Scene(unit="m")
    for k, positions in enumerate(x):
        online.push(np.arange(20), positions, k / RATE)
    labels = labels_of(online.update())
    assert labels[3] == labels[10] != labels[0] == labels[14]
    assert len(set(labels.values())) == 2
