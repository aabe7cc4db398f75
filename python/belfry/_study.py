"""A study's folder, and the steps that are taken in it."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Optional, Union

import numpy as np

from . import _belfry
from ._results import Change, Comparison, Diagnosis, FloatArray, Modes, Sensor, Update

#: Hears of long work: stage, pieces done and their number. An exception that it raises ends the work and goes on to the caller.
OnProgress = Callable[[str, int, int], object]


class Study:
    """A folder with a study.toml. Each step reads it anew and writes its results into the folder `results`, as the program does."""

    #: The study's folder.
    path: Path
    #: What the structure is called.
    name: str
    #: The sensors of all setups, as study.toml has them.
    sensors: tuple[Sensor, ...]

    def __init__(self, path: Union[str, os.PathLike[str]]) -> None:
        said = _belfry.study(os.fspath(path))
        self.path = Path(said["folder"])
        self.name = said["name"]
        self.sensors = tuple(Sensor._of(sensor) for sensor in said["sensors"])

    def __repr__(self) -> str:
        return f"Study({str(self.path)!r})"

    def identify(
        self,
        *,
        direct: bool = False,
        method: str = "both",
        every_s: Optional[float] = None,
        on_progress: Optional[OnProgress] = None,
    ) -> Modes:
        """Finds the modes of the study's recordings.

        direct: straight from the recording, without simulated sensor nodes.
        method: "spectra", "subspace", or "both": the first with the second for a second opinion.
        every_s: follow the modes over intervals of this length.
        """
        return Modes._of(_belfry.identify(self.path, direct, method, every_s, on_progress))

    def modes(self) -> Modes:
        """The modes that the study has: those that were identified last, or those of another program that its study.toml names."""
        said = _belfry.modes(self.path)
        report = said["report"] if said["file"] is None else json.loads(Path(said["file"]).read_text(encoding="utf-8"))
        return Modes._of(report, said["warnings"])

    def compare(self, *, on_progress: Optional[OnProgress] = None) -> Comparison:
        """Compares the model with the measured modes."""
        return Comparison._of(_belfry.compare(self.path, on_progress))

    def update(
        self,
        *,
        modes: Sequence[int] = (),
        frequency_weight: float = 10.0,
        shape_weights: Sequence[float] = (2.0, 0.5),
        on_progress: Optional[OnProgress] = None,
    ) -> Update:
        """Updates the model's stiffness matrix directly.

        modes: numbers of the measured modes to use; all that have a partner where none are named.
        frequency_weight, shape_weights: as the options of `belfry update`.
        """
        weights = [float(weight) for weight in shape_weights]
        report = _belfry.update(self.path, [int(mode) for mode in modes], frequency_weight, weights, on_progress)
        file = self.path / "results" / "stiffness_updated.npy"
        stiffness: Optional[FloatArray] = np.load(file, allow_pickle=False) if file.exists() else None
        return Update._of(report, stiffness)

    def diagnose(
        self, *, without: Sequence[str] = (), on_progress: Optional[OnProgress] = None
    ) -> Diagnosis:
        """Says which physical effect the model lacks; kinds of effects in `without` are left out."""
        return Diagnosis._of(_belfry.diagnose(self.path, list(without), on_progress))

    def add(self, effect: str, *, on_progress: Optional[OnProgress] = None) -> Change:
        """Puts an effect (kind[@where][=value]) into the model, in study.toml, and refits all effects together."""
        return Change._of(_belfry.add(self.path, effect, on_progress))
