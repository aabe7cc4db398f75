"""Studies that tests share. The program is that beside the interpreter: the one that the wheel has brought."""

from __future__ import annotations

import json
import pathlib
import shutil
import subprocess
import sys
from typing import Any, Callable

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[2]
PROGRAM = pathlib.Path(sys.executable).parent / "belfry"

Program = Callable[..., "dict[str, Any]"]


def run(*words: object) -> dict[str, Any]:
    """The object that a command of the program prints, also where it fails."""
    done = subprocess.run([PROGRAM, *map(str, words), "--json"], capture_output=True, text=True)
    report: dict[str, Any] = json.loads(done.stdout)
    return report


@pytest.fixture(scope="session")
def program() -> Program:
    return run


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    """An hour of the Canton Tower, which carries 2000 t more than its model knows."""
    study = tmp_path_factory.mktemp("recorded") / "canton"
    run("init", study, "--template", "canton")
    run("simulate", study, "--effect", "added-mass@443.6m=2e6", "--hours", "1", "--adopt")
    return study


@pytest.fixture(scope="session")
def identified(recorded: pathlib.Path, tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    """The same with its modes. Tests that change it take a copy."""
    study = tmp_path_factory.mktemp("identified") / "canton"
    shutil.copytree(recorded, study)
    run("identify", study, "--direct")
    return study


@pytest.fixture
def copy(identified: pathlib.Path, tmp_path: pathlib.Path) -> pathlib.Path:
    return pathlib.Path(shutil.copytree(identified, tmp_path / "canton"))
