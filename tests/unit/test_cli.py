"""The command line: precedence of values, errors in one line, the processes of a file."""

import json
import tomllib
from pathlib import Path
from typing import Any

import pytest
import typer

from comotion_deploy.cli import app, run
from comotion_deploy.errors import UserError
from comotion_deploy.launcher import log_lines
from comotion_deploy.processes import read_processes

SCENES = Path(__file__).parents[2] / "deploy" / "scenes"


def effective(capsys, *arguments):
    assert run(["config", "--json", *arguments]) == 0
    values: dict[str, Any] = json.loads(capsys.readouterr().out)
    return values


def test_a_flag_beats_the_environment_beats_the_file_beats_the_default(capsys, tmp_path, monkeypatch):
    assert effective(capsys)["window"] == 10.0
    file = tmp_path / "c.toml"
    file.write_text("[fusion]\nwindow = 5\nthesis.stop_affinity = 0.3")
    assert effective(capsys, "--config", str(file))["window"] == 5.0
    monkeypatch.setenv("COMOTION_CONFIG", str(file))
    assert effective(capsys)["window"] == 5.0
    monkeypatch.setenv("COMOTION_SET", "window=4 period=0.2")
    values = effective(capsys)
    assert (values["window"], values["period"], values["thesis"]["stop_affinity"]) == (4.0, 0.2, 0.3)
    values = effective(capsys, "--set", "window=3")
    assert (values["window"], values["thesis"]["stop_affinity"]) == (3.0, 0.3)


def test_a_command_takes_its_options_from_its_table_and_the_common_ones(capsys, tmp_path, monkeypatch):
    from comotion.runtime import server

    seen: list[server.ServeOptions] = []
    monkeypatch.setattr(server, "serve", seen.append)
    file = tmp_path / "c.toml"
    file.write_text(
        'scene = "cell"\nconnect = ["tcp/127.0.0.1:1", "tcp/127.0.0.1:2"]\nlog-level = "error"\n'
        '[serve]\nstate-interval = 2.5\nclock = "event"\n[router]\nlisten = ["tcp/127.0.0.1:3"]'
    )
    assert run(["serve", "--config", str(file)]) == 0
    monkeypatch.setenv("COMOTION_SCENE", "env")
    assert run(["serve", "--config", str(file), "--connect", "tcp/127.0.0.1:9"]) == 0
    first, second = seen
    assert (first.scene, first.state_interval, first.clock) == ("cell", 2.5, "event")
    assert list(first.settings.connect) == ["tcp/127.0.0.1:1", "tcp/127.0.0.1:2"]
    assert (second.scene, list(second.settings.connect)) == ("env", ["tcp/127.0.0.1:9"])
    assert [options.state and options.state.name for options in seen] == [
        "cell@tcp-127.0.0.1-1@tcp-127.0.0.1-2.state",
        "env@tcp-127.0.0.1-9.state",
    ]
    assert run(["serve", "--no-state"]) == 0
    assert seen[-1].state is None
    assert [options.resume for options in seen] == [False, False, False]
    assert run(["serve", "--resume"]) == run(["serve", "--state", str(tmp_path / "s")]) == 0
    assert [options.resume for options in seen[-2:]] == [True, True]


@pytest.mark.parametrize("kind", [RuntimeError, ValueError, KeyError, KeyboardInterrupt])
def test_an_unknown_error_keeps_its_traceback_and_an_interrupt_is_none(monkeypatch, capsys, kind):
    from comotion_deploy.commands import serve

    def defect(*_):
        raise kind("a defect")

    monkeypatch.setattr(serve.Config, "fusion_config", defect)
    if kind is KeyboardInterrupt:
        assert run(["config"]) == 130
        assert capsys.readouterr().err.strip() == ""
        return
    with pytest.raises(kind, match="a defect"):
        run(["config"])


def own_words(spec):
    """The words of a process behind `comotion`."""
    return list(spec.command[spec.command.index("comotion_deploy") + 1 :])


@pytest.mark.parametrize("path", sorted(SCENES.glob("*.toml")), ids=lambda path: path.stem)
def test_the_example_scenes_are_valid(path, capsys):
    specs = read_processes(tomllib.loads(path.read_text()))
    assert sum(spec.is_router for spec in specs) == 1
    # Every table and option in them is one that a command knows.
    effective(capsys, "--config", str(path))
    for spec in specs:
        command = own_words(spec)
        assert run([*command[: 2 if command[0] == "source" else 1], "--config", str(path), "--help"]) == 0


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "no processes"),
        ("[process.a]\nrun = 'router'\nrestart = 'sometimes'", "restart: Input should be 'always'"),
        ("[process.a]\nrun = 'router'\nforeground = 'yes'", "foreground: Input should be a valid bool"),
        ("[process.a]\nrun = 'router'\nenv = {A = 1}", "env.A: Input should be a valid string"),
        ("[process.a]\nrum = 'router'", "rum: Extra inputs are not permitted"),
        ("[process.a]\nrun = 'router'\ncommand = 'true'", "needs either run"),
        ('[process.a]\nrun = "router \'x"', "No closing quotation"),
        ("[process.a]\ncommand = 'no-such-program'", "no program 'no-such-program'"),
        ("[process.'Two Words']\nrun = 'router'", "a name is"),
        ("".join(f"[process.{k}]\nrun = 'watch'\nforeground = true\n" for k in "ab"), "more than one"),
    ],
)
def test_what_makes_no_sense_is_refused(content, words):
    with pytest.raises(UserError, match=words):
        read_processes(tomllib.loads(content))


def test_a_parameter_of_a_group_can_be_set_and_read_again(capsys, tmp_path):
    arguments = ("--set", "rigid.looseness=0.4", "--set", "thesis.v_move=0.05")
    expected = effective(capsys, *arguments)
    assert expected["rigid"]["looseness"] == 0.4
    assert expected["thesis"]["v_move"] == 0.05
    assert run(["config", *arguments]) == 0
    (tmp_path / "c.toml").write_text(capsys.readouterr().out)
    assert effective(capsys, "--config", str(tmp_path / "c.toml")) == expected


def test_cameras_of_the_service_come_from_files_or_the_table(capsys, tmp_path):
    from comotion import FusionConfig
    from comotion_deploy.commands.serve import with_cameras

    inner = "[intrinsics]\nwidth = 64\nheight = 48\nfx = 50.0\nfy = 51.0\ncx = 31.5\ncy = 23.5\n"
    outer = "[extrinsics]\ntranslation = [0.0, 0.0, 1.5]\nquaternion = [0.0, 0.0, 0.0, 2.0]\n"
    (tmp_path / "in.toml").write_text(inner)
    (tmp_path / "out.toml").write_text(outer)
    (tmp_path / "both.toml").write_text(inner + "distortion = [0.1, 0.0, 0.0, 0.0]\n" + outer)
    given = [f"door={tmp_path / 'in.toml'},{tmp_path / 'out.toml'}", f"b/left={tmp_path / 'both.toml'}"]
    config = with_cameras(FusionConfig(), given)
    assert set(config.linking.cameras) == {"door/pixels", "b/left"}
    assert config.linking.cameras["door/pixels"].fy == 51.0
    assert config.linking.cameras["door/pixels"].quaternion == (0.0, 0.0, 0.0, 1.0)
    assert config.linking.cameras["b/left"].distortion == (0.1, 0.0, 0.0, 0.0)
    table = {name: camera.model_dump(mode="json") for name, camera in config.linking.cameras.items()}
    lines = [
        f'[fusion.linking.cameras."{name}"]\n'
        + "\n".join(f"{key} = {json.dumps(v)}" for key, v in camera.items())
        for name, camera in table.items()
    ]
    (tmp_path / "c.toml").write_text("\n".join(lines))
    assert effective(capsys, "--config", str(tmp_path / "c.toml"))["linking"]["cameras"] == table


def test_only_a_router_listens_where_the_environment_says(monkeypatch):
    monkeypatch.setenv("COMOTION_LISTEN", "tcp/127.0.0.1:7447")
    commands = {"": typer.main.get_command(app)}
    commands |= {f"source {name}": sub for name, sub in commands[""].commands["source"].commands.items()}
    commands |= commands[""].commands
    reads = {name for name, sub in commands.items() for p in sub.params if p.envvar == "COMOTION_LISTEN"}
    assert reads == {"router"}


def test_a_router_does_not_dial_itself_where_a_file_says_what_the_others_connect_to(monkeypatch, tmp_path):
    from comotion_deploy import router

    made: list[router.RouterSetup] = []
    monkeypatch.setattr(router, "run_router", lambda setup, _: made.append(setup()))
    file = tmp_path / "c.toml"
    endpoint = 'connect = ["tcp/127.0.0.1:1"]'
    file.write_text(f'{endpoint}\nlog-level = "error"\n[router]\nlisten = ["tcp/127.0.0.1:1"]')
    assert run(["router", "--config", str(file)]) == 0
    file.write_text(f"[router]\n{endpoint}")
    assert run(["router", "--config", str(file)]) == 0
    assert [setup.settings.connect for setup in made] == [(), ("tcp/127.0.0.1:1",)]


def test_a_line_of_a_process_that_was_not_named_before_is_shown_as_well(tmp_path):
    with log_lines(["agent"], tmp_path / "log") as write:
        write("agent", "one")
        write("cell-0", "two")
    assert (tmp_path / "log").read_text() == "agent | one\ncell-0 | two\n"


def test_a_command_that_has_moved_is_still_found_with_a_hint(capsys):
    assert run(["bench", "--help"]) == 0
    shown = capsys.readouterr()
    assert shown.err == "'comotion bench' is now 'comotion dev bench'\n"
    assert "Usage: comotion dev bench" in " ".join(shown.out.split())
    assert run(["dev", "bench", "--help"]) == 0
    assert capsys.readouterr().err == ""


def test_what_the_wheel_leaves_out_is_one_line(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr("comotion_deploy.cli.in_checkout", lambda: False)
    assert run(["dev", "reproduce", "stress", "--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err == (
        "error: this needs a checkout of the repository: make setup, in a clone\n"
    )
