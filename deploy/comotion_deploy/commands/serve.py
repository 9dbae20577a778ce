"""``comotion serve`` and ``comotion config``: the fusion service of a scene, and its parameters."""

import gc
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast, get_args, get_origin

import typer

from ..errors import UserError
from ..network import Process, host_name, urls
from ..options import Fusion, Json, Tool, setting
from .camera_sources import read_calibration

if TYPE_CHECKING:
    from pydantic import BaseModel

    from comotion import FusionConfig
    from comotion.config import Camera


class Serve(Fusion, Process):
    """Fuse the sources of a scene and publish its hypotheses at a fixed period."""

    epilog = """
Examples:
  comotion serve
  comotion serve --method thesis --set thesis.sigma_switch=0.01 --set thesis.v_move=null
  comotion serve --resume   # go on where the last one has stopped: the same objects, the same ids
  comotion serve --scene workcell --state workcell.state --connect tcp/192.168.1.10:7447
  comotion serve --camera door=door.yaml,door-extrinsics.toml   # links to bodies of a depth camera
  comotion serve --scene a --standby --etcd http://etcd1:2379,http://etcd2:2379   # on two hosts
  comotion serve --clock event   # for recordings with stamps in the past
"""

    camera: list[str] | None = setting(
        None,
        "Calibration of a fixed camera without depth, to link its hypotheses to bodies in 3-D: "
        "name of its source (or space), then intrinsics and extrinsics in one file or two, or "
        "workcell:SCENE/CAMERA; may be repeated.",
        metavar="NAME=FILE[,FILE]",
    )
    state: Path | None = setting(
        None,
        "Go on from this file, and keep hypotheses and their ids in it. Default: a new scene, kept "
        "in a file for the scene in the user's state folder, ~/.local/state/comotion.",
        metavar="FILE",
        dir_okay=False,
    )
    resume: bool = setting(
        False, "Go on from the scene's file. 'up', 'fleet', the image and the units of systemd do."
    )
    no_state: bool = setting(False, "Keep nothing: ids start anew with each process.")
    state_interval: float = setting(1.0, "Time between writes.", min=0.1, metavar="SECONDS")
    clock: Literal["wall", "event"] = setting("wall", "The wall clock, or the newest stamp received.")
    correct_clocks: bool = setting(
        False, "Shift the stamps of sources whose hosts' clocks differ from this one's, as measured."
    )
    name: str | None = setting(
        None,
        "Name of this service. Default: fusion, with --standby fusion-HOST; or the certificate's.",
        env="COMOTION_SERVICE_NAME",
    )
    standby: bool = setting(
        False, "Be one of several replicas of the scene; one speaks, the others follow. Needs --etcd."
    )
    etcd: str | None = setting(
        None,
        "Members of the etcd cluster that elects the replica that speaks; https takes --tls.",
        metavar="URL[,URL]",
    )
    lease: int = setting(2, "Time until a lost host loses the scene in etcd.", min=2, metavar="SECONDS")

    def run(self) -> None:
        """Serve until stopped."""
        # Threads of parallel kernels spin for some tens of microseconds before they sleep.
        os.environ.setdefault("GOMP_SPINCOUNT", "50000")
        # All that is imported stays: looking for garbage in it took .3 s of a start of 2.1 s.
        gc.disable()
        from comotion.runtime import server
        from comotion.runtime.state_file import default_path

        gc.freeze()
        gc.enable()

        if self.standby != bool(self.etcd):
            raise typer.BadParameter("--standby and --etcd go together", param_hint="--standby")
        name = self.name or (f"fusion-{host_name()}" if self.standby else server.DEFAULT_NAME)
        # Replicas of one scene may run on one machine.
        replica = f".{name}" if self.standby else ""
        endpoints = [*(self.connect or ()), *(self.listen or ())]
        kept = self.state or default_path(f"{self.scene}{replica}", endpoints)
        settings = self.settings()
        server.serve(
            self.call(
                server.ServeOptions,
                config=with_cameras(self.fusion_config(), self.camera),
                name=name,
                settings=settings,
                state=None if self.no_state else kept,
                resume=self.resume or self.state is not None,
                etcd=urls(self.etcd),
                etcd_tls=settings.tls,
            )
        )


_WORKCELL = "workcell:"


def with_cameras(config: "FusionConfig", texts: list[str] | None) -> "FusionConfig":
    """Add calibrated cameras to the fusion parameters.

    Raises
    ------
    UserError
        If a camera is malformed, or has no intrinsics or extrinsics.
    ValueError
        If a file, or the name of a simulated camera, is wrong.
    """
    from comotion.config import LinkingConfig

    cameras = dict(_camera(text) for text in texts or ())
    if not cameras:
        return config
    return config.model_copy(update={"linking": LinkingConfig(cameras=config.linking.cameras | cameras)})


def _camera(text: str) -> "tuple[str, Camera]":
    """Parse NAME=FILE[,FILE] to the name of the space and the camera."""
    from comotion.config import Camera

    name, separator, where = text.partition("=")
    if not (name and separator and where):
        raise UserError(f"--camera {text}: expected NAME=FILE, or NAME=INTRINSICS,EXTRINSICS")
    first, comma, second = where.partition(",")
    files = Path(first), Path(second) if comma else None
    if where.startswith(_WORKCELL):
        from comotion_sources.calibration.files import Calibration
        from comotion_sources.workcell.camera import parse
        from comotion_sources.workcell.scene import Scene
        from comotion_sources.workcell.viewpoint import calibration as seen_from

        spec = parse(where)
        calibration = Calibration(*seen_from(Scene(spec.scene, spec.seed), spec.camera, spec.size))
    else:
        calibration = read_calibration(*files)
    inner, outer = calibration.intrinsics, calibration.extrinsics
    if inner is None or outer is None:
        raise UserError(f"--camera {text}: has no {'intrinsics' if inner is None else 'extrinsics'}")
    return name if "/" in name else f"{name}/pixels", Camera(
        fx=inner.fx,
        fy=inner.fy,
        cx=inner.cx,
        cy=inner.cy,
        distortion=tuple(inner.distortion.tolist()),
        translation=tuple(outer.translation.tolist()),
        quaternion=tuple(outer.quaternion.tolist()),
        frame=outer.frame,
    )


class Config(Fusion, Json, Tool):
    """Print the fusion parameters in effect, as TOML that --config reads (or JSON)."""

    epilog = """
Examples:
  comotion config --set thesis.sigma_switch=0.01 --set thesis.v_move=null
  comotion config --set rigid.looseness=0.4
  comotion config --json
  comotion config > my.toml   # then: comotion serve --config my.toml
"""

    def run(self) -> None:
        """Print them."""
        from comotion import FusionConfig

        values = self.fusion_config().model_dump(mode="json")
        self.show(values, *_table("fusion", FusionConfig, values))


def _table(name: str, model: "type[BaseModel]", values: dict[str, Any]) -> Iterator[str]:
    """Lines of the parameters of a model, those of nested ones as tables of their own after it."""
    yield f"[{name}]"
    nested = []
    for key, field in model.model_fields.items():
        # One line, however it is wrapped in the code.
        comment = f"# {' '.join(str(field.description).split())}"
        if isinstance(values[key], dict):
            nested.append((key, field, comment))
            continue
        yield comment
        # JSON's strings, numbers and booleans are TOML's; only null is missing there.
        yield f"{key} = {json.dumps('null' if values[key] is None else values[key])}"
    for key, field, comment in nested:
        yield f"\n{comment}"
        if get_origin(field.annotation) is dict:
            # A map from names of the user's to models of one kind.
            for entry, content in values[key].items():
                yield from _table(f"{name}.{key}.{json.dumps(entry)}", get_args(field.annotation)[1], content)
        else:
            yield from _table(f"{name}.{key}", cast("type[BaseModel]", field.annotation), values[key])
