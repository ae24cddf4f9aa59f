"""`vantage convert` keeps what is there when there is nothing to convert."""

from pathlib import Path

import pytest

from learning.convert import convert
from learning.dataset import UnusableDataset
from vantage.log import LogWriter


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
