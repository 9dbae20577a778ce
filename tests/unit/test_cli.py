"""The command line: precedence of values, errors in one line, the processes of a file."""

import json
import math
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
import typer
from rich.text import Text

from comotion_deploy.cli import app, run
from comotion_deploy.demo import demo_processes, nmi_per_second, sparkline, time_scale
from comotion_deploy.errors import UserError
from comotion_deploy.processes import read_processes
from comotion_deploy.router import zenoh_overrides

SCENES = Path(__file__).parents[2] / "deploy" / "scenes"


def effective(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    assert run(["config", "--json", *arguments]) == 0
    values: dict[str, Any] = json.loads(capsys.readouterr().out)
    return values


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert run(arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("error: ")
    assert captured.err.count("\n") == 1
    return captured.err


def test_help_does_not_import_what_is_heavy() -> None:
    heavy = ("numpy", "zenoh", "sklearn", "scipy", "pydantic.dataclasses", "comotion", "comotion_schemas")
    script = (
        "import sys; from comotion_deploy.cli import run; run(['--help']);"
        f"print(sorted(set(sys.modules) & set({heavy!r})))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_a_flag_beats_the_environment_beats_the_file_beats_the_default(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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


def test_a_command_takes_its_options_from_its_table_and_the_common_ones(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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
    assert [one.state and one.state.name for one in seen] == [
        "cell@tcp-127.0.0.1-1@tcp-127.0.0.1-2.state",
        "env@tcp-127.0.0.1-9.state",
    ]
    assert run(["serve", "--no-state"]) == 0
    assert seen[-1].state is None
    assert [one.resume for one in seen] == [False, False, False]
    assert run(["serve", "--resume"]) == run(["serve", "--state", str(tmp_path / "s")]) == 0
    assert [one.resume for one in seen[-2:]] == [True, True]


def test_what_config_prints_can_be_read_again(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    arguments = ("--set", "thesis.v_move=null", "--set", "thesis.clustering=eigengap")
    expected = effective(capsys, *arguments)
    assert expected["thesis"]["v_move"] is None
    assert run(["config", *arguments]) == 0
    (tmp_path / "c.toml").write_text(capsys.readouterr().out)
    assert effective(capsys, "--config", str(tmp_path / "c.toml")) == expected


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["confg"], "No such command 'confg'"),
        (["config", "--sett", "a=1"], "No such option: --sett"),
        (["config", "--set", "window"], "expected NAME=VALUE"),
        (["config", "--set", "windw=3"], "unknown fusion parameter 'windw'; did you mean window?"),
        (["config", "--set", "looseness=1"], "'looseness'; did you mean rigid.looseness?"),
        (["config", "--set", "rigid.loosenes=1"], "'rigid.loosenes'; did you mean rigid.looseness?"),
        (["config", "--set", "rigid.most_tracks=1"], "'rigid.most_tracks'; did you mean pixels.most_tracks?"),
        (["config", "--set", "qqqq=1"], "unknown fusion parameter 'qqqq'; see 'comotion config'"),
        (["config", "--set", "thesis.v_move=-1"], "fusion parameter thesis.v_move"),
        (["config", "--set", "rigid=1"], "fusion parameter rigid"),
        (["config", "--set", "linking.cameras.a/pixels={}"], "fusion parameter linking.cameras.a/pixels.fx"),
        (["config", "--set", "window=-3"], "fusion parameter window: Input should be greater than 0"),
        (["config", "--set", "window=soon"], "fusion parameter window"),
        (["config", "--method", "magic"], "fusion parameter method"),
        (["config", "--config", "/no/such/file.toml"], "/no/such/file.toml: No such file"),
        (["serve", "--clock", "sundial"], "--clock"),
        (["serve", "--scene", "Two Words"], "scene 'Two Words' is not"),
        (["serve", "--connect", "nonsense"], "cannot open a session at nonsense"),
        (["up", "/no/such/file.toml"], "No such file"),
    ],
)
def test_a_known_error_is_one_line_and_status_2(
    capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    assert words in refused(capsys, *arguments)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("windw = 3", "unknown common option 'windw'"),
        ("[serv]\nname = 'x'", "unknown table 'serv'"),
        ("[config]\ncolour = 3", "[config] has no option 'colour'"),
        ("[fusion]\nwindw = 3", "unknown fusion parameter 'windw'"),
        ("[fusion]\nv_move = 3", "unknown fusion parameter 'v_move'; did you mean thesis.v_move?"),
        ("config = 3", "unknown common option 'config'"),
        ("[fusion", "Expected ']'"),
        ("\x00", "c.toml"),
    ],
)
def test_a_misspelt_file_is_refused(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, content: str, words: str
) -> None:
    (tmp_path / "c.toml").write_text(content)
    assert words in refused(capsys, "config", "--config", str(tmp_path / "c.toml"))


def test_no_command_shows_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert run([]) == 2
    captured = capsys.readouterr()
    assert "demo" in captured.out
    assert "error" not in captured.err


@pytest.mark.parametrize("kind", [RuntimeError, ValueError, KeyError])
def test_an_unknown_error_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch, kind: type[Exception]) -> None:
    from comotion_deploy.commands import config

    def defect(*_: object) -> None:
        raise kind("a defect")

    monkeypatch.setattr(config.Config, "fusion_config", defect)
    with pytest.raises(kind, match="a defect"):
        run(["config"])


def test_an_interrupt_is_no_error(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from comotion_deploy.commands import config

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(config.Config, "fusion_config", interrupt)
    assert run(["config"]) == 130
    assert capsys.readouterr().err.strip() == ""


class TestRouter:
    def test_limit_and_tables_become_settings_of_zenoh(self) -> None:
        assert zenoh_overrides({}, None) == {}
        table = {"access_control": {"enabled": True}}
        overrides = zenoh_overrides(table, 4096)
        assert overrides["access_control"] == {"enabled": True}
        assert overrides["low_pass_filter"][0]["size_limit"] == 4096

    @pytest.mark.parametrize(
        ("table", "limit", "words"),
        [
            ({"plugins": {}}, None, "no table 'plugins'"),
            ({"low_pass_filter": []}, 4096, "exclude each other"),
        ],
    )
    def test_what_cannot_be_is_refused(self, table: dict[str, object], limit: int | None, words: str) -> None:
        with pytest.raises(UserError, match=words):
            zenoh_overrides(table, limit)


class TestProcesses:
    @pytest.mark.parametrize("path", sorted(SCENES.glob("*.toml")), ids=lambda path: path.stem)
    def test_the_examples_are_valid(self, path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        specs = read_processes(tomllib.loads(path.read_text()))
        assert sum(spec.is_router for spec in specs) == 1
        # Every table and option in them is one that a command knows.
        effective(capsys, "--config", str(path))
        for spec in specs:
            command = spec.command[spec.command.index("comotion_deploy") + 1 :]
            assert run([*command[: 2 if command[0] == "source" else 1], "--config", str(path), "--help"]) == 0

    def test_a_process_is_a_command_of_ours_or_any_program(self) -> None:
        ours, other = read_processes(
            tomllib.loads(
                "[process.router]\nrun = 'router --listen tcp/[::1]:1'\n"
                "[process.mine]\ncommand = ['sh', '-c', 'a b']\nrestart = 'always'\nenv = {A = '1'}"
            )
        )
        assert ours.command[-4:] == ("comotion_deploy", "router", "--listen", "tcp/[::1]:1")
        assert (ours.is_router, ours.says_ready, ours.restart) == (True, True, "on-failure")
        assert other.command == ("sh", "-c", "a b")
        assert (other.is_router, other.says_ready, other.restart, other.env) == (
            False,
            False,
            "always",
            {"A": "1"},
        )

    @pytest.mark.parametrize(
        ("content", "words"),
        [
            ("", "no processes"),
            ("process = 3", "no processes"),
            ("process.a = 3", "valid dictionary"),
            ("[process.a]\nrun = 'router'\nrestart = 'sometimes'", "restart: Input should be 'always'"),
            (
                "[process.a]\nrun = 'router'\nforeground = 'yes'",
                "foreground: Input should be a valid bool",
            ),
            ("[process.a]\nrun = 'router'\nenv = {A = 1}", "env.A: Input should be a valid string"),
            ("[process.a]\nrum = 'router'", "rum: Extra inputs are not permitted"),
            ("[process.a]", "needs either run"),
            ("[process.a]\nrun = 'router'\ncommand = 'true'", "needs either run"),
            ("[process.a]\nrun = ''", "the command is empty"),
            ('[process.a]\nrun = "router \'x"', "No closing quotation"),
            ("[process.a]\ncommand = 'no-such-program'", "no program 'no-such-program'"),
            ("[process.'Two Words']\nrun = 'router'", "a name is"),
            (
                "[process.a]\nrun = 'watch'\nforeground = true\n"
                "[process.b]\nrun = 'watch'\nforeground = true",
                "more than one",
            ),
        ],
    )
    def test_what_makes_no_sense_is_refused(self, content: str, words: str) -> None:
        with pytest.raises(UserError, match=words):
            read_processes(tomllib.loads(content))


class TestDemo:
    def test_its_commands_are_valid(self, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
        specs = demo_processes(
            "3d_async",
            "tcp/127.0.0.1:1",
            tmp_path,
            fusion=["--set", "thesis.sigma_switch=0.01"],
            scale=0.5,
            seed=0,
            on_terminal=True,
        )
        assert [spec.name for spec in specs if spec.foreground] == ["watch"]
        for spec in specs:
            if spec.says_ready and "comotion_deploy" in spec.command:
                assert run([*spec.command[spec.command.index("comotion_deploy") + 1 :], "--help"]) == 0

    def test_a_pass_outlasts_the_demo_and_is_never_played_fast(self) -> None:
        # The scene lasts 12 s.
        assert time_scale("3d_async", 30.0) < 12 / 30
        assert time_scale("3d_async", 0.0) == 1.0
        with pytest.raises(ValueError, match="no scene 'nonsense'"):
            time_scale("nonsense", 30.0)

    def test_nmi_per_second(self) -> None:
        stamps = [0, 10**9 // 2, 10**9, 3 * 10**9]
        per_second = nmi_per_second(stamps, [0.2, 0.4, math.nan, 1.0])
        assert per_second[0] == pytest.approx(0.3)
        assert [math.isnan(v) for v in per_second] == [False, True, True, False]
        assert sparkline(per_second) == "▃..█"
        assert nmi_per_second([], []) == []


def test_a_parameter_of_a_group_can_be_set_and_read_again(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    arguments = ("--set", "rigid.looseness=0.4", "--set", "pixels.drift=0.05")
    expected = effective(capsys, *arguments)
    assert expected["rigid"]["looseness"] == 0.4
    assert expected["pixels"]["drift"] == 0.05
    assert run(["config", *arguments]) == 0
    (tmp_path / "c.toml").write_text(capsys.readouterr().out)
    assert effective(capsys, "--config", str(tmp_path / "c.toml")) == expected


def test_cameras_of_the_service_come_from_files_or_the_table(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    from comotion import FusionConfig
    from comotion_deploy.commands.linked_cameras import with_cameras

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
    assert run(["config", "--config", str(tmp_path / "c.toml")]) == 0
    (tmp_path / "again.toml").write_text(capsys.readouterr().out)
    assert effective(capsys, "--config", str(tmp_path / "again.toml"))["linking"]["cameras"] == table
    for text, words in (
        ("door", "expected NAME=FILE"),
        (f"door={tmp_path / 'in.toml'}", "has no extrinsics"),
        (f"door={tmp_path / 'out.toml'}", "has no intrinsics"),
        ("door=/no/such/file.yaml", "No such file"),
    ):
        assert words in refused(capsys, "serve", "--camera", text)


def test_help_shows_all_its_words() -> None:
    """What Rich takes for markup is not shown: "[default: ...]" for one."""
    commands = [typer.main.get_command(app)]
    for command in commands:
        commands += getattr(command, "commands", {}).values()
        for text in (command.help, command.epilog, *(getattr(one, "help", None) for one in command.params)):
            assert Text.from_markup(text or "").plain == (text or "")
    assert len(commands) > 15


def test_options_that_all_commands_share_fold_away(capsys) -> None:
    assert run(["source", "klt", "--help"]) == 0
    short = capsys.readouterr().out
    assert run(["source", "klt", "--help-all"]) == 0
    whole = capsys.readouterr().out
    assert "--help-all" in short
    for word in ("--max-features", "--moving", "--no-depth"):
        assert word in short
    for word in ("--connect", "--log-level", "--clock-offset", "--fixed", "COMOTION_"):
        assert word not in short.replace("(--connect, --config, --log-level", "")
        assert word in whole
    assert len(short.splitlines()) < 100 < len(whole.splitlines())


def test_only_a_router_listens_where_the_environment_says(monkeypatch) -> None:
    monkeypatch.setenv("COMOTION_LISTEN", "tcp/127.0.0.1:7447")
    commands = {"": typer.main.get_command(app)}
    commands |= {f"source {name}": one for name, one in commands[""].commands["source"].commands.items()}
    commands |= commands[""].commands
    reads = {name for name, one in commands.items() for p in one.params if p.envvar == "COMOTION_LISTEN"}
    assert reads == {"router"}


def test_evaluate_prints_the_names_of_the_plots_that_it_writes(tmp_path, capsys) -> None:
    pytest.importorskip("matplotlib")
    arguments = ["--duration", "0.6", "--period", "0.3", "--plot", str(tmp_path / "x.png")]
    assert run(["evaluate", "sim:fig4_1", "sim:fig4_3", *arguments]) == 0
    printed = [line.partition(": ")[2] for line in capsys.readouterr().out.splitlines() if "plot: " in line]
    assert sorted(printed) == sorted(str(path) for path in tmp_path.iterdir())
    assert len(printed) == 2


def test_a_limited_evaluation_without_a_router_ends(monkeypatch) -> None:
    from comotion_clients import evaluate
    from comotion_schemas.transport import SessionSettings

    monkeypatch.setattr(evaluate, "FIRST_UPDATE_TIMEOUT_S", 0.2)
    nowhere = SessionSettings(connect=("tcp/127.0.0.1:1",))
    with pytest.raises(TimeoutError):
        evaluate.evaluate("typo", nowhere, duration=0.1, quiet=True)


def test_a_command_that_has_moved_is_still_found_with_a_hint(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["bench", "--help"]) == 0
    shown = capsys.readouterr()
    assert shown.err == "'comotion bench' is now 'comotion dev bench'\n"
    assert "Usage: comotion dev bench" in " ".join(shown.out.split())
    assert run(["dev", "bench", "--help"]) == 0
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("study", ["stress", "joints"])
def test_what_the_wheel_leaves_out_is_one_line(study, monkeypatch, capsys, tmp_path) -> None:
    monkeypatch.setattr("comotion_deploy.cli.in_checkout", lambda: False)
    assert run(["dev", "reproduce", study, "--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err == (
        "error: this needs a checkout of the repository: make setup, in a clone\n"
    )
