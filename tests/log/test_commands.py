"""`vantage log`, as people use it."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from mcap.reader import make_reader

from schemas import Gap, encode
from tests.log.making import game, records_of, write_log
from vantage.log import Record, read
from vantage.log.report import info

VANTAGE = Path(sys.executable).parent / "vantage"


def run(*words: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([VANTAGE, "log", *words], capture_output=True, text=True, check=False, env={"COLUMNS": "140"})


def test_info_counts_topics_rates_losses_and_games(tmp_path: Path) -> None:
    records = records_of([*game(1, 10, seed=5), *game(2, 4, seed=6, phase="aborted")], period=250_000_000)
    missing = [record for record in records if not (record.key == "tick" and record.sequence in (3, 4))]
    note = encode(Gap(stamp=1, key="tick", publisher="simulator", missed=2))
    missing.append(Record("gap", "recorder", 0, records[-1].log_time + 1, 0, note))
    write_log(tmp_path / "log.mcap", missing)
    (report,) = info(tmp_path / "log.mcap")
    assert report.count == len(missing)
    assert report.gaps == {"tick simulator": 2}
    ticks = report.topics["tick", "simulator"]
    assert (ticks.count, ticks.missing, ticks.malformed) == (12, 2, 0)
    times = [record.log_time for record in missing if record.key == "tick"]
    assert abs(ticks.rate - 11e9 / (times[-1] - times[0])) < 1e-6
    assert [(game.episode.seed, game.steps, game.episode.phase) for game in report.games] == [
        (5, 10, "ended"),
        (6, 4, "aborted"),
    ]
    outcome = run("info", tmp_path)
    assert outcome.returncode == 0, outcome.stderr
    for text in ("hider/pose", "survived", "aborted", "lost: 2 of tick simulator", "commit", "test"):
        assert text in outcome.stdout


def test_recover_makes_a_cut_log_whole(tmp_path: Path) -> None:
    records = records_of(game(1, 30))
    path = tmp_path / "cut.mcap"
    write_log(path, records, chunk_size=2000)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    told = run("info", path)
    assert told.returncode == 2
    assert "not closed" in told.stdout
    assert "breaks off" in told.stdout
    outcome = run("recover", path)
    assert outcome.returncode == 0, outcome.stderr
    whole = tmp_path / "cut-recovered.mcap"
    found = list(read(whole))
    assert found == records[: len(found)]
    assert f"{len(found)} messages" in outcome.stdout
    again = run("recover", path)
    assert again.returncode == 1
    assert "exists already" in again.stderr
    folder = run("recover", tmp_path, "--to", tmp_path / "all")
    assert folder.returncode == 0
    assert sorted(path.name for path in (tmp_path / "all").iterdir()) == ["cut-recovered.mcap", "cut.mcap"]


WAITS_BEFORE_THE_END = """
import sys, time
import vantage.output
from vantage import cli

def wait(partial):
    print("written", flush=True)
    time.sleep(600)

vantage.output._sync = wait
sys.argv = ["vantage", *sys.argv[1:]]
cli.main()
"""


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGKILL])
def test_an_interrupted_recovery_leaves_nothing_under_its_name(tmp_path: Path, sent: signal.Signals) -> None:
    write_log(tmp_path / "log.mcap", records_of(game(1, 3)))
    words = ("log", "recover", str(tmp_path / "log.mcap"), "--to", str(tmp_path / "new" / "whole.mcap"))
    command = [sys.executable, "-c", WAITS_BEFORE_THE_END, *words]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "written\n"
    assert list(tmp_path.glob("new/.whole*"))
    process.send_signal(sent)
    _, errors = process.communicate(timeout=120)
    assert process.returncode in (130, -signal.SIGKILL), errors
    assert not (tmp_path / "new" / "whole.mcap").exists()
    if sent == signal.SIGINT:
        assert list((tmp_path / "new").iterdir()) == []
        assert errors.startswith("vantage log recover: stopped") and errors.count("\n") == 1


def test_a_folder_is_recovered_where_it_was_interrupted(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_log(tmp_path / "logs" / f"{name}.mcap", records_of(game(1, 3)), keep_going=True)
    (tmp_path / "logs-recovered").mkdir()
    (tmp_path / "logs-recovered" / "a.mcap").write_bytes(b"finished before")
    done = run("recover", tmp_path / "logs")
    assert done.returncode == 0, done.stderr
    assert "a.mcap is there already, and was left as it is" in done.stdout.replace("\n", " ")
    assert (tmp_path / "logs-recovered" / "a.mcap").read_bytes() == b"finished before"
    assert len(list(read(tmp_path / "logs-recovered" / "b.mcap"))) == len(records_of(game(1, 3)))


def test_export_opens_in_other_programs(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    write_log(path, records_of(game(1, 5)))
    outcome = run("export", path)
    assert outcome.returncode == 0, outcome.stderr
    assert (tmp_path / "log-viewer.layout.json").is_file()
    with (tmp_path / "log-viewer.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert {"foxglove.RawImage", "foxglove.PoseInFrame", "foxglove.SceneUpdate"} <= {s.name for s in summary.schemas.values()}


def test_mistakes_are_said_in_one_line(tmp_path: Path) -> None:
    for words in (("info", tmp_path), ("export", tmp_path / "none.mcap"), ("recover", tmp_path / "none.mcap")):
        outcome = run(*words)
        assert outcome.returncode == 1
        assert "no log" in outcome.stderr or "no such log" in outcome.stderr
        assert "Traceback" not in outcome.stderr
