"""The web server's protocols are overridden inside uvicorn: only versions that were tried may be installed."""

from __future__ import annotations

import tomllib
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement
from packaging.version import Version

ROOT = Path(__file__).resolve().parents[2]


def test_the_extra_admits_the_tried_versions_and_none_before_them() -> None:
    wanted = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]["console"]
    for requirement in map(Requirement, wanted):
        tried = Version(metadata.version(requirement.name))
        assert tried in requirement.specifier, requirement
        # Names that begin with an underscore or are undocumented change with a minor version: 0.34 of uvicorn lacks the module.
        before = f"{tried.major}.{tried.minor - 1}.999" if tried.minor else f"{tried.major - 1}.999"
        assert before not in requirement.specifier, requirement
        assert f"{tried.major + 1}.0" not in requirement.specifier, requirement
