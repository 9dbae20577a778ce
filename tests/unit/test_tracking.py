"""HOTA, IDF1 and switches: by hand, and as TrackEval has them where it is installed."""

import numpy as np
import pytest

from comotion_clients.tracking import Tracking
from comotion_schemas import UNDETERMINED


def figures(instants):
    tracking = Tracking()
    for labels, objects in instants:
        tracking.add(np.array(labels, np.int64), np.array(objects, np.int32))
    return tracking.figures()


def test_what_is_right_has_the_best_figures():
    found = figures([([7, 7, 9], [0, 0, 1])] * 5)
    assert (found.hota, found.idf1, found.id_switches) == (1.0, 1.0, 0)


def test_undetermined_and_unknown_features_are_no_detections():
    found = figures([([UNDETERMINED, UNDETERMINED, 3], [0, 0, -1])] * 3)
    assert (found.hota, found.idf1, found.id_switches) == (0.0, 0.0, 0)
    assert figures([]).hota == 0.0


def test_figures_are_those_of_trackeval():
    pytest.importorskip("trackeval")
    from trackeval.metrics import CLEAR, HOTA, Identity

    rng = np.random.default_rng(3)
    truth = np.repeat(np.arange(4), 6)
    instants = []
    for t in range(40):
        labels = np.where(rng.random(24) < 0.3, rng.integers(10, 16, 24), truth + 10 + (t // 15))
        seen = rng.random(24) < 0.8
        instants.append((labels[seen], truth[seen]))
    ours = figures(instants)
    hota, idf1, clear = (m().eval_sequence(_as_trackeval(instants)) for m in (HOTA, Identity, CLEAR))
    assert ours.hota == pytest.approx(hota["HOTA"].mean())
    assert (ours.det_a, ours.ass_a) == pytest.approx((hota["DetA"].mean(), hota["AssA"].mean()))
    assert ours.idf1 == pytest.approx(idf1["IDF1"])
    assert ours.id_switches == clear["IDSW"] > 0


def _as_trackeval(instants):
    data = {"gt_ids": [], "tracker_ids": [], "similarity_scores": []}
    for labels, objects in instants:
        true, found = np.unique(objects), np.unique(labels)
        masks = (objects == true[:, None])[:, None, :], (labels == found[:, None])[None]
        data["gt_ids"].append(true)
        data["tracker_ids"].append(found - 10)
        data["similarity_scores"].append((masks[0] & masks[1]).sum(2) / (masks[0] | masks[1]).sum(2))
    for name, key in (("gt", "gt_ids"), ("tracker", "tracker_ids")):
        data[f"num_{name}_dets"] = sum(map(len, data[key]))
        data[f"num_{name}_ids"] = int(max(ids.max() for ids in data[key])) + 1
    data["num_timesteps"] = len(instants)
    return data
