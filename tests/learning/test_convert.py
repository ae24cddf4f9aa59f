"""`vantage convert` keeps what is there, leaves broken logs out, and keeps names whole."""

import hashlib
import shutil
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from msgspec.structs import replace

from learning.collect import CollectSettings, play_block
from learning.convert import convert, messages_hash
from learning.dataset import Dataset, UnusableDataset
from schemas import Episode, encode
from tests.log.making import write_log, write_record
from vantage.log import LogWriter, RunMetadata, open_log, read
from vantage.log.reader import NoSuchLog
from vantage.output import AlreadyExists


def test_a_training_set_is_not_replaced_by_nothing(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "empty.mcap", {}, sync=False):
        pass
    dataset = tmp_path / "dataset"
    dataset.mkdir()
    (dataset / "manifest.json").write_text("{}")
    with pytest.raises(UnusableDataset, match="left as it was"):
        convert([tmp_path / "empty.mcap"], dataset, workers=1, quiet=True, force=True)
    assert (dataset / "manifest.json").read_text() == "{}"
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith("dataset")] == ["dataset"]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two logs of two games each."""
    folder = tmp_path_factory.mktemp("logs")
    for first in (1, 11):
        play_block(CollectSettings(hider="goal-walk", seed=first, steps=20), range(1, 3), folder / f"log_{first}.mcap")
    return folder


def stock_hash(path: Path) -> str:
    """The hash of a log as the published manifests were made: with the reader of the MCAP project."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        for record in StreamReader(file, emit_chunks=True).records:
            if isinstance(record, Chunk):
                digest.update(lz4.frame.decompress(record.data) if record.compression == "lz4" else record.data)
    return digest.hexdigest()


@pytest.mark.parametrize("compression", ["lz4", "zstd", "none"])
def test_the_hash_of_a_log_is_the_published_one(whole: Path, tmp_path: Path, compression: str) -> None:
    path = tmp_path / "log.mcap"
    write_log(path, read(whole / "log_1.mcap"), compression=compression, chunk_size=5000)
    for log in (path, whole / "log_1.mcap"):
        with open_log(log) as opened:
            assert messages_hash(opened) == stock_hash(log)
            assert not opened.breaks


def live(path: Path) -> LogWriter:
    """Begin a log as a recorder does, and leave it open."""
    records = list(read(path))
    path.unlink()
    writer = LogWriter(path, RunMetadata(), sync=False, chunk_size=2000)
    for record in records:
        write_record(writer, record)
    writer.flush()
    return writer


def scratched(path: Path) -> None:
    """Damage a byte in the middle of the largest chunk."""
    with open_log(path) as log:
        chunk = max(log.files[0].chunks, key=lambda chunk: chunk.length)
        place = chunk.offset + chunk.length // 2
    content = bytearray(path.read_bytes())
    content[place] ^= 0xFF
    path.write_bytes(content)


BROKEN: dict[str, Callable[[Path], object]] = {
    "live": live,
    "scratched": scratched,
    "cut": lambda path: path.write_bytes(path.read_bytes()[:-3000]),
    "cut in a record's head": lambda path: path.write_bytes(path.read_bytes()[:100]),
    "empty": lambda path: path.write_bytes(b""),
    "text": lambda path: path.write_text("a text that somebody named so"),
}


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("how", BROKEN)
def test_a_broken_log_is_left_out_with_a_line_and_the_others_are_converted(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], how: str, workers: int
) -> None:
    shutil.copytree(whole, tmp_path / "logs")
    broken = tmp_path / "logs" / "log_11.mcap"
    writer = BROKEN[how](broken)
    manifest = convert([tmp_path / "logs"], tmp_path / "set", workers=workers, quiet=True)
    expected = convert([whole / "log_1.mcap"], tmp_path / "expected", workers=1, quiet=True)
    assert {**manifest, "commit": ""} == {**expected, "commit": ""}
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"left out: {broken}: ")
    assert ("it is being recorded now" if how == "live" else "vantage log recover") in line
    if isinstance(writer, LogWriter):
        writer.close()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["expected", "logs", "set"]


def test_gather_takes_no_broken_log_for_games_that_cannot_serve(whole: Path, tmp_path: Path) -> None:
    shutil.copytree(whole, tmp_path / "logs")
    scratched(tmp_path / "logs" / "log_11.mcap")
    with pytest.raises(UnusableDataset, match=r"log_11.mcap: .*remove this log and run it again"):
        convert([tmp_path / "logs"], tmp_path / "set", workers=1, quiet=True, need_every_log=True)
    assert [path.name for path in tmp_path.iterdir()] == ["logs"]


def test_a_training_set_is_replaced_only_by_force(whole: Path, tmp_path: Path) -> None:
    convert([whole / "log_1.mcap"], tmp_path / "set", workers=1, quiet=True)
    before = (tmp_path / "set" / "manifest.json").read_bytes()
    with pytest.raises(AlreadyExists, match="--force"):
        convert([whole], tmp_path / "set", workers=1, quiet=True)
    assert (tmp_path / "set" / "manifest.json").read_bytes() == before
    assert len(Dataset(tmp_path / "set").episodes) == 2
    convert([whole], tmp_path / "set", workers=1, quiet=True, force=True)
    assert len(Dataset(tmp_path / "set").episodes) == 4


def test_an_empty_folder_is_as_good_as_none(whole: Path, tmp_path: Path) -> None:
    (tmp_path / "set").mkdir()
    convert([whole], tmp_path / "set", workers=1, quiet=True)
    assert len(Dataset(tmp_path / "set").episodes) == 4


def test_no_logs_are_one_line(tmp_path: Path) -> None:
    with pytest.raises(NoSuchLog, match="no log"):
        convert([tmp_path / "nowhere"], tmp_path / "set", quiet=True)


def renamed(source: Path, target: Path, layout: str, hider: str, seeker: str = "glancing") -> None:
    """Copy a log with other names in its games."""
    records = []
    for record in read(source):
        if record.key == "episode":
            message = record.decode()
            assert isinstance(message, Episode)
            rules, players = replace(message.rules, layout=layout), replace(message.players, hider=hider, seeker=seeker)
            record = replace(record, payload=encode(replace(message, rules=rules, players=players)))
        records.append(record)
    write_log(target, records)


def test_names_of_any_length_and_alphabet_are_kept_whole(whole: Path, tmp_path: Path) -> None:
    """Letters of several bytes, where fixed-width fields would cut them; names alike in all that fits into a field."""
    long = "/srv/лаборатория/расстановки/" + "щ" * 40
    names = {
        (f"{long}/a.json", "goal-walk"),
        (f"{long}/b.json", "бегун, который всегда бежит по кругу"),
        ("a\0", "a"),
        ("lab", "a" * 32),
    }
    (tmp_path / "logs").mkdir()
    for number, (layout, hider) in enumerate(sorted(names)):
        renamed(whole / "log_1.mcap", tmp_path / "logs" / f"{number}.mcap", layout, hider, f"преподаватель {number}")
    manifest = convert([tmp_path / "logs"], tmp_path / "set", workers=1, quiet=True)
    assert manifest["layouts"] == {layout: 2 for layout, _ in sorted(names)}
    assert manifest["hiders"] == dict.fromkeys(sorted(hider for _, hider in names), 2)
    data = Dataset(tmp_path / "set")
    found = {(data.name_of(row, "layout"), data.name_of(row, "hider")) for row in range(len(data.episodes))}
    assert found == names
    assert {data.name_of(row, "seeker") for row in range(8)} == {f"преподаватель {number}" for number in range(4)}
    chosen = convert([tmp_path / "logs"], tmp_path / "some", 1, True, wanted={sorted(names)[3][1]: (1, 0, 0)})
    assert list(chosen["layouts"]) == [sorted(names)[3][0]]


def test_a_set_whose_names_an_earlier_version_cut_still_reads(whole: Path, tmp_path: Path) -> None:
    layout = "/srv/лаборатория/расстановки/" + "щ" * 40
    renamed(whole / "log_1.mcap", tmp_path / "log.mcap", layout, "goal-walk")
    convert([tmp_path / "log.mcap"], tmp_path / "set", workers=1, quiet=True)
    episodes = np.load(tmp_path / "set" / "episodes.npy")
    episodes["layout"] = layout.encode()[:64]
    np.save(tmp_path / "set" / "episodes.npy", episodes)
    assert Dataset(tmp_path / "set").name_of(0, "layout").startswith("/srv/лаборатория/")
