"""Paths of cameras and bodies in the TUM format, as evo and other tools for camera paths read them.

A line is ``time x y z qx qy qz qw``, time in s. ``evo_ape tum truth.tum camera-<space>.tum -a`` compares.
"""

from collections.abc import Iterable
from pathlib import Path

from comotion_schemas import HypothesisUpdate, Pose
from comotion_schemas.rigid import rotation, three


def paths_of(updates: Iterable[HypothesisUpdate]) -> dict[str, list[str]]:
    """Lines of each path: ``camera-<space>`` for a frame that moves, ``hypothesis-<id>`` for a body."""
    paths: dict[str, list[str]] = {}
    last_ns: int | None = None
    for update in updates:
        if update.stamp_ns == last_ns:
            continue
        last_ns = update.stamp_ns
        poses = [(f"camera-{space}", pose) for space, pose in update.frames.items()]
        bodies = (h for h in update.hypotheses if not h.absent)
        poses += [(f"hypothesis-{h.id}", h.pose) for h in bodies if h.pose is not None]
        for name, pose in poses:
            paths.setdefault(name, []).append(line(update.stamp_ns, pose))
    return paths


def save_paths(folder: Path, updates: Iterable[HypothesisUpdate]) -> list[Path]:
    """Write a file for each path to a folder, which is made; returns the files.

    Raises
    ------
    OSError
        If one cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for name, lines in paths_of(updates).items():
        file = folder / f"{name}.tum"
        file.write_text("\n".join([*lines, ""]))
        files.append(file)
    return files


def line(stamp_ns: int, pose: Pose) -> str:
    """Return the line of a pose; one in the plane is in z = 0."""
    values = (*three(pose.translation), *rotation(pose.rotation).as_quat())
    seconds, rest = divmod(stamp_ns, 1_000_000_000)
    return f"{seconds}.{rest:09d} " + " ".join(f"{value:.9g}" for value in values)
