"""Each step gives what the program prints, to the last bit: JSON has every digit of a double, so that equal objects are equal numbers."""

from __future__ import annotations

import json
import pathlib
import shutil
from typing import Any

import belfry
import jsonschema
import numpy as np
import pytest
from conftest import ROOT, Program


def without_times(report: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in report.items() if key != "timings"}


def is_as_its_schema_says(report: dict[str, Any]) -> bool:
    schema = json.loads((ROOT / "docs/schema" / f"{report['schema']}.json").read_text())
    jsonschema.Draft202012Validator(schema).validate(report)
    return True


@pytest.mark.parametrize(
    ("options", "arguments"),
    [
        ((), {}),
        (("--direct",), {"direct": True}),
        (("--direct", "--method", "subspace"), {"direct": True, "method": "subspace"}),
        (("--direct", "--every", "20min"), {"direct": True, "every_s": 1200.0}),
    ],
)
def test_modes(
    recorded: pathlib.Path,
    tmp_path: pathlib.Path,
    program: Program,
    options: tuple[str, ...],
    arguments: dict[str, Any],
) -> None:
    study = belfry.Study(shutil.copytree(recorded, tmp_path / "canton"))
    modes = study.identify(**arguments)
    assert without_times(modes.report) == without_times(program("identify", study.path, *options))
    assert is_as_its_schema_says(modes.report)
    # What the arrays hold is what the report says.
    listed = modes.report["modes"]
    assert len(modes) == len(listed) >= 10
    assert modes.numbers.tolist() == [mode["number"] for mode in listed]
    assert modes.frequencies_hz.tolist() == [mode["frequency_hz"] for mode in listed]
    assert modes.damping_ratios.tolist() == [mode["damping_ratio"] for mode in listed]
    assert (modes.frequency_stds_hz > 0).all()
    assert modes.shapes.shape == modes.shape_stds.shape == (len(modes), 20)
    assert modes.channels == tuple(f"{channel:02}" for channel in range(1, 21))
    for row, mode in enumerate(listed):
        assert modes.shapes[row].tolist() == [complex(part["re"], part["im"]) for part in mode["shape"]]
    # The largest component of each shape is 1, as formats.md has it; the scale is a division.
    assert np.abs(np.abs(modes.shapes).max(axis=1) - 1).max() < 1e-12


def test_modes_of_an_array_are_those_of_the_study(recorded: pathlib.Path, identified: pathlib.Path) -> None:
    recording = np.load(recorded / "simulated-january.npy")
    of_study = belfry.Study(identified).modes()
    points = [f"level {channel}" for channel in range(1, 21)]
    modes = belfry.identify(recording, 50, points=points, band_hz=(0.05, 1.5))
    assert modes.frequencies_hz.tolist() == of_study.frequencies_hz.tolist()
    assert modes.damping_ratio_stds.tolist() == of_study.damping_ratio_stds.tolist()
    assert modes.shapes.tolist() == of_study.shapes.tolist()
    assert modes.points == tuple(points)
    assert is_as_its_schema_says(modes.report)
    # A frequency does not depend on the unit, a sum that is scaled is another one in its last bits only.
    in_g = belfry.identify(recording / 9.80665, 50, unit="g", band_hz=(0.05, 1.5))
    assert np.allclose(in_g.frequencies_hz, modes.frequencies_hz, rtol=1e-4)
    # The mode that is asked for alone, which has no neighbour: within its standard deviation.
    asked = belfry.identify(recording, 50, band_hz=(0.05, 1.5), modes_hz=modes.frequencies_hz[[7]])
    assert np.abs(asked.frequencies_hz - modes.frequencies_hz[7]) < modes.frequency_stds_hz[7]
    assert len(asked) == 1


def test_modes_that_are_there(identified: pathlib.Path, copy: pathlib.Path) -> None:
    modes = belfry.Study(identified).modes()
    assert modes.report == json.loads((identified / "results/modes.json").read_text())
    # Those of another program: the text of a table.
    text = (copy / "study.toml").read_text()
    sensors, model = text[text.index("\n[[setup.sensor]]") :].split("\n[analysis]")
    table = "number,frequency_hz,frequency_std_hz,01,02,03\n1,0.11,,1,0.5,0\n2,0.16,0.001,,-1,0.25\n"
    (copy / "modes.csv").write_text(table)
    head = '[structure]\nname = "Tower"\n\n[measured]\nmodes = "modes.csv"\n\n'
    sensors = sensors.replace("[[setup.sensor]]", "[[sensor]]").replace("node =", "# node =")
    (copy / "study.toml").write_text(head + sensors + model[model.index("\n[model]") :])
    stated = belfry.Study(copy).modes()
    assert stated.frequencies_hz.tolist() == [0.11, 0.16]
    assert np.isnan(stated.frequency_stds_hz[0]) and stated.frequency_stds_hz[1] == 0.001
    assert np.isnan(stated.damping_ratios).all()
    assert stated.channels == ("01", "02", "03")
    # A shape has no sign of its own.
    assert (stated.shapes[0] / stated.shapes[0, 0]).tolist() == [1, 0.5, 0]
    assert np.isnan(stated.shapes[1, 0]) and stated.shapes[1, 2] / stated.shapes[1, 1] == -0.25
    assert any("no mode has a component" in warning for warning in stated.warnings)


def test_comparison(copy: pathlib.Path, program: Program) -> None:
    comparison = belfry.Study(copy).compare()
    assert comparison.report == program("compare", copy)
    assert is_as_its_schema_says(comparison.report)
    assert len(comparison.measured) == len(comparison.macs) >= 12
    # The error of a frequency is relative to the measured one, in percent.
    errors = 100 * (comparison.model_hz / comparison.measured_hz - 1)
    assert np.allclose(comparison.frequency_errors_percent, errors, rtol=1e-9, atol=1e-9)
    assert np.isclose(comparison.mean_abs_frequency_error_percent, np.abs(errors).mean())
    assert comparison.p_value < 1e-4


def test_update(copy: pathlib.Path, program: Program) -> None:
    update = belfry.Study(copy).update(modes=[1, 2, 3, 4, 5])
    assert update.report == program("update", copy, "--modes", "1,2,3,4,5")
    assert is_as_its_schema_says(update.report)
    assert update.measured.tolist() == [1, 2, 3, 4, 5]
    assert (update.psi == update.psi.T).all() and update.psi.shape == (5, 5)
    # The used frequencies are met exactly: K* is written, and NumPy finds them in it. Of some 100 eigenvalues that span ten decades, the
    # lowest are good to 1e-16 times that span.
    assert update.stiffness is not None
    # Of a symmetric matrix the file has the lower half, column by column.
    values = [float(line) for line in (copy / "results/mass.mtx").read_text().splitlines()[2:]]
    mass = np.zeros_like(update.stiffness)
    mass.T[np.triu_indices(len(mass))] = values
    mass += np.tril(mass, -1).T
    half = np.linalg.cholesky(mass)
    inner = np.linalg.solve(half, np.linalg.solve(half, update.stiffness).T)
    found_hz = np.sqrt(np.linalg.eigvalsh((inner + inner.T) / 2)) / (2 * np.pi)
    for measured_hz in update.measured_hz:
        assert np.abs(found_hz / measured_hz - 1).min() < 1e-4


def test_diagnosis_and_what_is_added(copy: pathlib.Path, program: Program) -> None:
    study = belfry.Study(copy)
    diagnosis = study.diagnose()
    assert diagnosis.report == program("diagnose", copy)
    assert is_as_its_schema_says(diagnosis.report)
    assert diagnosis.verdict == "effect"
    first = diagnosis.candidates[0]
    assert diagnosis.best[0] == first.name and first.effect == "added-mass"
    # The tower's truth is 2000 t: within three standard deviations, as 0.3 % of errors are not.
    [mass] = first.parameters
    assert mass.unit == "kg" and abs(mass.value - 2e6) < 3 * mass.std
    others = [candidate.probability for candidate in diagnosis.candidates if not np.isnan(candidate.probability)]
    total = sum(others) + diagnosis.adequate_probability + diagnosis.something_else_probability
    assert abs(total - 1) < 1e-6
    without = study.diagnose(without=["added-mass"])
    assert all(candidate.effect != "added-mass" for candidate in without.candidates)
    change = study.add(first.name)
    assert is_as_its_schema_says(change.report)
    assert [effect.name for effect in change.effects] == [first.name]
    assert change.after.mean_abs_frequency_error_percent < 0.5 * change.before.mean_abs_frequency_error_percent
    assert study.diagnose().verdict == "adequate"
