"""What the steps return: the numbers that one computes on as arrays, and the whole report as its schema in docs/schema describes it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Optional

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
IntArray = npt.NDArray[np.int64]
#: A report: the object that the command of the step prints with --json.
Report = dict[str, Any]


def _number(value: Any) -> float:
    return float("nan") if value is None else float(value)


def _floats(values: Iterable[Any]) -> FloatArray:
    return np.array([_number(value) for value in values], dtype=np.float64)


def _integers(values: Iterable[Any]) -> IntArray:
    return np.array(list(values), dtype=np.int64)


def _words(values: Iterable[Any]) -> tuple[str, ...]:
    return tuple(str(value) for value in values)


def _word(value: Any) -> Optional[str]:
    return None if value is None else str(value)


@dataclass(frozen=True)
class Sensor:
    """A measured direction at a place."""

    channel: str
    point: str
    #: NaN where it is not known.
    elevation_m: float
    #: Parts of its positive direction along X, Y and Z (up); None where it is not known.
    direction: Optional[tuple[float, float, float]]

    @classmethod
    def _of(cls, said: Report) -> Sensor:
        direction = said["direction"]
        return cls(
            channel=said["channel"],
            point=said["point"],
            elevation_m=_number(said["elevation_m"]),
            direction=None if direction is None else (direction[0], direction[1], direction[2]),
        )


@dataclass(frozen=True, eq=False)
class Modes:
    """Modes, lowest frequency first. The first axis of all arrays is the modes; the second of shapes is the measured points."""

    numbers: IntArray
    frequencies_hz: FloatArray
    #: Standard deviations of the frequencies.
    frequency_stds_hz: FloatArray
    #: Damping ratios; 1 is critical.
    damping_ratios: FloatArray
    damping_ratio_stds: FloatArray
    #: Mode shapes, the largest component of each 1; NaN where a mode was not seen at a point.
    shapes: ComplexArray
    #: Standard deviations of each component.
    shape_stds: FloatArray
    #: The channel of each point, as the recording names it.
    channels: tuple[str, ...]
    points: tuple[str, ...]
    #: What one should know of them.
    warnings: tuple[str, ...]
    #: The report of `belfry identify`; of modes by another program what their file says.
    report: Report = field(repr=False)

    def __len__(self) -> int:
        return len(self.numbers)

    @classmethod
    def _of(cls, report: Report, warnings: Iterable[str] = ()) -> Modes:
        modes = report["modes"]
        # Points of several setups may share the name of a channel.
        places: dict[tuple[str, str], int] = {}
        for mode in modes:
            for component in mode["shape"] or ():
                places.setdefault((component["channel"], component["point"]), len(places))
        shapes = np.full((len(modes), len(places)), complex(float("nan"), float("nan")), dtype=np.complex128)
        shape_stds = np.full(shapes.shape, float("nan"), dtype=np.float64)
        for row, mode in enumerate(modes):
            for component in mode["shape"] or ():
                place = places[component["channel"], component["point"]]
                real, imaginary = component["re"], component["im"]
                # What another program has identified may be real.
                is_real = imaginary is None and real is not None
                shapes[row, place] = complex(_number(real), 0.0 if is_real else _number(imaginary))
                shape_stds[row, place] = _number(component.get("std"))
        return cls(
            numbers=_integers(mode["number"] for mode in modes),
            frequencies_hz=_floats(mode["frequency_hz"] for mode in modes),
            frequency_stds_hz=_floats(mode["frequency_std_hz"] for mode in modes),
            damping_ratios=_floats(mode["damping_ratio"] for mode in modes),
            damping_ratio_stds=_floats(mode["damping_ratio_std"] for mode in modes),
            shapes=shapes,
            shape_stds=shape_stds,
            channels=_words(channel for channel, _ in places),
            points=_words(point for _, point in places),
            warnings=_words([*report["warnings"], *warnings]),
            report=report,
        )


@dataclass(frozen=True, eq=False)
class Comparison:
    """The model against the measured modes. The axis of the first arrays is the pairs of a measured and a model's mode."""

    #: Numbers of the measured modes that have a partner, and of the model's.
    measured: IntArray
    model: IntArray
    measured_hz: FloatArray
    model_hz: FloatArray
    frequency_errors_percent: FloatArray
    #: The errors in standard deviations of the measurement.
    frequency_zs: FloatArray
    #: Modal assurance criterion of the shapes.
    macs: FloatArray
    mean_abs_frequency_error_percent: float
    mean_mac: float
    chi_squared: float
    degrees_of_freedom: Optional[int]
    p_value: float
    #: Channels, with the misfit of the shapes and the coordinate modal assurance criterion at each.
    channels: tuple[str, ...]
    misfits: FloatArray
    comacs: FloatArray
    warnings: tuple[str, ...]
    #: The report of `belfry compare`.
    report: Report = field(repr=False)

    @classmethod
    def _of(cls, report: Report) -> Comparison:
        pairs, sensors = report["pairs"], report["by_sensor"]
        return cls(
            measured=_integers(pair["measured"] for pair in pairs),
            model=_integers(pair["model"] for pair in pairs),
            measured_hz=_floats(pair["measured_hz"] for pair in pairs),
            model_hz=_floats(pair["model_hz"] for pair in pairs),
            frequency_errors_percent=_floats(pair["frequency_error_percent"] for pair in pairs),
            frequency_zs=_floats(pair["frequency_z"] for pair in pairs),
            macs=_floats(pair["mac"] for pair in pairs),
            mean_abs_frequency_error_percent=_number(report["mean_abs_frequency_error_percent"]),
            mean_mac=_number(report["mean_mac"]),
            chi_squared=_number(report["chi_squared"]),
            degrees_of_freedom=report["degrees_of_freedom"],
            p_value=_number(report["p_value"]),
            channels=_words(sensor["channel"] for sensor in sensors),
            misfits=_floats(sensor.get("misfit") for sensor in sensors),
            comacs=_floats(sensor["comac"] for sensor in sensors),
            warnings=_words(report["warnings"]),
            report=report,
        )


@dataclass(frozen=True, eq=False)
class Update:
    """The direct update of the stiffness matrix: K* = K + M Phi Psi Phi^T M. The axis of arrays is the modes that were used."""

    measured: IntArray
    model: IntArray
    measured_hz: FloatArray
    before_hz: FloatArray
    after_hz: FloatArray
    macs_before: FloatArray
    macs_after: FloatArray
    #: Psi, symmetric.
    psi: FloatArray
    objective: float
    #: K*, where the model is small enough for it to be written in full.
    stiffness: Optional[FloatArray]
    warnings: tuple[str, ...]
    #: The report of `belfry update`.
    report: Report = field(repr=False)

    @classmethod
    def _of(cls, report: Report, stiffness: Optional[FloatArray]) -> Update:
        pairs = report["pairs"]
        return cls(
            measured=_integers(pair["measured"] for pair in pairs),
            model=_integers(pair["model"] for pair in pairs),
            measured_hz=_floats(pair["measured_hz"] for pair in pairs),
            before_hz=_floats(pair["before"]["model_hz"] for pair in pairs),
            after_hz=_floats(pair["after"]["model_hz"] for pair in pairs),
            macs_before=_floats(pair["before"]["mac"] for pair in pairs),
            macs_after=_floats(pair["after"]["mac"] for pair in pairs),
            psi=np.array([_floats(row) for row in report["psi"]], dtype=np.float64),
            objective=_number(report["objective"]),
            stiffness=stiffness,
            warnings=_words(report["warnings"]),
            report=report,
        )


@dataclass(frozen=True)
class Parameter:
    """A value of an effect, as fitted."""

    name: str
    value: float
    #: Its standard deviation; NaN where the value is given.
    std: float
    #: Of both; "-" of a pure number.
    unit: str

    @classmethod
    def _of(cls, estimate: Report) -> Parameter:
        return cls(estimate["name"], _number(estimate["value"]), _number(estimate.get("std")), estimate["unit"])


@dataclass(frozen=True)
class Effect:
    """A physical effect in the model."""

    #: Kind, or kind@where.
    name: str
    effect: str
    where: Optional[str]
    parameters: tuple[Parameter, ...]

    @classmethod
    def _of(cls, report: Report) -> Effect:
        return cls(**_named(report))


def _named(report: Report) -> dict[str, Any]:
    """What effects and candidates have in common."""
    effect, where = str(report["effect"]), _word(report["where"])
    return {
        "name": effect if where is None else f"{effect}@{where}",
        "effect": effect,
        "where": where,
        "parameters": tuple(Parameter._of(estimate) for estimate in report["parameters"]),
    }


@dataclass(frozen=True)
class Candidate:
    """A physical effect that the model could lack."""

    #: Kind, or kind@where, as `Study.add` takes it.
    name: str
    effect: str
    where: Optional[str]
    parameters: tuple[Parameter, ...]
    probability: float
    log_bayes_factor: float
    #: What it leaves unexplained.
    chi_squared: float
    p_value: float
    #: Whether its values can be.
    admissible: bool
    #: Standard deviation of its height.
    where_std_m: float

    @classmethod
    def _of(cls, candidate: Report) -> Candidate:
        return cls(
            **_named(candidate),
            probability=_number(candidate["probability"]),
            log_bayes_factor=_number(candidate["log_bayes_factor"]),
            chi_squared=_number(candidate["chi_squared"]),
            p_value=_number(candidate["p_value"]),
            admissible=bool(candidate["admissible"]),
            where_std_m=_number(candidate["where_std_m"]),
        )


@dataclass(frozen=True)
class Diagnosis:
    """Which physical effect the model lacks."""

    #: "adequate", "effect", "ambiguous" or "unknown".
    verdict: str
    #: Names of the effects that explain the measurement, the most probable first.
    best: tuple[str, ...]
    #: Effects that were tried, the most probable first.
    candidates: tuple[Candidate, ...]
    #: How probable it is that the model lacks nothing, and that it lacks what Belfry has no effect for.
    adequate_probability: float
    something_else_probability: float
    #: What would settle an ambiguous verdict.
    next_measurement: Optional[str]
    reason: Optional[str]
    warnings: tuple[str, ...]
    #: The report of `belfry diagnose`.
    report: Report = field(repr=False)

    @classmethod
    def _of(cls, report: Report) -> Diagnosis:
        probabilities = report["probabilities"]
        return cls(
            verdict=report["verdict"],
            best=_words(report["best"]),
            candidates=tuple(Candidate._of(candidate) for candidate in report["candidates"]),
            adequate_probability=_number(probabilities["adequate"]),
            something_else_probability=_number(probabilities["something_else"]),
            next_measurement=_word(report["next_measurement"]),
            reason=_word(report.get("reason")),
            warnings=_words(report["warnings"]),
            report=report,
        )


@dataclass(frozen=True)
class Change:
    """A model with an effect more."""

    #: The effects in the model, as fitted together.
    effects: tuple[Effect, ...]
    before: Comparison
    after: Comparison
    warnings: tuple[str, ...]
    #: The report of `belfry add`.
    report: Report = field(repr=False)

    @classmethod
    def _of(cls, report: Report) -> Change:
        return cls(
            effects=tuple(Effect._of(effect) for effect in report["effects"]),
            before=Comparison._of(report["before"]),
            after=Comparison._of(report["after"]),
            warnings=_words(report["warnings"]),
            report=report,
        )
