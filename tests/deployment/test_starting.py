"""Why a deployment cannot start is one line, at once; and what it needs it takes from where it was started."""

from __future__ import annotations

import configparser
import os
import resource
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from supervisor.options import ServerOptions

from tests.deployment.conftest import Small
from vantage import deployment, process_table
from vantage.bus.zenoh_bus import ZenohBus
from vantage.commands import Up, up
from vantage.deployment import Deployment, DeploymentError, Process
from vantage.errors import UserError
from vantage.process_table import ConfigurationError, programs_of, with_extra_arguments, with_this_interpreter
from vantage.supervisor import OPEN_FILES
from vantage.watch import diagnosis, judge

TEXT = "[supervisord]\n\n[program:planner]\ncommand=python -m services.planner --folder .\n"


def command_by_supervisor(text: str, folder: Path) -> list[str]:
    """Return the words of the one program's command, as supervisord itself reads and expands them."""
    path = folder / "read.conf"
    path.write_text(text)
    options = ServerOptions()
    options.realize(["-c", str(path)])
    ((program,),) = (group.process_configs for group in options.process_group_configs)
    return shlex.split(program.command)


words = st.lists(st.text(st.characters(codec="utf-8", exclude_categories=("C", "Z"), include_characters=" ")), max_size=4)


@given(words)
@example(["%(ENV_HOME)s", "%(here)s", "%%", "%"])
@example(["a ; b", "; c", "a #b", "#", ";", "a;b", "a '; b", 'a " # b'])
@example(["$(touch /tmp/x)", "`x`", "&&", "|", ">y", "*", "~", "$HOME", "\\", "\\n", "'", '"'])
def test_arguments_reach_the_service_as_they_are(tmp_path_factory: pytest.TempPathFactory, given_words: list[str]) -> None:
    folder = tmp_path_factory.mktemp("conf")
    text = with_extra_arguments(TEXT, {"planner": shlex.join(given_words)})
    expected = ["python", "-m", "services.planner", "--folder", ".", *given_words]
    assert command_by_supervisor(text, folder) == expected
    (folder / "ours.conf").write_text(text)
    assert list(programs_of(folder / "ours.conf")["planner"].command) == expected


@pytest.mark.parametrize(
    ("extra", "reason"),
    [
        ({"pilot": "--x"}, "no such service in this deployment: pilot (--with); there is: planner"),
        ({"pi\x1b[2Jlot": "--x"}, "deployment: pi[2Jlot (--with)"),
        ({"planner": "--x 'unfinished"}, "no closing quotation in"),
        ({"planner": "'--x\n[program:evil]\ncommand=evil'"}, "one line of printable text"),
        ({"planner": "'\x1b[2J'"}, "one line of printable text"),
    ],
)
def test_arguments_that_cannot_be_handed_on_are_refused(extra: dict[str, str], reason: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        with_extra_arguments(TEXT, extra)
    assert reason in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_arguments_of_a_service_that_is_named_twice_are_joined(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    taken: dict[str, str] = {}

    def start(_self: Deployment, _logs: Path, extra: dict[str, str]) -> None:
        taken.update(extra)
        raise DeploymentError("far enough")

    monkeypatch.setattr(Deployment, "start", start)
    with pytest.raises(DeploymentError, match="far enough"):
        up(Up(folder=tmp_path, extra=("planner=--a 1", "seeker=--b", "planner=--c")))
    assert taken == {"planner": "--a 1 --c", "seeker": "--b"}
    with pytest.raises(DeploymentError, match="--with wants NAME"):
        up(Up(folder=tmp_path, extra=("planner",)))


def test_services_run_on_this_python_also_where_none_is_called_python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert with_this_interpreter(TEXT) == TEXT, "this environment has a `python`"
    lonely = tmp_path / "50% of a python" / "python3"
    lonely.parent.mkdir()
    lonely.symlink_to(sys.executable)
    monkeypatch.setattr(process_table.sys, "executable", str(lonely))
    assert command_by_supervisor(with_this_interpreter(TEXT), tmp_path)[:3] == [str(lonely), "-m", "services.planner"]


def test_every_deployment_names_python_where_it_is_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process_table.sys, "executable", "/nowhere/python3")
    for name in deployment.deployments():
        parser = configparser.RawConfigParser(inline_comment_prefixes=(";",))
        parser.read_string(with_this_interpreter(deployment.configuration_of(name).read_text()))
        commands = [parser[section]["command"] for section in parser.sections() if section.startswith("program:")]
        assert commands
        assert all(command.startswith("/nowhere/python3 -m ") for command in commands)


def test_the_length_of_a_folder_is_counted_in_bytes(tmp_path: Path) -> None:
    folder = Path("/tmp") / ("я" * 45)
    assert len(str(folder)) < deployment.LONGEST_FOLDER < len(os.fsencode(folder))
    with pytest.raises(DeploymentError, match="is too long for unix sockets"):
        Deployment("simulation", folder).start(tmp_path, {})
    assert not folder.exists()


@pytest.mark.parametrize("sign", "#?;")
def test_a_folder_that_the_bus_cannot_use_is_refused_before_anything_starts(tmp_path: Path, sign: str) -> None:
    with pytest.raises(DeploymentError, match="must not have"):
        Deployment("simulation", tmp_path / f"a{sign}b").start(tmp_path / "logs", {})
    assert not list(tmp_path.iterdir())


LIMITED = """
import os, resource, sys
from vantage.supervisor import SupervisorError, _raise_limit_on_open_files
resource.setrlimit(resource.RLIMIT_NOFILE, (256, int(sys.argv[1])))
if os.geteuid() == 0:
    os.setuid(65534)
try:
    _raise_limit_on_open_files()
except SupervisorError as error:
    sys.exit(str(error))
print(resource.getrlimit(resource.RLIMIT_NOFILE)[0])
"""


def test_the_limit_on_open_files_is_raised_as_far_as_it_may_be_else_named() -> None:
    assert resource.getrlimit(resource.RLIMIT_NOFILE)[1] >= 4096

    def limited(hard: int) -> subprocess.CompletedProcess[str]:
        return subprocess.run([sys.executable, "-c", LIMITED, str(hard)], capture_output=True, text=True, check=False)

    assert limited(4096).stdout == f"{OPEN_FILES}\n"
    refused = limited(256)
    assert (refused.returncode, refused.stdout) == (1, "")
    assert refused.stderr == "this shell may open 256 files, and a deployment needs 1024: `ulimit -n 1024` in a new shell\n"


def test_logs_that_cannot_be_written_are_named_before_anything_starts(home: Path) -> None:
    small = Deployment("simulation", home / "run")
    with pytest.raises(DeploymentError, match=r"^nothing can be recorded in /proc/nowhere: .* \(--logs\)$"):
        small.start(Path("/proc/nowhere"), {})
    assert not small.is_running()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can mount a small disk")
@pytest.mark.parametrize(("option", "reason"), [("size=16k", "No space left on device"), ("size=1m,ro", "Read-only file system")])
def test_a_disk_for_logs_that_is_full_or_read_only_is_named(home: Path, option: str, reason: str) -> None:
    disk = home / "disk"
    disk.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", option, "none", disk], capture_output=True, check=False).returncode:
        pytest.skip("this machine lets nobody mount a disk")
    try:
        with pytest.raises(DeploymentError, match=reason):
            Deployment("simulation", home / "run").start(disk, {})
        assert not list(disk.iterdir())
    finally:
        subprocess.run(["umount", disk], check=True)


@pytest.mark.parametrize("arena", ["", "two words", "a/b", "*", "a#b", "$x", "tëst", "x" * 65, "a\nb", "%(ENV_HOME)s"])
def test_an_arena_whose_name_cannot_be_in_a_key_is_one_line(home: Path, arena: str) -> None:
    with pytest.raises(UserError) as caught:
        ZenohBus("command-line", home, arena)
    assert len(str(caught.value).splitlines()) == 1
    assert not list(home.iterdir())


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        ("nowhere -m services.referee", "can't find command 'nowhere'"),
        ("python -m services.referee --folder . --arena 'two words'", "referee cannot start: arena 'two words' must be one word"),
    ],
)
def test_a_service_that_cannot_start_is_told_without_waiting_for_the_end(
    small: Small, home: Path, command: str, reason: str
) -> None:
    table = home / "compose" / "small.conf"
    table.write_text(table.read_text().replace("python -m services.referee --folder . --arena table", command))
    with pytest.raises(DeploymentError) as caught:
        up(Up(deployment="small", folder=small.folder, logs=small.logs, timeout=600.0))
    assert reason in str(caught.value)
    assert not small.deployment.is_running()


def test_what_a_service_could_not_start_for_is_given_once(home: Path) -> None:
    folder = home / "run"
    folder.mkdir(mode=0o700)
    (folder / "recorder.log").write_text("recorder cannot start: the disk is full\n" * 4)
    process = Process("recorder", "BACKOFF", 0, restarts=3, uptime=0.0, memory=0, complaint="Exited too quickly")
    text = diagnosis(Deployment("simulation", folder), [judge(process, None, 0.0)])
    assert text == "recorder cannot start: the disk is full"
