"""A full disk under the recorder; `python -m tests.stack.full_disk` tries all that writes in all troubles."""

from __future__ import annotations

from tests.stack.full_disk import Settings, table_of, try_all


def test_a_full_disk_is_said_nothing_is_half_and_it_goes_on_with_room() -> None:
    rows = try_all(Settings(only=("recorder",)), ("full",))
    assert [row.name for row in rows] == ["recorder"]
    assert all(row.said for row in rows)
    assert not any(row.violations for row in rows), table_of(rows)
