"""The process table, its static check, and the container files that repeat it."""

from __future__ import annotations

import configparser
import shlex
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from schemas import ROBOTS
from vantage import check, deployment
from vantage.process_table import Program, programs_of, with_extra_arguments
from vantage.service import Declaration

ROOT = Path(__file__).resolve().parents[2]
COMPOSE = ROOT / "compose"


def programs(name: str = "simulation") -> dict[str, Program]:
    return programs_of(deployment.configuration_of(name))


@pytest.mark.parametrize("name", deployment.deployments())
def test_every_deployment_is_sound(name: str) -> None:
    assert check.check(name) == []


def test_a_missing_module_is_found() -> None:
    table = {**programs(), "pilot": Program("pilot", ("python", "-m", "services.pilot"), 70)}
    assert any("no module services.pilot" in trouble for trouble in check.troubles_of(table))


def test_an_argument_that_a_service_does_not_know_is_found() -> None:
    seeker = programs()["seeker"]
    assert "refused" in check.trouble_with_command(replace(seeker, command=(*seeker.command, "--no-such-option", "1")))


def test_a_missing_publisher_a_second_one_and_a_missing_server_are_found() -> None:
    table = programs()
    del table["predictor"]
    del table["seeker"]
    troubles = check.troubles_of(table)
    assert any("hears seeker/command, published by nobody" in trouble for trouble in troubles)
    assert any("planner calls predictor, served by nobody" in trouble for trouble in troubles)
    twins = [Declaration(name, outputs=("hider/pose",)) for name in ("simulator", "tracker")]
    assert check.troubles_with_wiring(twins) == ["hider/pose is published by simulator, tracker (only one may)"]


def test_who_drives_the_hider_may_change_from_game_to_game() -> None:
    players = [Declaration(name, outputs=("hider/command",)) for name in ("planner", "console")]
    assert check.troubles_with_wiring([*players, Declaration("simulator", inputs=("hider/command",))]) == []


def test_an_audience_needs_nobody_to_listen_to() -> None:
    assert check.troubles_with_wiring([Declaration("console", inputs=("episode",), audience=True)]) == []
    assert check.troubles_with_wiring([Declaration("seeker", inputs=("episode",))]) != []


def test_somebody_who_may_not_publish_is_found() -> None:
    assert "does not allow" in check.troubles_with_wiring([Declaration("planner", outputs=("episode",))])[0]


def test_every_topic_of_a_game_is_published() -> None:
    published = {key for name in programs() for key in check.declaration_of(name).outputs}
    robots = {f"{robot}/{part}" for robot in ROBOTS for part in ("pose", "depth", "color", "command", "view")}
    assert {"episode", "tick", "layout", "hider/plan"} | robots | {f"health/{name}" for name in programs()} <= published


def test_the_recorder_starts_first_and_stops_last() -> None:
    table = programs()
    assert next(iter(table)) == "recorder"
    assert sorted(program.priority for program in table.values())[0] < sorted(program.priority for program in table.values())[1]


def test_every_program_restarts_and_stops_alike() -> None:
    parser = configparser.RawConfigParser(inline_comment_prefixes=(";",))
    parser.read(COMPOSE / "simulation.conf")
    for name in programs():
        section = parser[f"program:{name}"]
        assert section["stdout_logfile"] == f"{name}.log"
        rest = {key: value for key, value in section.items() if key not in ("command", "priority", "stdout_logfile")}
        assert rest == {
            "autorestart": "true",
            "startsecs": "1",
            "startretries": "1000",
            "stopsignal": "TERM",
            "stopwaitsecs": "3",
            "redirect_stderr": "true",
            "stdout_logfile_maxbytes": "2MB",
            "stdout_logfile_backups": "2",
        }


def test_extra_arguments_go_to_the_right_command_and_nowhere_else(tmp_path: Path) -> None:
    text = (COMPOSE / "simulation.conf").read_text()
    changed = tmp_path / "changed.conf"
    changed.write_text(with_extra_arguments(text, {"seeker": "--preset '100% expert'"}))
    before, after = programs(), programs_of(changed)
    assert after.pop("seeker").command == (*before.pop("seeker").command, "--preset", "100% expert")
    assert after == before


def test_containers_run_the_commands_of_the_process_table() -> None:
    document = yaml.safe_load((COMPOSE / "docker-compose.yml").read_text())
    services = document["services"]
    outside = {"console": ("--host", "0.0.0.0")}  # its page is to be reached from the machine that runs the containers
    assert {name: tuple(shlex.split(service["command"])) for name, service in services.items()} == {
        name: program.command + outside.get(name, ()) for name, program in programs().items()
    }
    volumes = set(document["volumes"])
    for name, service in services.items():
        assert set(service) <= {
            "image", "build", "command", "depends_on", "init", "network_mode", "restart", "stop_signal", "stop_grace_period",
            "volumes", "working_dir", "ports",
        }  # fmt: skip
        assert service["network_mode"] == ("bridge" if name == "console" else "none")
        assert all(port.startswith("127.0.0.1:") for port in service.get("ports", ()))
        assert service["restart"] == "always"
        assert set(service.get("depends_on", ())) <= set(services)
        for volume in service["volumes"]:
            source, target = volume.split(":")
            assert source in volumes or source.startswith("../")
            assert target.startswith(service["working_dir"]), name
    (build,) = (service["build"] for service in services.values() if "build" in service)
    assert (COMPOSE / build["context"] / build["dockerfile"]).resolve() == COMPOSE / "Dockerfile"


def instructions(dockerfile: str) -> list[tuple[str, str]]:
    """Parse a container file: (instruction, arguments), comments dropped, continued lines joined."""
    lines = "\n".join(line for line in dockerfile.splitlines() if not line.lstrip().startswith("#")).replace("\\\n", " ")
    return [(word, rest.strip()) for word, _, rest in (line.partition(" ") for line in lines.splitlines() if line.strip())]


def test_the_container_file_copies_what_exists_and_runs_as_a_plain_user() -> None:
    parsed = instructions((COMPOSE / "Dockerfile").read_text())
    assert parsed[0][0] == "FROM"
    known = {"FROM", "RUN", "USER", "WORKDIR", "ENV", "COPY", "VOLUME", "CMD"}
    assert {word for word, _ in parsed} <= known
    admitted = [line.removeprefix("!") for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")]
    copied = [
        source
        for word, rest in parsed
        if word == "COPY"
        for source in [part for part in rest.split() if not part.startswith("--")][:-1]
    ]
    assert sorted(copied) == sorted(admitted)
    assert all((ROOT / source).exists() for source in copied)
    assert {"schemas", "vantage", "services", "learning", "compose", "weights"} <= set(copied)
    users = [rest for word, rest in parsed if word == "USER"]
    assert users == ["vantage"]
    working = [rest for word, rest in parsed if word == "WORKDIR"][-1]
    assert working == yaml.safe_load((COMPOSE / "docker-compose.yml").read_text())["x-service"]["working_dir"]
