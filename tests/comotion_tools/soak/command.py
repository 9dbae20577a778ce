"""What ``comotion dev soak`` does: runs a soak, prints its report and writes it to files."""

import json
import threading
import time
from typing import TYPE_CHECKING

from comotion_deploy.demo import free_endpoint
from comotion_schemas.component import stop_on_signals

from . import report
from .run import Runner, clear
from .schedule import draw
from .series import kill_in_a_row, stop_each

if TYPE_CHECKING:
    from ..commands.soak import Soak


def soak(options: "Soak") -> bool:
    """Run it; whether something was violated."""
    out = options.out
    clear(out)
    stop, began = threading.Event(), time.monotonic()

    def say(line: str) -> None:
        if not options.json_:
            print(f"{time.monotonic() - began:7.1f} s  {line}", flush=True)

    with stop_on_signals(stop), Runner(free_endpoint(), out, stop, say) as runner:
        runner.settle()
        say(f"all bodies have a hypothesis; logs are in {out}")
        if options.kills is None:
            runner.run(draw(options.seed, options.duration), options.duration)
        else:
            kill_in_a_row(runner, options.kills, stop)
            if options.stopped:
                stop_each(runner, options.stopped)
    values = report.as_json(runner.result, options.seed, options.gap)
    (out / "soak.json").write_text(json.dumps(values, indent=2), encoding="utf-8")
    text = report.lines(values)
    (out / "soak.txt").write_text("\n".join(text) + "\n", encoding="utf-8")
    try:
        report.save_plot(out / "soak.png", runner.result)
    except ModuleNotFoundError:
        text.append("no plot: pip install 'comotion[plot]'")
    options.show(values, *text)
    return bool(values["violations"])
