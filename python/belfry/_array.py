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
from ._errors import BelfryError
from ._results import Modes
from ._study import OnProgress

#: Sensors that one node has room for; the library asks for a node of each, though none is simulated here.
_A_NODE = 3


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
    """Finds the modes of a recording: an array of samples by channels, NaN where a sample is missing.

    points: names of the measured points, a column each; "1", "2" and so on where none are given.
    unit: "m/s2", "g", "m/s", "m", "rad" or "strain".
    band_hz, segment, modes_hz, add_modes_hz, drop_modes_hz: as [analysis] in study.toml.
    method: "spectra", "subspace", or "both": the first with the second for a second opinion.

    The array is written into a temporary file, from which the library streams it several times.
    """
    samples = np.asarray(recording, dtype=np.float64)
    if samples.ndim == 1:
        samples = samples[:, np.newaxis]
    if samples.ndim != 2:
        raise ValueError(f"recording: expected an array of samples by channels, found {samples.ndim} axes")
    channels = samples.shape[1]
    if channels == 0:
        raise ValueError("recording: expected a column a channel, found no column")
    names = [str(channel) for channel in range(1, channels + 1)] if points is None else [str(name) for name in points]
    if len(names) != channels:
        raise ValueError(f"points: expected {channels} names, one a column of the recording, found {len(names)}")
    analysis: dict[str, Any] = {"band_hz": band_hz and [float(hz) for hz in band_hz], "segment": segment}
    for key, values in (("modes_hz", modes_hz), ("add_modes_hz", add_modes_hz), ("drop_modes_hz", drop_modes_hz)):
        analysis[key] = [float(hz) for hz in values] if values is not None and len(values) else None
    document = {
        "structure": {"name": "recording"},
        "setup": [
            {
                "name": "recording",
                "files": ["recording.npy"],
                "sampling_rate_hz": float(sampling_rate_hz),
                "unit": unit,
                "sensor": [
                    {"channel": str(column + 1), "point": name, "node": 1 + column // _A_NODE}
                    for column, name in enumerate(names)
                ],
            }
        ],
        "analysis": {key: value for key, value in analysis.items() if value is not None},
    }
    with tempfile.TemporaryDirectory(prefix="belfry-") as folder:
        np.save(Path(folder) / "recording.npy", np.ascontiguousarray(samples))
        try:
            return Modes._of(_belfry.identify_recording(document, folder, method, on_progress))
        except BelfryError as error:
            # A path that nobody else has seen, and that is gone by now.
            message, *causes = (words.replace(folder + os.sep, "") for words in (error.message, *error.causes))
            raise BelfryError(message, causes) from None
