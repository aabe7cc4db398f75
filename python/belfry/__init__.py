"""Modes of tall structures from their vibration, and what a model of them lacks.

`identify` takes an array. A `Study` is a folder with a study.toml; its methods take the steps that the commands of the program `belfry`
take, and write the same files. All results are dataclasses with NumPy arrays, in SI units; a number that is not known is NaN in arrays
and floats.
"""

from ._array import identify
from ._belfry import version as _version
from ._errors import ArgumentError, BelfryError
from ._results import Candidate, Change, Comparison, Diagnosis, Effect, Modes, Parameter, Sensor, Update
from ._study import Study

__version__: str = _version()

__all__ = [
    "ArgumentError",
    "BelfryError",
    "Candidate",
    "Change",
    "Comparison",
    "Diagnosis",
    "Effect",
    "Modes",
    "Parameter",
    "Sensor",
    "Study",
    "Update",
    "identify",
]
