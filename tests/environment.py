"""Runs a script in a virtual environment of its own, with the packages that it needs."""

import os
import pathlib
import subprocess
import sys
import venv


def enter(folder, packages):
    """Goes on in the environment below a folder; makes it first where there is none."""
    environment = pathlib.Path(folder) / "venv"
    python = environment / "bin" / "python"
    if not python.exists():
        environment.parent.mkdir(parents=True, exist_ok=True)
        venv.create(environment, with_pip=True)
        subprocess.run([python, "-m", "pip", "install", "--quiet", *packages], check=True)
    if pathlib.Path(sys.prefix) != environment:
        os.execv(python, [str(python), *sys.argv])
