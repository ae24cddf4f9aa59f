"""What runs in a folder is found whatever became of supervisord, its socket and its files; nothing starts beside it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.deployment.conftest import Small
from vantage.bus.names import is_held
from vantage.bus.zenoh_bus import ZenohBus
from vantage.deployment import Deployment, DeploymentError, Stopped
from vantage.supervisor import Supervisor

VANTAGE = Path(sys.executable).parent / "vantage"


def sweep(folder: Path) -> None:
    """Remove what a cleaner of /tmp removes."""
    for path in (*folder.glob("*.sock*"), folder / "supervisord.pid"):
        path.unlink(missing_ok=True)


def refusal(small: Small) -> str:
    with pytest.raises(DeploymentError) as caught:
        small.start()
    return str(caught.value)


def test_services_end_with_a_supervisord_that_is_killed(small: Small) -> None:
    small.start()
    small.wait_for_service()
    (supervisor,) = small.named("supervisord")
    os.kill(supervisor.pid, signal.SIGKILL)
    small.wait(lambda: not small.named("referee"), "the referee ends by itself", 20.0)
    with pytest.raises(DeploymentError, match="is not up in"):
        small.deployment.processes()
    assert small.deployment.stop() == Stopped()


@contextmanager
def orphan(small: Small) -> Iterator[subprocess.Popen[bytes]]:
    """Run a referee in the folder that no supervisord knows, as one that cannot hear of its supervisord's death would."""
    small.folder.mkdir(mode=0o700, exist_ok=True)
    command = [sys.executable, "-m", "services.referee", "--folder", ".", "--arena", "table"]
    with subprocess.Popen(command, cwd=small.folder, stderr=subprocess.DEVNULL) as running:
        try:
            small.wait(lambda: small.named("referee") and is_held(small.folder / "referee.sock.lock"), "the referee runs")
            yield running
        finally:
            running.kill()


def test_a_service_without_supervisord_is_found_and_ended(small: Small) -> None:
    small.start()
    small.wait_for_service()
    os.kill(small.named("supervisord")[0].pid, signal.SIGKILL)
    small.wait(lambda: not small.named("referee"), "the referee ends by itself", 20.0)
    with orphan(small) as referee:
        gone = f"supervisord is gone; 1 service (referee) still runs in {small.folder}"
        for ask in (small.deployment.processes, small.start):
            with pytest.raises(DeploymentError) as caught:
                ask()
            assert str(caught.value) == f"{gone}: `vantage down small --folder {small.folder}`"
            assert small.deployment.is_running()
            sweep(small.folder)
        assert [occupant.pid for occupant in small.named("referee")] == [referee.pid], "nothing was started beside it"
        assert small.deployment.stop() == Stopped(supervisor=False, orphans=("referee",))
        assert referee.wait(5.0) in (0, -signal.SIGTERM)
    assert not small.deployment.is_running()
    small.start()
    small.wait_for_service()
    assert small.deployment.stop() == Stopped(supervisor=True)


def test_a_service_that_hears_no_signal_is_ended_by_force(small: Small) -> None:
    with orphan(small) as referee:
        os.kill(referee.pid, signal.SIGSTOP)
        assert small.deployment.stop() == Stopped(supervisor=False, orphans=("referee",))
        assert referee.wait(5.0) == -signal.SIGKILL


def test_a_deployment_whose_files_were_swept_away_is_found_and_ended(small: Small) -> None:
    small.start()
    small.wait_for_service()
    sweep(small.folder)
    (supervisor,) = small.named("supervisord")
    assert small.deployment.is_running()
    assert not small.deployment.is_supervised()
    with pytest.raises(DeploymentError, match=rf"supervisord \(process {supervisor.pid}\) runs in .* but does not answer"):
        small.deployment.processes()
    assert "does not answer" in refusal(small)
    assert len(small.named("referee")) == 1
    assert small.deployment.stop().supervisor
    assert not small.deployment.is_running()


def test_the_commands_say_what_runs_and_what_they_end(small: Small) -> None:
    """With the process table of `replay`, which they know; the folder is what counts."""

    def command(*words: str) -> tuple[int, str, str]:
        outcome = subprocess.run([VANTAGE, *words, "--folder", small.folder], capture_output=True, text=True, check=False)
        return outcome.returncode, outcome.stdout.strip(), outcome.stderr.strip()

    with orphan(small):
        code, _, complaint = command("status", "replay")
        assert code == 1
        assert complaint.startswith("vantage status: supervisord is gone; 1 service (referee) still runs in")
        ended = "replay is down: supervisord was gone, 1 service (referee) still ran and was ended"
        assert command("down", "replay")[:2] == (0, ended)
    assert command("down", "replay")[1].startswith("replay was not up in")


def test_a_second_start_is_refused_and_harms_nothing(small: Small) -> None:
    small.start()
    referee = small.wait_for_service()
    before = sorted(path.name for path in small.folder.iterdir())
    assert "small is up already in" in refusal(small)
    assert sorted(path.name for path in small.folder.iterdir()) == before
    assert small.named("referee")[0].pid == referee
    assert small.deployment.stop() == Stopped(supervisor=True)


def test_a_start_waits_for_a_deployment_that_is_ending(small: Small) -> None:
    small.start()
    before = int((small.folder / "supervisord.pid").read_text())
    os.kill(small.wait_for_service(), signal.SIGSTOP)  # it ends by force only, after some seconds
    Supervisor(small.folder).shutdown()
    assert Supervisor(small.folder).is_ending()
    Supervisor(small.folder).shutdown()
    small.start()
    # A service that is being started looks like its supervisord for a moment.
    assert before not in [supervisor.pid for supervisor in small.named("supervisord")]


def test_a_name_that_is_taken_on_the_bus_is_one_line_and_its_socket_stays(small: Small) -> None:
    with ZenohBus("referee", small.folder):
        text = refusal(small)
        assert text == f"referee: on the bus in {small.folder} already, started by hand or in a container: stop that first"
        assert (small.folder / "referee.sock").is_socket()
        assert small.deployment.is_running()
    with ZenohBus("watch-1", small.folder):  # who only listens may stay
        small.start()
        assert (small.folder / "watch-1.sock").is_socket()
        assert (small.folder / "watch-1.sock.lock").is_file()
        small.wait_for_service()
        small.deployment.stop()


def test_a_deleted_folder_hides_nothing(small: Small) -> None:
    small.start()
    small.wait_for_service()
    subprocess.run(["rm", "-r", small.folder], check=True)
    assert [occupant.name for occupant in (*small.named("supervisord"), *small.named("referee"))] == ["supervisord", "referee"]
    assert "does not answer" in refusal(small)
    assert small.deployment.stop().supervisor
    assert not small.named("referee")


def test_a_folder_that_is_not_there_holds_nothing(home: Path) -> None:
    deployment = Deployment("simulation", home / "never")
    assert deployment.stop() == Stopped()
    assert not deployment.is_running()
    with pytest.raises(DeploymentError, match="is not up in"):
        deployment.processes()
    assert not (home / "never").exists()
