"""Files in deploy/: each is accepted by the checker of its own kind, and names what exists."""

import json
import os
import re
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from comotion_schemas.readiness import announce_ready, beat

ROOT = Path(__file__).parents[2]
DEPLOY = ROOT / "deploy"
BIN = Path(sys.executable).parent
HEALTH = re.compile(r"test -n \\\"(.+?)\\\"\"")


def accepted(*command):
    done = subprocess.run(list(map(str, command)), check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_dockerfile_has_no_complaints():
    accepted(BIN / "hadolint", "--failure-threshold", "info", DEPLOY / "Dockerfile")


def test_what_the_dockerfile_copies_is_there_and_passes_the_ignore_file():
    lines = (DEPLOY / "Dockerfile").read_text().splitlines()
    copied = [line.split()[1:-1] for line in lines if line.startswith("COPY ") and "--from" not in line]
    kept = {line[1:] for line in (DEPLOY / "Dockerfile.dockerignore").read_text().split() if line[0] == "!"}
    for source in (name for names in copied for name in names):
        assert (ROOT / source).exists()
        assert source in kept


class _Loader(yaml.SafeLoader):
    """Takes the tags of compose files for nothing."""


_Loader.add_constructor("!override", lambda loader, node: loader.construct_sequence(node))


@pytest.mark.parametrize("name", ["compose.yaml", "compose.secure.yaml"])
def test_compose_files_follow_the_specification(name, tmp_path):
    content = yaml.load((DEPLOY / name).read_text(), _Loader)
    plain = tmp_path / "compose.json"
    plain.write_text(json.dumps(content))
    accepted(BIN / "check-jsonschema", "--builtin-schema", "vendor.compose-spec", plain)


def test_kubernetes_files_follow_the_schemas(tmp_path):
    files = sorted((DEPLOY / "kubernetes").glob("*.yaml"))
    read = {file.name: list(yaml.safe_load_all(file.read_text())) for file in files}
    kinds = [(name, document) for name, documents in read.items() for document in documents]
    everything = tmp_path / "all.yaml"
    everything.write_text(yaml.safe_dump_all([d for _, d in kinds if d["kind"] != "Kustomization"]))
    accepted(BIN / "kubernetes-validate", "--strict", everything)
    if shutil.which("kubectl") is not None:
        accepted("kubectl", "kustomize", DEPLOY / "kubernetes")
    (listed,) = [document["resources"] for _, document in kinds if document["kind"] == "Kustomization"]
    assert sorted(listed) == sorted({name for name, d in kinds if d["kind"] != "Kustomization"})


def commands():
    """Commands of containers, as words after `comotion`."""
    compose = yaml.load((DEPLOY / "compose.yaml").read_text(), _Loader)["services"].values()
    secure = yaml.load((DEPLOY / "compose.secure.yaml").read_text(), _Loader)["services"].values()
    commands = [service["command"] for service in (*compose, *secure) if "command" in service]
    text = (DEPLOY / "kubernetes" / "fleet.yaml").read_text()
    commands += [c["args"] for d in yaml.safe_load_all(text) for c in _containers(d) if "args" in c]
    return [*commands, ["router", "--secure", "/pki"]]


def _containers(document):
    return document.get("spec", {}).get("template", {}).get("spec", {}).get("containers", [])  # type: ignore[no-any-return]


@pytest.mark.parametrize("words", commands(), ids=" ".join)
def test_containers_run_commands_that_exist(words, capsys):
    from comotion_deploy.cli import run

    # An unknown option is an error even beside --help.
    assert run([*(words[: words.index("--name")] if "--name" in words else words), "--help"]) == 0
    assert run([*words[:1], "--no-such-option", "--help"]) == 2
    assert capsys.readouterr().out


def test_alerts_are_valid_and_name_metrics_that_exist():
    file = DEPLOY / "prometheus-alerts.yaml"
    rules = yaml.safe_load(file.read_text())["groups"][0]["rules"]
    used = {name for rule in rules for name in re.findall(r"comotion_[a-z_]+", rule["expr"])}
    documented = (ROOT / "schemas" / "comotion_schemas" / "metrics.py").read_text()
    counters = {"updates", "overruns", "lost", "late"}
    for name in used:
        plain = name.removesuffix("_bucket")
        counter = re.fullmatch(r"comotion_(\w+)_total", plain)
        assert plain in documented or (counter and counter[1] in counters), name
    if shutil.which("promtool") is None:
        pytest.skip("no promtool: the expressions were not parsed")
    accepted("promtool", "check", "rules", file)


def test_systemd_hears_of_readiness_and_life(tmp_path, monkeypatch):
    address = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.bind(address)
        monkeypatch.setenv("NOTIFY_SOCKET", address)
        with announce_ready(tmp_path / "ready"):
            assert receiver.recv(100) == b"READY=1"
            beat(tmp_path / "ready")
            assert receiver.recv(100) == b"WATCHDOG=1"
        assert receiver.recv(100) == b"STOPPING=1"
    beat(None)  # nobody listens any more: no error


def test_the_health_check_tells_a_process_that_hangs(tmp_path):
    checks = HEALTH.findall((DEPLOY / "Dockerfile").read_text())
    checks += HEALTH.findall((DEPLOY / "kubernetes" / "router.yaml").read_text())
    assert len(checks) == 2
    ready = tmp_path / "ready"
    with announce_ready(ready):
        beat(ready)
        for check in checks:
            command = f'test -n "{check.replace("/run/comotion/ready", str(ready))}"'
            assert subprocess.run(["sh", "-c", command], check=False).returncode == 0
            os.utime(ready, (0, 0))
            assert subprocess.run(["sh", "-c", command], check=False).returncode == 1
            beat(ready)
