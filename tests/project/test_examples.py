"""Every example in the documents is run as it is printed; every command shown is parsed with all its options."""

from __future__ import annotations

import importlib.util
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from learning.collect import CollectSettings, play_block
from learning.hiders.table import HIDERS
from schemas import Command
from vantage import cli
from vantage.log import read
from vantage.world.layout import make_layout

ROOT = Path(__file__).resolve().parents[2]
PAGES = ("README.md", "compose/README.md", *sorted(str(path.relative_to(ROOT)) for path in (ROOT / "docs").glob("*.md")))
ARCHITECTURE = "docs/architecture.md"
ANCHORS = {
    "SERVICES": "SERVICES = (\n",
    "TOPICS": "    for topic in (\n",
    "HIDERS": "HIDERS: dict[str, Make] = {\n",
    "an import": "import numpy as np\n",
}
"""Place named by an example -> the line of its file after which it goes."""


def blocks(page: str) -> list[tuple[str, str]]:
    """(language, text) of every code block of a page; blocks within a list lose their indentation."""
    found = re.findall(r"^( *)```(\w*)\n(.*?)^ *```$", (ROOT / page).read_text(), re.DOTALL | re.MULTILINE)
    return [(language, re.sub(rf"^{indent}", "", text, flags=re.MULTILINE)) for indent, language, text in found]


def files(page: str) -> Iterator[tuple[str, str, str]]:
    """(file, place in it, text) of every code block that begins with where it belongs."""
    for language, text in blocks(page):
        if language in ("python", "ini"):
            header = re.match(r"[#;] ([\w./]+)(?:, (.*))?\n", text)
            assert header is not None, f"{page}: this block does not say in which file it belongs:\n{text}"
            yield header[1], header[2] or "", text[header.end() :]


def place(tree: Path, name: str, where: str, text: str) -> None:
    """Put an example where its page says."""
    path = tree / name
    if not where:
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    elif where.endswith("at its end"):
        path.write_text(path.read_text() + "\n" + text)
    else:
        (anchor,) = (anchor for place, anchor in ANCHORS.items() if where.endswith(place))
        before, found, after = path.read_text().partition(anchor)
        assert found, f"{name} has no {where}"
        path.write_text(before + anchor + text + after)


def commands(page: str) -> list[str]:
    """Every `vantage` command that a page shows: in blocks, and in its lines where they have arguments."""
    text = (ROOT / page).read_text()
    shown = [
        line
        for _, block in blocks(page)
        for line in block.replace("\\\n", " ").splitlines()
        if line.startswith(("vantage ", ".venv/bin/vantage "))
    ]
    named = [" ".join(found.split()) for found in re.findall(r"`(vantage\s+[a-z][^`]*)`", text)]
    names = {f"vantage {command.words}" for command in cli.COMMANDS}
    groups = {f"vantage {command.words.split()[0]}" for command in cli.COMMANDS}
    return sorted({*shown, *named} - names - groups)


def refusal(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Parse a command as `vantage` would; return why it is refused, empty if it is not."""
    found = cli.find(words)
    if found is None:
        return "there is no such command"
    try:
        cli.parse(*found)
    except SystemExit as ended:
        printed = capsys.readouterr()
        return "" if ended.code == 0 else printed.out + printed.err
    return ""


@pytest.mark.parametrize(("page", "command"), [(page, command) for page in PAGES for command in commands(page)])
def test_a_command_in_a_page_is_accepted(page: str, command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert refusal(shlex.split(command)[1:], capsys) == ""


@pytest.mark.parametrize("command", cli.COMMANDS, ids=lambda command: command.words)
def test_the_examples_of_a_commands_help_are_accepted(command: cli.Command, capsys: pytest.CaptureFixture[str]) -> None:
    _, kind = cli.settings_of(command)
    examples = re.findall(r"^ *(?:Example: )?vantage (.*)$", kind.__doc__ or "", re.MULTILINE)
    assert examples
    for example in examples:
        words = shlex.split(re.split(r"\s{2,}", example)[0])
        assert " ".join(words).startswith(command.words)
        assert refusal(words, capsys) == "", example


@pytest.mark.parametrize("page", PAGES)
def test_every_block_of_code_is_run_by_a_test(page: str) -> None:
    code = [text for language, text in blocks(page) if language in ("python", "ini", "json", "sh", "bash")]
    if page == ARCHITECTURE:
        assert len(code) == len(list(files(page))) + 1  # the layout
    elif page != "docs/robot-protocol.md":  # which tests/drive/test_page.py runs
        assert not code


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the repository's code with the example's service in it."""
    folder = tmp_path_factory.mktemp("tree")
    for room in ("schemas", "vantage", "services", "learning", "compose"):
        shutil.copytree(ROOT / room, folder / room, ignore=shutil.ignore_patterns("__pycache__"))
    for name, where, text in files(ARCHITECTURE):
        if not name.startswith("learning/"):
            place(folder, name, where, text)
    return folder


def run_in(tree: Path, *words: str) -> str:
    environment = {**os.environ, "PYTHONPATH": str(tree)}
    outcome = subprocess.run([sys.executable, *words], cwd=tree, env=environment, capture_output=True, text=True, check=False)
    assert outcome.returncode == 0, outcome.stdout + outcome.stderr
    return outcome.stdout


def test_the_service_is_found_sound_by_the_check(tree: Path) -> None:
    assert run_in(tree, "-m", "vantage.cli", "check", "simulation") == "simulation: sound\n"


def test_the_service_can_be_started(tree: Path) -> None:
    assert "Closeness: how near the robots are." in run_in(tree, "-m", "services.closeness", "--help")


def test_the_service_works_on_a_bus(tree: Path) -> None:
    """Its core under the runtime, every message through the codec: an error in `step` would count as failed."""
    program = """
from schemas import Pose
from services.closeness.core import ClosenessCore
from vantage.bus import InProcessNetwork, VirtualClock
from vantage.service import Runtime

network = InProcessNetwork(clock=VirtualClock(10**18), checked=True)
runtime = Runtime(ClosenessCore(), network.session("closeness"), network.clock, health=False)
listener, simulator = network.session("recorder"), network.session("simulator")
listener.subscribe("closeness")
for step in range(3):
    simulator.publish("hider/pose", Pose(stamp=1, episode=1, step=step, x=0.1, y=0.2, heading=0.0))
    simulator.publish("seeker/pose", Pose(stamp=1, episode=1, step=step, x=0.4, y=0.6, heading=0.0))
    runtime.drain()
    print(listener.receive(0.0).decode().x)
print(runtime.health_report("ok").failed)
"""
    assert [float(line) for line in run_in(tree, "-c", program).split()] == pytest.approx([0.5, 0.5, 0.5, 0])


def test_the_layout(tmp_path: Path) -> None:
    ((_, text),) = [block for block in blocks(ARCHITECTURE) if block[0] == "json"]
    path = tmp_path / "corner.json"
    path.write_text(text)
    boxes = make_layout(str(path), seed=1)
    assert len(boxes) == 3
    settings = CollectSettings(games=1, hider="goal-walk", steps=5, catching=False, layout=str(path))
    assert play_block(settings, range(1, 2), tmp_path / "game.mcap") == 5


def test_the_hider_policy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its files run beside the real ones, not in a copy of the tree: all kernels would be compiled again for that."""
    (tmp_path / "learning/hiders").mkdir(parents=True)
    shutil.copy(ROOT / "learning/hiders/table.py", tmp_path / "learning/hiders")
    for name, where, text in files(ARCHITECTURE):
        if name.startswith("learning/"):
            place(tmp_path, name, where, text)
    for module in ("turner", "table"):
        name = f"learning.hiders.{module}"
        spec = importlib.util.spec_from_file_location(name, tmp_path / f"learning/hiders/{module}.py")
        assert spec is not None and spec.loader is not None
        loaded = importlib.util.module_from_spec(spec)
        monkeypatch.setitem(sys.modules, name, loaded)
        spec.loader.exec_module(loaded)
    monkeypatch.setitem(HIDERS, "turner", loaded.HIDERS["turner"])
    settings = CollectSettings(games=2, hider="turner", steps=8, catching=False)
    play_block(settings, range(1, 3), tmp_path / "game.mcap")
    played: dict[int, set[str]] = {}
    for record in read(tmp_path / "game.mcap", topics=("hider/command",)):
        command = record.decode()
        assert isinstance(command, Command)
        played.setdefault(command.episode, set()).add(command.primitive)
    assert len(played) == 2
    assert all(primitives in ({"left"}, {"right"}) for primitives in played.values())
