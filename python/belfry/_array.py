"""Modes of a recording that is an array."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Optional

import numpy as np
import numpy.typing as npt

from . import _belfry
from ._arguments import (
    METHODS,
    UNITS,
    band,
    frequencies,
    one_of,
    point_names,
    samples,
    sampling_rate,
    segment_length,
)
from ._errors import ArgumentError, BelfryError
from ._results import Modes
from ._study import OnProgress

#: Sensors that one node has room for; the library asks for a node of each, though none is simulated here.
_A_NODE = 3
#: The array as a file in a folder of its own.
_FILE = "recording.npy"


def identify(
    recording: npt.ArrayLike,
    sampling_rate_hz: float,
    *,
    points: Optional[Sequence[str]] = None,
    unit: str = "m/s2",
    band_hz: Optional[tuple[float, float]] = None,
    method: str = "both",
    segment: Optional[int] = None,
    modes_hz: Optional[Sequence[float]] = None,
    add_modes_hz: Sequence[float] = (),
    drop_modes_hz: Sequence[float] = (),
    on_progress: Optional[OnProgress] = None,
) -> Modes:
    """Finds the modes of a recording: an array of samples by channels, NaN or masked where a sample is missing.

    An array of more columns than rows is refused, as it is most likely transposed.

    recording: real numbers, a row a sample and a column a channel; an array of one axis is one channel.
    sampling_rate_hz: samples a second.
    points: names of the measured points, a column each; "1", "2" and so on where none are given.
    unit: "m/s2", "g", "m/s", "m", "rad" or "strain".
    band_hz: the lowest and the highest frequency of interest, at most half of sampling_rate_hz.
    segment: samples of a segment, a power of two from 256 to 65536.
    modes_hz: the modes, by their frequencies. add_modes_hz, drop_modes_hz: those to take beside what is found, and to leave out.
    method: "spectra", "subspace", or "both": the first with the second for a second opinion.

    The array is written into a temporary file, from which the library streams it several times. An argument that cannot be meant is an
    `ArgumentError`, which is a ValueError and a BelfryError, before anything is written.
    """
    given = point_names(points)
    array = samples(recording, None if given is None else len(given))
    names = given or [str(column + 1) for column in range(array.shape[1])]
    rate_hz = sampling_rate(sampling_rate_hz)
    asked = frequencies("modes_hz", modes_hz)
    added, dropped = frequencies("add_modes_hz", add_modes_hz), frequencies("drop_modes_hz", drop_modes_hz)
    if asked is not None and (added is not None or dropped is not None):
        raise ArgumentError("modes_hz: it names all modes, so leave out add_modes_hz and drop_modes_hz beside it")
    analysis: dict[str, Any] = {
        "band_hz": band(band_hz, rate_hz),
        "segment": segment_length(segment),
        "modes_hz": asked,
        "add_modes_hz": added,
        "drop_modes_hz": dropped,
    }
    method = one_of("method", method, METHODS)
    document = {
        "structure": {"name": "recording"},
        "setup": [
            {
                "name": "recording",
                "files": [_FILE],
                "sampling_rate_hz": rate_hz,
                "unit": one_of("unit", unit, UNITS),
                "sensor": [
                    {"channel": str(column + 1), "point": name, "node": 1 + column // _A_NODE}
                    for column, name in enumerate(names)
                ],
            }
        ],
        "analysis": {key: value for key, value in analysis.items() if value is not None},
    }
    with tempfile.TemporaryDirectory(prefix="belfry-") as folder:
        np.save(Path(folder) / _FILE, np.ascontiguousarray(array))
        try:
            return Modes._of(_belfry.identify_recording(document, folder, method, on_progress))
        except BelfryError as error:
            message, *causes = (_of_array(words, folder) for words in (error.message, *error.causes))
            raise BelfryError(message, causes) from None


def _of_array(words: str, folder: str) -> str:
    """The library's words without the file and the study that nobody else has seen, and that are gone by now."""
    for of_study, of_array in (
        (folder + os.sep, ""),
        (_FILE, "the recording"),
        ('setup "recording": ', ""),
        (" in [analysis]", ""),
    ):
        words = words.replace(of_study, of_array)
    return words
