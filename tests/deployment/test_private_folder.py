"""Another user can put nothing in the place of a deployment's folder: it is refused before anything is read or run."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from vantage.deployment import CONFIGURATION, CONSOLE_ADDRESS, Deployment
from vantage.private_folder import NotPrivate, is_private, make_private

OTHER = 65534
root_only = pytest.mark.skipif(os.geteuid() != 0, reason="only root can act as another user")


@pytest.fixture
def folder(home: Path) -> Path:
    return home / "parent" / "run"


@pytest.fixture
def shared() -> Iterator[Path]:
    """A folder like /tmp: everybody may write, nobody may rename what belongs to others."""
    path = Path(tempfile.mkdtemp(prefix="v", dir="/tmp"))
    path.chmod(0o1777)
    yield path
    shutil.rmtree(path, ignore_errors=True)


def as_other(program: str, *arguments: object) -> None:
    """Run a program as another user, who need not be able to read this Python."""
    become = f"import os, sys\nos.setgroups([]); os.setgid({OTHER}); os.setuid({OTHER})\n"
    subprocess.run([sys.executable, "-c", become + program, *map(str, arguments)], check=True)


def test_it_is_made_with_its_parents_for_its_owner_alone(folder: Path) -> None:
    assert not is_private(folder)
    make_private(folder)
    assert is_private(folder)
    assert [path.stat().st_mode & 0o777 for path in (folder, folder.parent)] == [0o700, 0o700]


@pytest.mark.parametrize("mode", [0o777, 0o755, 0o710, 0o702])
def test_a_folder_that_others_can_enter_is_refused(folder: Path, mode: int) -> None:
    make_private(folder)
    folder.chmod(mode)
    with pytest.raises(NotPrivate, match="is open to other users"):
        is_private(folder)
    with pytest.raises(NotPrivate, match="is open to other users"):
        make_private(folder)


@pytest.mark.parametrize("mode", [0o777, 0o772, 0o703])
def test_a_parent_in_which_others_can_rename_it_is_refused(folder: Path, mode: int) -> None:
    make_private(folder)
    folder.parent.chmod(mode)
    with pytest.raises(NotPrivate, match=f"{folder.parent} can be changed by other users"):
        is_private(folder)


def test_a_sticky_parent_and_one_that_others_can_only_read_are_good(folder: Path) -> None:
    make_private(folder)
    for mode in (0o1777, 0o755, 0o711):
        folder.parent.chmod(mode)
        assert is_private(folder)


def test_links_on_the_way_are_followed_and_judged_but_the_folder_is_no_link(home: Path, folder: Path) -> None:
    make_private(folder)
    (home / "way").symlink_to(folder.parent)
    (home / "round").symlink_to(f"parent/../{folder.parent.name}")
    (home / "link").symlink_to(folder)
    (home / "loop").symlink_to(home / "loop")
    assert is_private(home / "way" / "run")
    assert is_private(home / "round" / "run")
    for place in (home / "link", home / "loop" / "run"):
        with pytest.raises(NotPrivate, match="not a folder of its own"):
            is_private(place)
    folder.parent.chmod(0o777)
    with pytest.raises(NotPrivate, match="can be changed by other users"):
        is_private(home / "way" / "run")


@root_only
def test_a_parent_that_another_user_made_first_is_refused(shared: Path) -> None:
    """The attack: they make /tmp/vantage-UID, wait for the folder in it, and put their own in its place."""
    parent = shared / "vantage-0"
    as_other("os.mkdir(sys.argv[1]); os.chmod(sys.argv[1], 0o777)", parent)
    deployment = Deployment("simulation", parent / "simulation")
    with pytest.raises(NotPrivate, match=f"{parent} belongs to user {OTHER}, not to you"):
        deployment.start(shared / "logs", {})
    assert not (parent / "simulation").exists()
    assert not (shared / "logs").exists()
    as_other("os.rmdir(sys.argv[1]); os.symlink('/root', sys.argv[1])", parent)
    with pytest.raises(NotPrivate, match=f"{parent} belongs to user {OTHER}"):
        deployment.start(shared / "logs", {})


@root_only
def test_a_supervisord_of_another_user_is_not_believed(shared: Path) -> None:
    """Nor are their process table, their logs and their console's address read."""
    parent = shared / "vantage-0"
    program = f"""
os.makedirs(sys.argv[1] + "/simulation")
os.chmod(sys.argv[1], 0o777)
os.chdir(sys.argv[1] + "/simulation")
open("{CONFIGURATION}", "w").write("[program:evil]\\ncommand=evil\\n")
open("{CONSOLE_ADDRESS}", "w").write("http://evil.example")
open("recorder.log", "w").write("\\x1b]0;evil\\x07")
"""
    as_other(program, parent)
    deployment = Deployment("simulation", parent / "simulation")
    for ask in (
        lambda: deployment.programs,
        deployment.is_running,
        deployment.is_supervised,
        deployment.processes,
        deployment.stop,
        deployment.console_address,
        lambda: deployment.log_of("recorder"),
        lambda: deployment.tail("recorder"),
    ):
        with pytest.raises(NotPrivate, match=f"{parent} belongs to user {OTHER}"):
            ask()


def test_what_a_service_printed_is_shown_without_what_a_terminal_obeys(folder: Path) -> None:
    make_private(folder)
    (folder / "recorder.log").write_text("one\n\x1b]0;evil\x07two\u202e\n")
    assert Deployment("simulation", folder).tail("recorder") == "one\n]0;eviltwo"
