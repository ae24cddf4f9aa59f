"""Files of strangers: bombs, control codes and markup in names, logs of other programs."""

from __future__ import annotations

import os
import subprocess
import sys
from io import BytesIO
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC, Writer

from tests.log.making import game, records_of, write_log
from vantage.log import open_log, read
from vantage.log.recover import NothingToRecover, recover

VANTAGE = Path(sys.executable).parent / "vantage"
GIGABYTE = 1 << 30


def run(*words: str | Path, columns: int = 400) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"COLUMNS": str(columns)}
    return subprocess.run([VANTAGE, "log", *words], capture_output=True, text=True, check=False, env=environment)


def bomb(compression: str) -> bytes:
    """A gigabyte of nothing, compressed."""
    zeros = bytes(1 << 20)
    packed = BytesIO()
    if compression == "lz4":
        with lz4.frame.open(packed, "wb") as file:
            for _ in range(GIGABYTE >> 20):
                file.write(zeros)
    else:
        size = GIGABYTE if compression == "zstd, size in the frame" else -1
        compressor = zstandard.ZstdCompressor(level=1, write_content_size=size > 0)
        with compressor.stream_writer(packed, size=size, closefd=False) as stream:
            for _ in range(GIGABYTE >> 20):
                stream.write(zeros)
    return packed.getvalue()


@pytest.mark.parametrize("claimed", [1000, GIGABYTE, 2**40])
@pytest.mark.parametrize("compression", ["lz4", "zstd", "zstd, size in the frame"])
def test_a_decompression_bomb_does_not_go_off(tmp_path: Path, compression: str, claimed: int) -> None:
    data = bomb(compression)
    text = RecordBuilder()
    text.write(MCAP0_MAGIC)
    Chunk(
        compression=compression[:4].rstrip(","),
        data=data,
        message_start_time=1,
        message_end_time=2,
        uncompressed_crc=0,
        uncompressed_size=claimed,
    ).write(text)
    (tmp_path / "bomb.mcap").write_bytes(text.end())
    program = (
        "import resource, sys; from pathlib import Path;"
        "from vantage.log.report import info; from vantage.log.recover import recover;"
        "before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss;"
        "report = info(Path(sys.argv[1]))[0]; recover(Path(sys.argv[1]), Path(sys.argv[2]));"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before, report.breaks)"
    )
    command = [sys.executable, "-c", program, tmp_path / "bomb.mcap", tmp_path / "whole.mcap"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    grown, _, said = done.stdout.partition(" ")
    assert int(grown) < 100_000  # kB
    assert f"chunk claims {claimed} bytes" in said


def test_a_chunk_of_many_tiny_messages_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vantage.log.file._MOST_MESSAGES", 100)
    write_log(tmp_path / "log.mcap", records_of(game(1, 30)))
    with open_log(tmp_path / "log.mcap") as log:
        assert list(log.records()) == []
        assert "more than 100 messages in one chunk" in log.breaks[0]


OBEYED = "a[/red]\x1b[2J\x07\u202eb"
PLAIN = "a[/red][2Jb"


def foreign_log(path: Path, started: str = "²") -> None:
    """A log of another program that names everything as it likes."""
    writer = Writer(str(path), chunk_size=1000)
    writer.start(profile="ros2", library="another program 1.0")
    writer.add_metadata("vantage", {"started": started, OBEYED: OBEYED, "long": "x" * 5000})
    writer.add_metadata("vantage.gaps", {"tick referee": "²", OBEYED: "9" * 400})
    writer.add_metadata("calibration", {"camera": "left"})
    writer.add_metadata("calibration", {"camera": "right"})
    schema = writer.register_schema("Thing", "jsonschema", b"{}")
    unused = writer.register_schema("Unused", "ros2msg", b"int32 a")
    writer.register_channel("/never", "cdr", unused, {"qos": "1"})
    channel = writer.register_channel(OBEYED, "json", schema, {"publisher": OBEYED})
    writer.add_attachment(5, 6, "map.png", "image/png", bytes(range(256)) * 100)
    for number in range(200):
        writer.add_message(channel, log_time=1000 + number, data=b"{}", publish_time=7, sequence=number)
    writer.add_attachment(8, 9, OBEYED, "", b"")
    writer.finish()


@pytest.mark.parametrize("started", ["²", "9" * 400, "1" + "0" * 5000, "-5", "nan"])
def test_names_in_a_foreign_log_are_printed_and_not_obeyed(tmp_path: Path, started: str) -> None:
    path = tmp_path / f"{OBEYED.replace('/', '')}.mcap"
    foreign_log(path, started)
    done = run("info", path)
    assert (done.returncode, done.stderr) == (0, "")
    assert PLAIN in done.stdout
    assert done.stdout.replace("\n", "").isprintable()
    assert started[:100] in done.stdout or started == "-5"


@pytest.mark.parametrize("name", ["d[/x].mcap", "br[red]a.mcap", "esc\x1b[2J.mcap"])
def test_file_names_are_printed_and_not_obeyed(tmp_path: Path, name: str) -> None:
    path = tmp_path / "logs" / name
    path.parent.mkdir(parents=True)
    write_log(path, records_of(game(1, 3)))
    shown = str(path).replace("\x1b", "")
    for words, end in (
        (("info", path), ""),
        (("recover", path), "-recovered.mcap"),
        (("export", path), "-viewer.mcap"),
        (("export", path, "--as", "video"), ".mp4"),
        (("export", path, "--as", "lerobot", "--without-catching"), "-lerobot"),
    ):
        done = run(*words)
        assert done.returncode == 0, done.stderr
        assert (shown if not end else shown.removesuffix(".mcap") + end) in done.stdout
        assert "\x1b" not in done.stdout + done.stderr


def everything_in(path: Path) -> dict[str, list[object]]:
    """Return what mcap's own reader finds in a file, but for how it is packed."""
    found: dict[str, list[object]] = {}
    for record in StreamReader(str(path), validate_crcs=True).records:
        kind = type(record).__name__
        if kind in ("Header", "Metadata", "Attachment"):
            found.setdefault(kind, []).append(record)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        assert (summary.statistics.attachment_count, summary.statistics.metadata_count) == (
            len(list(reader.iter_attachments())),
            len(list(reader.iter_metadata())),
        )
        found["channels"] = sorted((c.topic, c.message_encoding, c.metadata) for c in summary.channels.values())  # type: ignore[type-var]
        found["schemas"] = sorted((s.name, s.encoding, s.data) for s in summary.schemas.values())
        found["messages"] = [
            (channel.topic, schema and schema.name, message.log_time, message.publish_time, message.sequence, message.data)
            for schema, channel, message in reader.iter_messages()
        ]
    return found


def test_the_log_of_another_program_is_recovered_with_all_it_holds(tmp_path: Path) -> None:
    foreign_log(tmp_path / "other.mcap")
    report = recover(tmp_path / "other.mcap", tmp_path / "whole.mcap")
    assert (report.messages, report.attachments, report.breaks) == (200, 2, ())
    assert everything_in(tmp_path / "whole.mcap") == everything_in(tmp_path / "other.mcap")
    text = (tmp_path / "other.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(text[: text.rindex(b"map.png") - 500])
    recover(tmp_path / "cut.mcap", tmp_path / "mended.mcap")
    kept, all_of_it = everything_in(tmp_path / "mended.mcap"), everything_in(tmp_path / "other.mcap")
    assert (kept["Header"], kept["Metadata"]) == (all_of_it["Header"], all_of_it["Metadata"])
    assert kept["Attachment"][0] == all_of_it["Attachment"][0]


def test_private_records_are_kept_and_damaged_attachments_are_said(tmp_path: Path) -> None:
    text = RecordBuilder()
    text.write(MCAP0_MAGIC)
    foreign_log(tmp_path / "other.mcap")
    records = (tmp_path / "other.mcap").read_bytes()
    at = records.index(bytes(range(256)))
    damaged = bytearray(records)
    damaged[at + 3] ^= 1
    private = bytes([0x90]) + (4).to_bytes(8, "little") + b"mine"
    end = records.rindex(bytes([Opcode.DATA_END]) + (4).to_bytes(8, "little"))
    (tmp_path / "damaged.mcap").write_bytes(bytes(damaged[:end]) + private)
    report = recover(tmp_path / "damaged.mcap", tmp_path / "whole.mcap")
    assert report.attachments == 1
    assert any("damaged attachment" in text and "CRC" in text for text in report.breaks)
    assert private in (tmp_path / "whole.mcap").read_bytes()
    assert len(list(read(tmp_path / "whole.mcap"))) == 200


@pytest.mark.parametrize("content", [b"", b"\x89MC", b"hello, this is no log at all"])
def test_what_is_no_log_cannot_be_recovered(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "text.mcap").write_bytes(content)
    with pytest.raises(NothingToRecover, match="nothing to recover"):
        recover(tmp_path / "text.mcap", tmp_path / "whole.mcap")
    done = run("recover", tmp_path / "text.mcap")
    assert done.returncode == 1
    assert (done.stdout, done.stderr.count("\n"), "Traceback" in done.stderr) == ("", 1, False)
    write_log(tmp_path / "good.mcap", records_of(game(1, 3)))
    done = run("recover", tmp_path, "--to", tmp_path / "all")
    assert done.returncode == 1
    assert [path.name for path in (tmp_path / "all").iterdir()] == ["good.mcap"]
    again = run("recover", tmp_path / "good.mcap", "--to", tmp_path / "all" / "good.mcap")
    assert (again.returncode, again.stderr.count("\n")) == (1, 1)
    assert "exists already" in again.stderr
