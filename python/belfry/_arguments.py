"""What `identify` is given, checked before anything is written: arguments in, values that the library takes out.

What cannot be meant raises an `ArgumentError` that names the argument, what was expected and what was found.
"""

from __future__ import annotations

import math
import numbers
from collections.abc import Iterable, Sequence
from typing import Any, Optional

import numpy as np
import numpy.typing as npt

from ._errors import ArgumentError
from ._results import FloatArray

#: What a column may hold, with the words of study.toml. Volts would need a sensitivity a sensor, which an array does not have.
UNITS = ("m/s2", "g", "m/s", "m", "rad", "strain")
METHODS = ("both", "spectra", "subspace")
#: As many sensors as the library compares with each other.
_MOST_CHANNELS = 4096
#: Lengths of a segment; a power of two between.
_SEGMENTS = (256, 65536)
#: NumPy's kinds that are real numbers: booleans, integers without and with sign, floats.
_REAL_KINDS = "biuf"


def samples(recording: npt.ArrayLike, names: Optional[int] = None) -> FloatArray:
    """The recording as samples by channels, NaN where a sample is masked. `names`: how many points are named, where some are."""
    try:
        given: npt.NDArray[Any] = np.ma.asarray(recording) if np.ma.isMaskedArray(recording) else np.asarray(recording)
    except ValueError as error:
        raise ArgumentError(f"recording: expected an array of samples by channels ({error})") from None
    real = _real(given)
    if real.ndim == 1:
        real = real[:, np.newaxis]
    if real.ndim != 2:
        raise ArgumentError(
            f"recording: expected an array of samples by channels, found {real.ndim} axes, of shape {given.shape}"
        )
    rows, columns = real.shape
    shape = f"of shape {given.shape}: {_counted(rows, 'sample')} of {_counted(columns, 'channel')}"
    if columns == 0:
        raise ArgumentError(f"recording: it has no column, {shape}; expected a row a sample and a column a channel")
    if rows == 0:
        raise ArgumentError(f"recording: it has no samples, {shape}; expected a row a sample and a column a channel")
    turned = "is it transposed? Expected a row a sample and a column a channel, so that recording.T may be meant"
    if columns > rows:
        raise ArgumentError(f"recording: it has more columns than rows, {shape}; {turned}")
    if names is not None and names != columns:
        question = f"; {turned}" if names == rows else ""
        raise ArgumentError(
            f"points: expected {_counted(columns, 'name')}, one a column of the recording, found {names}; "
            f"the recording is {shape}{question}"
        )
    if columns > _MOST_CHANNELS:
        raise ArgumentError(f"recording: it has more channels than the {_MOST_CHANNELS} that Belfry takes, {shape}")
    return real


def _real(given: npt.NDArray[Any]) -> FloatArray:
    """The same as doubles; NumPy alone would drop an imaginary part and a mask."""
    if given.dtype.kind == "c":
        raise ArgumentError(
            f"recording: expected real numbers, found {given.dtype}; pass the part that was measured, such as recording.real"
        )
    # An array of objects may hold numbers, such as columns of a table of mixed types.
    if given.dtype.kind not in _REAL_KINDS + "O":
        raise ArgumentError(f"recording: expected real numbers, found {given.dtype}")
    mask = np.ma.getmask(given)
    try:
        # A copy where something is masked, so that the caller's array stays as it is.
        real: FloatArray = np.ma.getdata(given).astype(np.float64, copy=mask is not np.ma.nomask)
    except (TypeError, ValueError) as error:
        if mask is np.ma.nomask:
            raise ArgumentError(f"recording: expected real numbers, found {given.dtype} ({error})") from None
        # What is masked may be no number at all.
        return _real(np.where(mask, np.nan, np.ma.getdata(given)))
    if mask is not np.ma.nomask:
        real[mask] = np.nan
    return real


def point_names(points: Optional[Sequence[str]]) -> Optional[list[str]]:
    """Names of measured points, each once."""
    if points is None:
        return None
    if isinstance(points, (str, bytes)) or not isinstance(points, Iterable):
        raise ArgumentError(f"points: expected a list of names, one a column of the recording, found {points!r}")
    names: list[str] = []
    places: dict[str, int] = {}
    for column, point in enumerate(points):
        if not isinstance(point, (str, numbers.Integral)) or str(point) == "":
            raise ArgumentError(f"points[{column}]: expected the name of a measured point, found {point!r}")
        name = str(point)
        if name in places:
            raise ArgumentError(
                f"points[{column}]: {name!r} is already used by points[{places[name]}]; give every column a name of its own"
            )
        places[name] = column
        names.append(name)
    return names


def sampling_rate(sampling_rate_hz: float) -> float:
    """Rows a second."""
    rate_hz = _number(sampling_rate_hz)
    if rate_hz is None or not rate_hz > 0 or math.isinf(rate_hz):
        raise ArgumentError(f"sampling_rate_hz: expected samples a second, above 0, found {sampling_rate_hz!r}")
    return rate_hz


def band(band_hz: Optional[Sequence[float]], sampling_rate_hz: float) -> Optional[list[float]]:
    """Lowest and highest frequency, which the recording can show."""
    if band_hz is None:
        return None
    expected = "band_hz: expected the lowest and the highest frequency of interest in Hz, both above 0, such as (0.05, 1.5)"
    ends = _numbers(band_hz)
    if ends is None or len(ends) != 2 or not all(end > 0 and math.isfinite(end) for end in ends):
        raise ArgumentError(f"{expected}, found {band_hz!r}")
    low_hz, high_hz = ends
    if low_hz >= high_hz:
        raise ArgumentError(
            f"band_hz: the band starts at {low_hz:g} Hz and ends at {high_hz:g} Hz; write the lower frequency first"
        )
    half_hz = sampling_rate_hz / 2
    # A rate that is typed with a few digits must not fail by a rounding.
    if high_hz > half_hz * (1 + 1e-9):
        raise ArgumentError(
            f"band_hz: the band ends at {high_hz:g} Hz, but with sampling_rate_hz = {sampling_rate_hz:g} the recording "
            f"shows nothing above {half_hz:g} Hz (half the sampling rate); end the band there or below"
        )
    return ends


def segment_length(segment: Optional[int]) -> Optional[int]:
    """Points of a segment."""
    if segment is None:
        return None
    least, most = _SEGMENTS
    length = int(segment) if isinstance(segment, numbers.Integral) and not isinstance(segment, bool) else 0
    if not least <= length <= most or length & (length - 1):
        raise ArgumentError(f"segment: expected a power of two from {least} to {most} samples, found {segment!r}")
    return length


def frequencies(name: str, values: Optional[Sequence[float]]) -> Optional[list[float]]:
    """A list of frequencies of modes; none where it is empty."""
    if values is None:
        return None
    found = _numbers(values)
    if found is None or len(set(found)) != len(found) or not all(hz > 0 and math.isfinite(hz) for hz in found):
        raise ArgumentError(
            f"{name}: expected a list of frequencies in Hz, each above 0 and once, such as [0.138, 0.366], found {values!r}"
        )
    return found or None


def one_of(name: str, value: str, known: Sequence[str]) -> str:
    """A word of those that are known."""
    if not isinstance(value, str) or value not in known:
        raise ArgumentError(f"{name}: expected one of {', '.join(map(repr, known))}, found {value!r}")
    return str(value)


def _number(value: object) -> Optional[float]:
    # An attribute of a file is often an array without an axis.
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value.item()
    # A boolean is a number to Python, and never a frequency.
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, numbers.Real):
        return None
    return float(value)


def _numbers(values: object) -> Optional[list[float]]:
    if isinstance(values, (str, bytes)) or not isinstance(values, Iterable):
        return None
    found = [_number(value) for value in values]
    return None if None in found else [value for value in found if value is not None]


def _counted(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"
