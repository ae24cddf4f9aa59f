"""The checks of `vantage table check`: of a running deployment, of pictures from above."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from schemas import ROBOTS, Robot
from vantage.deployment import Deployment, configuration_of
from vantage.setting_up.calibrating import today
from vantage.setting_up.listening import Heard, judge_heard, listen
from vantage.setting_up.picture_check import check_picture
from vantage.setting_up.pictures import open_source, require_size, write_picture
from vantage.setting_up.progress import progress
from vantage.setting_up.robot_view import check_robot_view
from vantage.setting_up.settings import Check
from vantage.setting_up.verdict import Verdict
from vantage.tracking.calibration import Calibration, load_calibration
from vantage.tracking.errors import UnusableCalibration
from vantage.tracking.rgbd import load_rgbd, prepare
from vantage.tracking.table import Table, default_table, load_table


def check_table(settings: Check) -> list[Verdict]:
    """Check what the settings name; annotated pictures are written into their folder.

    Raises:
        DeploymentError: there is no such deployment, or it is not up.
        TableTrouble, UnusableTable: source or table cannot be used.
    """
    name = settings.deployment or ("" if settings.source else "hardware")
    if name:
        configuration_of(name)  # a misspelt name is not a deployment that is down
    deployment = Deployment(name, settings.folder) if name else None
    folders = [Path(), *([deployment.folder] if deployment else [])]
    table_file = settings.table or _first("table.json", folders)
    table = default_table() if table_file is None else load_table(table_file)
    verdicts: list[Verdict] = []
    calibration = _calibration(settings, folders, verdicts)
    if deployment is not None:
        verdicts += _check_deployment(settings, deployment, table, calibration)
    if settings.source:
        verdicts += _check_source(settings, table, calibration)
    return verdicts


def _check_deployment(settings: Check, deployment: Deployment, table: Table, calibration: Calibration | None) -> list[Verdict]:
    # Zenoh is imported late: who checks pictures must not wait for it.
    from vantage.bus.zenoh_bus import ZenohBus

    processes = deployment.processes()
    doing = f"listening to {deployment.name} for {settings.seconds:g} s"
    with progress(doing) as say, ZenohBus(f"watch-{os.getpid()}", deployment.folder, settings.arena) as bus:
        heard = listen(bus, settings.seconds, lambda passed: say(f"{doing}: {passed:.0f} s"))
    verdicts = judge_heard(heard, deployment.name, processes, len(table.obstacles))
    picture = heard.last_picture("overhead/color")
    if picture is not None:
        found, annotated = check_picture(picture, table, calibration)
        write_picture(settings.to / "overhead.png", annotated)
        verdicts += found
    for robot in ROBOTS:
        verdicts += _check_robot_view(settings, deployment, heard, robot)
    return verdicts


def _check_robot_view(settings: Check, deployment: Deployment, heard: Heard, robot: Robot) -> list[Verdict]:
    """What a robot's camera sees: from its raw frames where they are on the bus, else from the last step of a game."""
    raw = heard.robot_pictures(robot, raw=True)
    found = _first(f"{robot}.json", [Path(), deployment.folder])
    if raw is not None and found is not None:
        depth, color, _ = prepare(raw[1], raw[0], load_rgbd(found))
        age = raw[2]
    else:
        published = heard.robot_pictures(robot, raw=False)
        if published is None:
            return [Verdict(f"{robot}'s camera", "not seen: its pictures are published in games; play one and check again")]
        color, depth, age = published
    verdicts, shown = check_robot_view(robot, color, depth, age)
    write_picture(settings.to / f"{robot}.png", shown)
    return verdicts


def _check_source(settings: Check, table: Table, calibration: Calibration | None) -> list[Verdict]:
    verdicts: list[Verdict] = []
    with progress("looking") as say, open_source(settings.source, *settings.mode) as source:
        for number, view in enumerate(source.views, 1):
            if calibration is not None:
                require_size(view, calibration.width, calibration.height, "the calibration")
            say(f"looking at {view.name}")
            found, annotated = check_picture(view.picture, table, calibration)
            name = "camera" if source.live else Path(view.name).stem
            write_picture(settings.to / f"{name}.png", annotated)
            if not source.live and source.count != 1:
                found = [replace(verdict, what=f"{view.name}: {verdict.what}") for verdict in found]
            verdicts += found
            if source.live or number >= settings.most:
                break
        else:
            if not verdicts:
                source.first()
    return verdicts


def _calibration(settings: Check, folders: Sequence[Path], verdicts: list[Verdict]) -> Calibration | None:
    found = settings.calibration or _first("overhead.json", folders)
    if found is None:
        remedy = "run `vantage table calibrate arena`, or name the file with --calibration"
        verdicts.append(Verdict("calibration", "there is no overhead.json", remedy))
        return None
    try:
        return load_calibration(found, settings.width, settings.height, today())
    except UnusableCalibration as error:
        verdicts.append(Verdict("calibration", "cannot be used", str(error)))
        return None


def _first(name: str, folders: Sequence[Path]) -> Path | None:
    return next((folder / name for folder in folders if (folder / name).is_file()), None)
