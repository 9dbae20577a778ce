"""What is fuzzed: a function of bytes, valid inputs to start from, and the errors that it may raise."""

import io
import struct
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from comotion import Fusion, FusionConfig
from comotion.runtime.state_file import load_fusion
from comotion_deploy.config_file import load_toml
from comotion_deploy.errors import UserError
from comotion_schemas import DecodeError, ObservationBatch, decode, encode
from comotion_schemas.errors import InputError
from comotion_schemas.keys import Keys
from comotion_schemas.message_log import MessageLog
from comotion_sources.calibration.files import read_calibration
from comotion_sources.cameras.tum import TumFolder
from comotion_sources.proprioception.joints import read_csv
from comotion_sources.proprioception.kinematics import load_model
from comotion_sources.recordings import read_recording, recording_streams
from comotion_sources.simulator.spec import load_scene
from comotion_sources.streams import batches

from .. import builders
from ..builders import MS, SESSION, T0

NOW_NS = T0
CORPUS = Path(__file__).with_name("corpus")


@dataclass(frozen=True)
class Target:
    """`run` takes the bytes; `allowed` are its errors, each of one line."""

    run: Callable[[bytes], None]
    seeds: Callable[[], list[bytes]]
    allowed: tuple[type[Exception], ...] = (InputError, UserError)

    def check(self, data):
        """Run it; any other error, or one of several lines, is a finding."""
        try:
            self.run(data)
        except self.allowed as error:
            lines = str(error).splitlines()
            if len(lines) > 1:
                raise AssertionError("more than one line") from error


def batch(seq=0, **fields):
    positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.01 * seq], [1, 1, 0.01 * seq]])
    return builders.batch(
        **({"seq": seq, "stamp_ns": NOW_NS + seq * 50 * MS, "positions": positions} | fields)
    )


def _wire(data):
    """What is accepted is a message that can be written and read again, and a batch of it one to fuse."""
    message = decode(data)
    written = encode(message)
    assert encode(decode(written)) == written
    if isinstance(message, ObservationBatch):
        fusion = Fusion(FusionConfig(window=1.0))
        fusion.ingest(message)
        fusion.update(NOW_NS)
        fusion.update(min(message.stamp_ns, 2**62))


def _messages():
    """The golden bytes of every message, a plain batch, and an update of the core."""
    golden = sorted((Path(__file__).parents[1] / "golden").glob("*.msgpack"))
    return [*(path.read_bytes() for path in golden), encode(batch()), encode(Fusion().update(NOW_NS))]


def _core(data):
    """Numbers of the data become batches of two sources: any stamps, ids, positions, spaces, sessions."""
    fusion = Fusion(FusionConfig(window=1.0, max_tracks=50))
    now = NOW_NS
    for k, part in enumerate(struct.iter_unpack("<qQ3fBBB", data[: min(len(data) // 31, 20) * 31])):
        stamp, seq, x, y, z, what, count, ahead = part
        dim = 3 if what & 1 else 2
        rows = count % 9
        row = np.nan_to_num(np.float32([x, y, z]), posinf=3e38, neginf=-3e38)[:dim]
        relative = NOW_NS + stamp % 4_000_000_000 - 2_000_000_000
        fusion.ingest(
            batch(
                seq if what & 2 else k,
                source="cam" if what & 4 else "lidar",
                session=("b" if what & 8 else "a") * 16,
                space="world" if what & 16 else "other",
                unit="m" if what & 32 else "px",
                stamp_ns=stamp if what & 64 else relative,
                ids=np.arange(count, count + rows, dtype=np.uint64),
                positions=np.tile(row, (rows, 1)) + np.arange(rows, dtype=np.float32)[:, None],
                ended=np.arange(3, dtype=np.uint64) if what & 128 else None,
            )
        )
        now += ahead * 10_000_000
        encode(fusion.update(now))
    fusion.snapshot()


def _file(name, read):
    def run(data):
        path = _folder() / name
        path.write_bytes(data)
        read(path)

    return run


@cache
def _folder():
    return Path(tempfile.mkdtemp(prefix="comotion-fuzz-"))


def _recording(path, rate=None):
    for message in batches(recording_streams(read_recording(path, rate), split=2)):
        encode(message)


def _mcap(path):
    with MessageLog(path) as log:
        for message in log.messages():
            message.decode()


def _mcap_seeds():
    from mcap.writer import CompressionType, Writer

    from comotion_schemas.recording import MESSAGE_ENCODING

    files = []
    for compression in CompressionType:
        buffer = io.BytesIO()
        writer = Writer(buffer, compression=compression)
        writer.start()
        channel = writer.register_channel(Keys().stream("obs", "cam"), MESSAGE_ENCODING, 0)
        for seq in range(3):
            writer.add_message(channel, seq, encode(batch(seq)), seq, seq)
        writer.finish()
        files.append(buffer.getvalue())
    return files


def _tum(path):
    for name in ("groundtruth.txt", "objects.txt", "depth.txt"):
        (path.parent / name).write_bytes(path.read_bytes())
    TumFolder(path.parent)


def _state(path):
    load_fusion(path, FusionConfig(), "default", SESSION, NOW_NS).update(NOW_NS)


def _state_seeds():
    fusion = Fusion(FusionConfig(window=1.0))
    for seq in range(5):
        fusion.ingest(batch(seq))
        fusion.update(NOW_NS + seq * 50_000_000)
    return [fusion.snapshot(), Fusion().snapshot()]


def _core_seeds():
    return [bytes(range(256)) * 2, np.random.default_rng(0).bytes(620)]


def _of_file(name, read, seeds=list):
    """Valid files are in the corpus, where no seeds are made."""
    return Target(_file(name, read), seeds)


TARGETS: dict[str, Target] = {
    "wire": Target(_wire, _messages, (DecodeError,)),
    "core": Target(_core, _core_seeds, ()),
    "npz": _of_file("a.npz", _recording),
    "tracks": _of_file("t.csv", lambda path: _recording(path, 30.0)),
    "c3d": _of_file("a.c3d", read_recording),
    "mcap": _of_file("a.mcap", _mcap, _mcap_seeds),
    "yaml": _of_file("a.yaml", read_calibration),
    "camera-toml": _of_file("a.toml", read_calibration),
    "scene": _of_file("s.toml", load_scene),
    "config": _of_file("c.toml", load_toml),
    "urdf": _of_file("r.urdf", load_model),
    "csv": _of_file("j.csv", lambda path: list(read_csv(path))),
    "tum": _of_file("rgb.txt", _tum),
    "state": Target(_file("s.state", _state), _state_seeds, ()),
}


def corpus(name):
    """Valid inputs of a target, and inputs that were once a finding."""
    folder = CORPUS / name
    kept = sorted(folder.iterdir()) if folder.is_dir() else []
    return TARGETS[name].seeds() + [file.read_bytes() for file in kept]
