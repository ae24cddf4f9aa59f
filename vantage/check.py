"""The static check of a deployment: nothing runs, everything that can be known beforehand is looked at."""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import io
from collections.abc import Iterable, Mapping
from pathlib import Path

from schemas import CALLS, TOPICS
from schemas.topics import CAMERAS, HIDER
from vantage.deployment import configuration_of
from vantage.process_table import Program, programs_of
from vantage.service import Declaration

PEOPLE = {"control"}
"""Topics that people publish from the command line or the console: no service of a deployment has to."""


def _may_lack_publisher(key: str, services: Iterable[str]) -> bool:
    """Whether a deployment is sound although nobody in it publishes the key.

    People do, or it is some service's health, or the frames of a camera: where no service shows frames, cameras are devices.
    """
    if key in PEOPLE or key.startswith("health/"):
        return True
    return TOPICS[key].publishers == CAMERAS and set(CAMERAS).isdisjoint(services)


def _may_share(key: str) -> bool:
    """Return whether several services of a deployment may publish the key: wishes, and what drives the hider."""
    return key in PEOPLE or TOPICS[key].publishers == HIDER


def declaration_of(service: str) -> Declaration:
    """Return what a service declares in `services/NAME/declaration.py`.

    Raises:
        ImportError, AttributeError: it has none.
    """
    declaration: Declaration = importlib.import_module(f"services.{service}.declaration").DECLARATION
    return declaration


def trouble_with_command(program: Program) -> str:
    """Return what is wrong with a program's command line, empty when it would start: module and every argument are looked at."""
    words = program.command
    expected = ("python", "-m", f"services.{program.name}")
    if words[:3] != expected:
        return f"{program.name}: the command must begin with `{' '.join(expected)}`, not `{' '.join(words[:3])}`"
    module = f"services.{program.name}"
    try:
        found = importlib.util.find_spec(f"{module}.__main__")
    except ModuleNotFoundError:
        found = None
    if found is None:
        return f"{program.name}: there is no module {module} to run"
    import tyro

    settings = importlib.import_module(f"{module}.__main__").Settings
    printed = io.StringIO()
    try:
        with contextlib.redirect_stderr(printed), contextlib.redirect_stdout(printed):
            tyro.cli(settings, args=list(words[3:]))
    except SystemExit:
        return f"{program.name}: `{' '.join(words)}` is refused:\n{printed.getvalue().strip()}"
    return ""


def troubles_with_wiring(declarations: Iterable[Declaration]) -> list[str]:
    """Return what does not fit together: an input without exactly one publisher, a call without exactly one server, and so on."""
    declarations = list(declarations)
    troubles = []
    publishers: dict[str, list[str]] = {}
    servers: dict[str, list[str]] = {}
    here = {declaration.name for declaration in declarations}
    for declaration in declarations:
        for key in declaration.outputs:
            publishers.setdefault(key, []).append(declaration.name)
        for key in declaration.serves:
            servers.setdefault(key, []).append(declaration.name)
    for declaration in declarations:
        if not declaration.raw:
            for key in declaration.inputs:
                found = publishers.get(key, [])
                if not found and (declaration.audience or _may_lack_publisher(key, here)):
                    continue
                if len(found) != 1 and not (found and _may_share(key)):
                    troubles.append(f"{declaration.name} hears {key}, published by {_listed(found)} (exactly one must)")
        troubles.extend(
            f"{declaration.name} publishes {key}, which the topic table does not allow it"
            for key in declaration.outputs
            if declaration.name not in TOPICS[key].publishers
        )
        for key in declaration.calls:
            found = servers.get(key, [])
            if len(found) != 1:
                troubles.append(f"{declaration.name} calls {key}, served by {_listed(found)} (exactly one must)")
        troubles.extend(
            f"{declaration.name} serves {key}, which the call table does not allow it"
            for key in declaration.serves
            if declaration.name != CALLS[key].server
        )
        missing = [names for names in sorted(declaration.heeds) if here.isdisjoint(names.split("|"))]
        if missing:
            waited_for = _listed(names.replace("|", " or ") for names in missing)
            troubles.append(f"{declaration.name} waits for {waited_for}, which this deployment does not have")
    for key, found in publishers.items():
        if len(found) > 1 and not _may_share(key):
            troubles.append(f"{key} is published by {_listed(found)} (only one may)")
    return troubles


def troubles_of(programs: Mapping[str, Program]) -> list[str]:
    """Return everything wrong with a process table, each as one text for people; empty when it is sound."""
    troubles = [trouble for program in programs.values() if (trouble := trouble_with_command(program))]
    declarations = []
    for name in programs:
        try:
            declaration = declaration_of(name)
        except (ImportError, AttributeError) as error:
            troubles.append(f"{name}: no declaration: {error}")
            continue
        if declaration.name != name:
            troubles.append(f"{name}: its declaration is named {declaration.name}")
        declarations.append(declaration)
    return troubles + troubles_with_wiring(declarations)


def check(deployment: str) -> list[str]:
    """Return everything wrong with a deployment of `compose/`.

    Raises:
        DeploymentError: there is no such deployment.
    """
    path: Path = configuration_of(deployment)
    return troubles_of(programs_of(path))


def _listed(names: Iterable[str]) -> str:
    return ", ".join(names) or "nobody"
