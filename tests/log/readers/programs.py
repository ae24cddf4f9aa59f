"""Other people's readers: how each is installed, and what it must find in our exports."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import venv
from pathlib import Path

import numpy as np

from schemas import PRIMITIVES
from services.recorder.appearance import arena_appearance
from vantage.log import open_log, read
from vantage.log.episodes import games_of
from vantage.log.export_formats import export_to
from vantage.log.lerobot_features import Choice
from vantage.perception.palette import PALETTE

HERE = Path(__file__).parent
FOLDER = Path(tempfile.gettempdir()) / "vantage-readers"
INSTALL = "python -m tests.log.readers"
"""What installs the readers and runs all checks."""
NODE_PACKAGES = ("@mcap/core", "@mcap/nodejs", "@mcap/support")
LEROBOT = ("lerobot==0.4.4", "torchvision==0.28.0", "accelerate")
LEROBOT_NEEDS = ("datasets>=4,<5", "huggingface-hub<0.36", "pandas", "jsonlines")
OFFLINE = {"HF_HUB_OFFLINE": "1", "HF_DATASETS_OFFLINE": "1", "HF_HUB_DISABLE_TELEMETRY": "1"}
LOOKS = arena_appearance()


def run(*words: str | Path, **options: object) -> str:
    """Run a program; return what it printed. Raises RuntimeError with its last lines when it failed."""
    done = subprocess.run([str(word) for word in words], capture_output=True, text=True, check=False, **options)  # type: ignore[call-overload]
    if done.returncode:
        raise RuntimeError(f"{words[0]} failed:\n" + "\n".join((done.stderr or done.stdout).splitlines()[-15:]))
    return str(done.stdout)


def has_node() -> bool:
    return shutil.which("node") is not None and (FOLDER / "node" / "node_modules" / "@mcap" / "core").is_dir()


def install_node() -> None:
    """Needs node and npm."""
    (FOLDER / "node").mkdir(parents=True, exist_ok=True)
    run("npm", "install", "--silent", "--no-fund", "--no-audit", "--prefix", FOLDER / "node", *NODE_PACKAGES)


def check_node(log: Path, work: Path) -> str:
    """`@mcap/core`, CRCs validated: by the index and as a stream, the same messages as our reader finds."""
    target = work / "for-foxglove.mcap"
    export_to("foxglove", log, target, LOOKS)
    found = json.loads(run("node", HERE / "check_mcap.mjs", target, FOLDER / "node"))
    ours: dict[str, int] = {}
    for record in read(target, viewer=True):
        ours[record.key] = ours.get(record.key, 0) + 1
    assert found["topics"] == ours
    return f"{found['messages']} messages of {len(ours)} topics, CRCs valid"


def check_rerun_mcap(log: Path, work: Path) -> str:
    """`rerun mcap check` on the copy for Foxglove."""
    target = work / "for-rerun.mcap"
    export_to("foxglove", log, target, LOOKS)
    said = run(Path(sys.executable).parent / "rerun", "mcap", "check", target)
    return said.strip().splitlines()[-1] if said.strip() else "no complaint"


def check_rerun_recording(log: Path, work: Path) -> str:
    """`rerun rrd verify` on every game."""
    export_to("rerun", log, work / "rerun", LOOKS)
    recordings = sorted((work / "rerun").glob("*.rrd")) or [work / "rerun"]
    run(Path(sys.executable).parent / "rerun", "rrd", "verify", *recordings)
    return f"{len(recordings)} recordings verified"


def lerobot_python() -> Path:
    return FOLDER / "lerobot" / "bin" / "python"


def has_lerobot() -> bool:
    return (FOLDER / "lerobot" / "complete").is_file()


def install_lerobot() -> None:
    """An environment of its own that borrows our torch, numpy and pyarrow: LeRobot's pins would fetch gigabytes."""
    folder = FOLDER / "lerobot"
    shutil.rmtree(folder, ignore_errors=True)
    venv.create(folder, with_pip=True)
    place = run(lerobot_python(), "-c", "import sysconfig; print(sysconfig.get_path('purelib'))").strip()
    (Path(place) / "borrowed.pth").write_text(sysconfig.get_path("purelib") + "\n")
    pip = (lerobot_python(), "-m", "pip", "install", "--quiet", "--disable-pip-version-check")
    pins = folder / "pins.txt"
    versions = {
        name: run(sys.executable, "-c", f"import {name}; print({name}.__version__)").strip() for name in ("torch", "numpy")
    }
    pins.write_text("".join(f"{name}=={version.partition('+')[0]}\n" for name, version in versions.items()))
    run(*pip, "--no-deps", *LEROBOT)
    run(*pip, "--constraint", pins, *LEROBOT_NEEDS)
    (folder / "complete").touch()


def check_lerobot(log: Path, work: Path) -> str:
    """LeRobot's own loader: pixels, depth, times, actions and boundaries of every episode as the log has them."""
    export_to("lerobot", log, work / "dataset", LOOKS, choice=Choice(seeker_pictures=True, without_catching=True))
    np.savez(work / "expected.npz", **expected_frames(log))  # type: ignore[arg-type]
    environment = {**os.environ, **OFFLINE, "HF_HOME": str(work / "hugging-face")}
    found = json.loads(
        run(
            lerobot_python(), HERE / "check_lerobot.py", work / "dataset", work / "expected.npz", env=environment, cwd=work
        ).splitlines()[-1]
    )
    return f"{found['episodes']} episodes, {found['frames']} frames, {found['values']} values equal"


def expected_frames(log: Path) -> dict[str, np.ndarray]:
    """What a data set of a log must hold: feature -> frames, from `games_of`, which the export does not use."""
    frames: dict[str, list[np.ndarray]] = {}
    lengths = []

    def add(name: str, value: object, kind: str) -> None:
        frames.setdefault(name, []).append(np.asarray(value, kind))

    with open_log(log) as opened:
        for game in games_of(opened):
            if not game.complete or not game.steps:
                continue
            lengths.append(game.steps)
            start = game.colors["hider"][0].stamp
            for step in range(game.steps):
                for robot, place in (("hider", "observation"), ("seeker", "privileged")):
                    color, depth = game.colors[robot][step], game.depths[robot][step]  # type: ignore[index]
                    picture = np.frombuffer(color.data, np.uint8).reshape(color.height, color.width, 3)
                    add(f"{place}.images.{robot}_color", picture, "u1")
                    distances = np.frombuffer(depth.data, "<u2").reshape(depth.height, depth.width)
                    add(f"{place}.depth.{robot}", distances, "i8")
                    if step in game.views[robot]:  # type: ignore[index]
                        view = np.frombuffer(game.views[robot][step].data, np.uint8).reshape(128, 128)  # type: ignore[index]
                        add(f"{place}.images.{robot}_view", PALETTE[view], "u1")
                    pose, command = game.poses[robot][step], game.commands[robot][step]  # type: ignore[index]
                    state, action = (
                        ("observation.state", "action")
                        if robot == "hider"
                        else (
                            "privileged.seeker_state",
                            "privileged.seeker_action",
                        )
                    )
                    add(state, (pose.x, pose.y, pose.heading), "f4")
                    add(action, [name == command.primitive for name in PRIMITIVES], "f4")
                stamp = game.colors["hider"][step].stamp
                add("capture_time_ns", stamp, "i8")
                add("timestamp", (stamp - start) / 1e9, "f4")
    return {name: np.stack(held) for name, held in frames.items()} | {"lengths": np.array(lengths)}


def has_ffprobe() -> bool:
    return shutil.which("ffprobe") is not None


def check_ffprobe(log: Path, work: Path) -> str:
    """ffprobe: codec, pixel format, size, pictures and duration of every game's video; and that it decodes without a word."""
    export_to("video", log, work / "video", LOOKS)
    seconds = 0.0
    with open_log(log) as opened:
        games = {game.number: game for game in games_of(opened)}
    videos = sorted((work / "video").glob("*.mp4"))
    assert len(videos) == len(games)
    for video, game in zip(videos, games.values(), strict=True):
        entries = "stream=codec_name,pix_fmt,width,height,nb_read_frames,duration"
        words = ("ffprobe", "-v", "error", "-count_frames", "-show_entries", entries, "-of", "json", video)
        (stream,) = json.loads(run(*words))["streams"]
        assert (stream["codec_name"], stream["pix_fmt"]) == ("h264", "yuv420p")
        assert (stream["width"], stream["height"]) == (1280, 720)
        assert int(stream["nb_read_frames"]) == game.steps + 2
        played = (game.poses["hider"][game.steps].stamp - game.poses["hider"][0].stamp) / 1e9
        assert abs(float(stream["duration"]) - played - 2.0) < 0.1, (stream["duration"], played)
        seconds += float(stream["duration"])
        if shutil.which("ffmpeg"):
            done = subprocess.run(["ffmpeg", "-v", "error", "-i", video, "-f", "null", "-"], capture_output=True, text=True)
            assert (done.returncode, done.stderr) == (0, ""), done.stderr
    return f"{len(videos)} videos, H.264 yuv420p 1280 x 720, {seconds:.1f} s"
