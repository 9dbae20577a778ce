"""``comotion evaluate`` and ``comotion joints``: scores of hypotheses, and their joints, live or offline."""

from math import isnan
from pathlib import Path

from ..errors import UserError, require_suffix
from ..network import Client, Present
from ..options import Fusion, Json, argument, option, setting
from .look import BodyNames

_OFFLINE_ONLY = ("all_", "method", "set_", "period", "seeds", "split", "rate", "as_received", "compare")
_LIVE_ONLY = ("scene", "connect", "ready_file")


class Evaluate(Fusion, Json, Present):
    """Score hypotheses against the truth: NMI, error, number of hypotheses, switches, HOTA, IDF1.

    Every track that is observed at an update is scored; a track that is undetermined
    or not in the update counts as a separate cluster.
    """

    epilog = """
Examples:
  comotion evaluate --duration 30   # a running scene that publishes truth
  comotion evaluate recording.npz --method thesis --set thesis.sigma_switch=0.01
  comotion evaluate sim:fig4_4 sim:fig4_1 --seeds 0-4 --period 0.333 --json
  comotion evaluate sim:3d_3 --compare   # with a comparator
  comotion evaluate take.mcap   # what comotion record has written
  comotion evaluate take.mcap --paths out && evo_traj tum out/*.tum   # evo draws and compares them
  comotion evaluate recording.npz --split 3 --plot out/recording.png
"""
    log_level = "warning"

    files: list[str] | None = argument(
        None,
        "FILE",
        "Recordings (.c3d, .npz, .mcap) and simulated scenes (sim:NAME). Without any: the running scene.",
    )
    period: float | None = setting(
        None, "Time between updates. Default: the fusion parameter.", min=0.005, max=60, metavar="SECONDS"
    )
    duration: float | None = setting(
        None, "How much to evaluate. Default: to the end; live: until Ctrl-C.", metavar="SECONDS"
    )
    seeds: str = setting("0", "Seeds of simulated scenes, e.g. 0-4 or 0,3.")
    split: int = setting(
        1, "Divide a recording among so many sources.", env="COMOTION_SPLIT_SOURCES", min=1, max=64
    )
    rate: str | None = setting(None, "Rate of the sources, or of each.", metavar="HZ[,HZ...]")
    as_received: bool = setting(
        False,
        "Process recorded scenes (.mcap) in the order of receipt, including late data. "
        "Default: in the order of acquisition.",
    )
    compare: bool = setting(
        False,
        "Score the affinity of Brox and Malik as well, with spectral clustering (number of objects "
        "given) and with divisive k-means.",
    )
    all_: bool = option(False, "Show all columns; --json has all values.", "--all")
    plot: Path | None = setting(None, "Draw hypotheses, truth and NMI.", metavar="FILE.png")
    paths: Path | None = setting(
        None, "Write the paths of moving cameras and of bodies in the TUM format, for evo.", metavar="FOLDER"
    )

    def run(self) -> None:
        """Score the files, or the running scene."""
        if self.duration is not None and not 0 < self.duration < float("inf"):
            raise UserError(f"--duration {self.duration:g} is not above 0")
        if self.plot is not None:
            import matplotlib  # noqa: F401 - before the work

            require_suffix(self.plot, "a picture", ".png", ".svg", ".pdf", ".jpg")
        if self.files:
            self.reject_flags(_LIVE_ONLY, "is only for a running scene, without FILES")
            self._score_files(self.files)
        else:
            self.reject_flags(_OFFLINE_ONLY, "is only for FILES")
            self._score_scene()

    def _score_files(self, files: list[str]) -> None:
        from comotion_experiments.inputs import find_inputs, parse_seeds
        from comotion_sources.streams import parse_rates

        config = self.fusion_config()
        seeds, rates = parse_seeds(self.seeds), parse_rates(self.rate)
        inputs = self.call(find_inputs, files, seeds=seeds, rates=rates)
        # Wrong inputs are reported by now: the core takes longer to load.
        from comotion_experiments.evaluate import as_json, evaluate_inputs, plot_path, table

        results = self.call(evaluate_inputs, inputs, config, comparator=self.compare)
        several = len(inputs) > 1
        plots = (
            [] if self.plot is None else [plot_path(self.plot, scored, several=several) for scored in inputs]
        )
        notes = [f"plot: {path}" for path in plots]
        if unscored := sorted({result.name for result in results if isnan(result.values()["mean_nmi"])}):
            notes.append(f"without truth, so that nothing is scored: {', '.join(unscored)}")
        shown = table(results, everything=self.all_)
        self.show(as_json(results, config, self.period), shown, *notes)

    def _score_scene(self) -> None:
        from comotion_clients.evaluate import as_json, evaluate, summary_lines
        from comotion_clients.formats import save_paths
        from comotion_experiments.plot import Trace, save_plot

        trace = Trace()
        run = evaluate(duration=self.duration, on_update=trace.add, **self.where())
        if self.paths is not None:
            save_paths(self.paths, trace.updates)
        if self.plot is not None:
            save_plot(self.plot, f"scene {self.scene}, live", trace, run)
        plots = [] if self.plot is None else [f"plot: {self.plot}"]
        self.show(as_json(run), *summary_lines(run), *plots)


class Joints(Fusion, BodyNames, Json, Client):
    """Say how the bodies of a scene are connected, as of the last update: hinges, slides, fixed ones.

    The URDF has a link for each hypothesis with a pose, as a box of its extent, and its joints with
    the ranges seen. Position 0 is that of the update; what has no joint floats. Masses are made up.
    """

    epilog = """
Examples:
  comotion joints   # of a running scene
  comotion joints --name 1=cabinet --name 2=door   # "door turns on cabinet, 0 to 65°"
  comotion joints take.mcap --urdf cabinet.urdf
  comotion joints sim:fig4_4 --duration 6 --json
"""
    log_level = "warning"

    file: str | None = argument(
        None,
        "FILE",
        "A recording (.c3d, .npz, .mcap) or a simulated scene (sim:NAME). Without: the running scene.",
    )
    urdf: Path | None = setting(None, "Write a URDF file.", metavar="FILE")
    space: str | None = setting(None, "Space of the URDF, where there are several.")
    duration: float | None = setting(
        None, "How much of the file. Default: to the end.", min=0.1, metavar="SECONDS"
    )
    timeout: float = setting(5.0, "Longest wait for an update.", min=0.1, metavar="SECONDS")

    def run(self) -> None:
        """Print the joints, and write the URDF if that is wanted."""
        if self.urdf is not None and not self.urdf.parent.is_dir():
            raise UserError(f"{self.urdf.parent}: no such folder")
        if self.file is None:
            self.reject_flags(("method", "set_", "duration"), "is only for a FILE")
            from comotion_clients.subscribe import subscribe

            settings = self.settings()
            with subscribe(self.scene, settings.connect, timeout=self.timeout, tls=settings.tls) as updates:
                try:
                    update = next(updates)
                except TimeoutError:
                    raise UserError(f"no update of scene {self.scene} within {self.timeout:g} s") from None
        else:
            of_scene = ("scene", "connect", "tls", "timeout")
            self.reject_flags(of_scene, "is only for a running scene, without FILE")
            from comotion_experiments.inputs import find_inputs

            config = self.fusion_config()
            (recording,) = find_inputs([self.file])
            from comotion_experiments.offline import run_offline

            update = run_offline(recording.open(), config, duration=self.duration).last
        from comotion_clients.watch_columns import joint_table
        from comotion_schemas.plain import plain

        joints = plain(update.joints, without_none=True)
        values = {"stamp_ns": update.stamp_ns, "joints": joints}
        self.show(values, joint_table(update.joints, self.names()), width=120)
        if self.urdf is not None:
            from comotion_clients.formats import to_urdf

            self.urdf.write_text(to_urdf(update, self.space), encoding="utf-8")
            if not self.json_:
                print(f"urdf: {self.urdf}")
