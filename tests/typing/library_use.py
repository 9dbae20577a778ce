"""Checked by ``make check`` without any plugin: a user's program has none."""

import numpy as np

import comotion
from comotion_clients.subscribe import subscribe
from comotion_sources.runtime import SourcePublisher

grouping = comotion.group(np.zeros((3, 4, 3)), np.arange(3.0), config=comotion.FusionConfig())
labels = grouping.labels + 1
period = comotion.FusionConfig(window=5.0).period * 2
hypotheses = comotion.Scene(unit="px").push([1], [[0.0, 0.0]], 0.0).hypotheses
with SourcePublisher("mine", space="world", unit="m", dim=3, connect="tcp/127.0.0.1:7447") as source:
    source.observe(ids=[1], positions=np.zeros((1, 3)))
with subscribe(connect="tcp/127.0.0.1:7447") as updates:
    states = [h.state for update in updates for h in update.hypotheses]
