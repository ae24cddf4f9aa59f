"""Simulation, rehearsal and hardware differ in who embodies the robots, and in nothing else."""

from __future__ import annotations

import pytest

from tests.contract.tables import WORLD_KEYS
from vantage import check, deployment

WORLDS = {"simulation": {"simulator"}, "rehearsal": {"rehearsal", "tracker", "robot"}, "hardware": {"tracker", "robot"}}


def sections(name: str) -> dict[str, str]:
    """The text of each section of a process table, by its header."""
    text = deployment.configuration_of(name).read_text()
    parts = ("\n" + text).split("\n[")[1:]
    return {header: body.strip() for header, _, body in (part.partition("]\n") for part in parts)}


@pytest.mark.parametrize("name", ["rehearsal", "hardware"])
def test_only_the_processes_of_the_world_are_swapped(name: str) -> None:
    simulation, other = sections("simulation"), sections(name)
    swapped = {f"program:{service}" for service in WORLDS["simulation"] | WORLDS[name]}
    assert simulation.keys() ^ other.keys() == swapped
    kept = [header for header in simulation if header not in swapped]
    assert [header for header in other if header not in swapped] == kept
    assert {"program:planner", "program:seeker", "program:referee", "program:predictor", "program:recorder"} <= set(kept)
    for header in kept:
        assert other[header] == simulation[header]


@pytest.mark.parametrize("name", ["rehearsal", "hardware"])
def test_the_swapped_processes_are_run_like_all_others(name: str) -> None:
    def manners(section: str) -> set[str]:
        return {line for line in section.splitlines() if not line.startswith(("command=", "priority=", "stdout_logfile="))}

    table = sections(name)
    wanted = manners(table["program:referee"])
    for service in WORLDS[name]:
        assert manners(table[f"program:{service}"]) == wanted
        assert f"stdout_logfile={service}.log" in table[f"program:{service}"]


@pytest.mark.parametrize("name", ["rehearsal", "hardware"])
def test_the_table_is_sound(name: str) -> None:
    assert check.check(name) == []


def test_frames_without_a_publisher_are_sound_only_where_no_service_shows_any() -> None:
    services = [
        check.declaration_of(service) for service in ("tracker", "robot", "referee", "seeker", "planner", "predictor", "recorder")
    ]
    assert check.troubles_with_wiring(services) == []
    half = [*services, check.Declaration("rehearsal", outputs=("overhead/color",))]
    troubles = check.troubles_with_wiring(half)
    assert len(troubles) == 4
    assert all("/camera/" in trouble and "published by nobody" in trouble for trouble in troubles)


@pytest.mark.parametrize("name", sorted(WORLDS))
def test_whoever_embodies_the_robots_says_the_same(name: str) -> None:
    said = {key for service in WORLDS[name] for key in check.declaration_of(service).outputs}
    assert {key for key in WORLD_KEYS if not key.endswith(("track", "motion"))} <= said
