"""The processes of ``comotion demo``, and the report at its end."""

import json
import math
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from comotion_schemas.transport import LOOPBACK, SessionSettings, free_port

from .processes import PYTHON, ProcessSpec, comotion

RATES = (15, 30, 100)
SUMMARY = "summary.txt"
# Variables by which processes know how their own scene is reached and run; the demo has another one.
_FOREIGN = (
    "TLS",
    "SECURE",
    "ROUTER_CONNECT",
    "CONFIG",
    "STANDBY",
    "ETCD",
    "METRICS_PORT",
    "CLOCK",
    "NO_STATE",
)
OF_OTHER_SCENES = [f"COMOTION_{name}" for name in _FOREIGN]
_BARS = " ▁▂▃▄▅▆▇█"
_LEAD_S = 4.0  # until the scene starts: all processes are then ready
_REPORT_S = 60.0  # longest time for writing the report


def free_endpoint() -> str:
    """Return an endpoint of this machine with an unused port."""
    return f"tcp/{LOOPBACK}:{free_port()}"


def demo_processes(
    simulated: str,
    endpoint: str,
    out: Path,
    *,
    fusion: Sequence[str],
    scale: float,
    seed: int,
    on_terminal: bool,
) -> list[ProcessSpec]:
    """Router, service, three sources of different rates, a reporter and watch.

    `scale` is in seconds of the `simulated` scene per second, the router listens at `endpoint`, results go to
    the folder `out`, `fusion` are options of ``comotion serve``, and `on_terminal` says whether watch owns
    the terminal.
    """
    at = ("--connect", endpoint, "--scene", "demo")
    # All parts of the scene must agree on when it starts; by then everything is up.
    start = f"{time.time() + _LEAD_S:.3f}"
    playing = ("--start-at", start, "--loop", "--time-scale", f"{scale:.4f}", "--seed", seed)
    sources = [
        comotion(
            f"{rate}hz", "source", "simulator", simulated,
            "--rate", rate, "--part", f"{k}/{len(RATES)}", "--name", f"{rate}hz", *playing, *at,
        )
        for k, rate in enumerate(RATES, 1)
    ]  # fmt: skip
    report = (*PYTHON, "comotion_deploy.demo", endpoint, simulated, str(out))
    return [
        comotion("router", "router", "--listen", endpoint),
        comotion("serve", "serve", "--state", out / "demo.state", *fusion, *at),
        ProcessSpec(name="report", command=report, restart="never", stop_s=_REPORT_S),
        *sources,
        comotion("watch", "watch", *at, foreground=on_terminal),
    ]


def time_scale(simulated: str, duration: float) -> float:
    """Scene seconds per second: 1, or less if one pass would be shorter than the demo, s.

    Between two passes the bodies would jump.

    Raises
    ------
    ValueError
        If the scene does not exist.
    """
    from comotion_sources.simulator import load_scene

    return min(1.0, load_scene(simulated).duration / (duration + 2 * _LEAD_S))


def nmi_per_second(stamps_ns: Sequence[int], nmi: Sequence[float]) -> list[float]:
    """Mean NMI of every second of the run; NaN without scores."""
    groups: dict[int, list[float]] = {}
    for stamp, value in zip(stamps_ns, nmi, strict=True):
        if not math.isnan(value):
            groups.setdefault((stamp - stamps_ns[0]) // 10**9, []).append(value)
    last = max(groups, default=-1)
    return [sum(groups[k]) / len(groups[k]) if k in groups else math.nan for k in range(last + 1)]


def _curve(values: Sequence[float]) -> list[str]:
    bars = ["." if math.isnan(value) else _BARS[1 + min(7, int(value * 8))] for value in values]
    return [
        "NMI over time, one bar a second, the full height is 1:",
        f"  {''.join(bars)}",
        *(
            "  " + "  ".join(f"{k:>3} s {v:.2f}" for k, v in list(enumerate(values))[row : row + 6])
            for row in range(0, len(values), 6)
        ),
    ]


def report(endpoint: str, simulated: str, out: Path) -> None:
    """Evaluate the running demo until stopped; then write summary, values and plot.

    Raises
    ------
    ValueError
        If no update could be scored.
    """
    from comotion_clients.evaluate import as_json, evaluate, summary_lines
    from comotion_experiments.plot import Trace, save_plot

    from .launcher import READY_VARIABLE

    trace = Trace()
    run = evaluate(
        quiet=True,
        on_update=trace.add,
        scene="demo",
        settings=SessionSettings(connect=(endpoint,)),
        ready_file=Path(os.environ[READY_VARIABLE]),
    )
    rates = ", ".join(str(rate) for rate in RATES[:-1])
    lines = [f"scene {simulated}, three sources at {rates} and {RATES[-1]} Hz"]
    lines += summary_lines(run)
    lines += _curve(nmi_per_second([s.stamp_ns for s in run.scores], [s.nmi for s in run.scores]))
    (out / "demo.json").write_text(json.dumps(as_json(run), indent=2))
    files = [str(out / "demo.json")]
    try:
        save_plot(out / "demo.png", f"{simulated}, live from three sources", trace, run)
        files.insert(0, str(out / "demo.png"))
    except ModuleNotFoundError:
        lines.append("no plot: pip install 'comotion[plot]'")
    lines.append(f"written: {', '.join(files)}")
    (out / SUMMARY).write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    try:
        report(sys.argv[1], sys.argv[2], Path(sys.argv[3]))
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
