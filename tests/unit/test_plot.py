"""Pictures of a run. What they show is looked at by people; here: that they are drawn, and of what."""

from pathlib import Path

import numpy as np
import pytest

from comotion import FusionConfig
from comotion_experiments.offline import Run, run_offline
from comotion_experiments.plot import Trace, save_plot
from comotion_schemas.colours import Palette
from comotion_sources import simulator

cv2 = pytest.importorskip("cv2")
pytest.importorskip("matplotlib")
CONFIG = FusionConfig(method="thesis", thesis={"sigma_switch": 0.02, "v_move": None})


def run(scene: str, duration: float, *, keep_truth: bool = True) -> tuple[Run, Trace]:
    trace = Trace()
    sent = simulator.batches(simulator.simulate(simulator.load_scene(scene)))
    messages = (m for m in sent if keep_truth or not hasattr(m, "objects"))
    return run_offline(messages, CONFIG, duration=duration, on_update=trace.add), trace


def palette_of(trace: Trace) -> Palette:
    palette = Palette()
    for update in trace.updates:
        palette.see(update.hypotheses)
    return palette


@pytest.mark.parametrize(("scene", "keep_truth"), [("fig4_1", True), ("3d_2", True), ("fig4_1", False)])
def test_a_run_is_drawn(tmp_path: Path, scene: str, keep_truth: bool) -> None:
    done, trace = run(scene, 1.5, keep_truth=keep_truth)
    path = tmp_path / "new" / "run.png"
    save_plot(path, "a run", trace, done)
    image = cv2.imread(str(path))
    assert image.shape[1] == 1200
    assert image.shape[0] == (960 if keep_truth else 640)
    # Some points have the colour of a hypothesis.
    blue, green, red = image[..., 0], image[..., 1], image[..., 2]
    ids = np.unique(trace.updates[-1].track_hypothesis).tolist()
    palette = palette_of(trace)
    for wanted in (palette.colour(i) for i in ids):
        assert ((red == wanted[0]) & (green == wanted[1]) & (blue == wanted[2])).sum() > 20
