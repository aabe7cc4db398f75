"""What goes wrong is an exception with Belfry's own words; a caller can stop long work."""

from __future__ import annotations

import pathlib
import signal
import subprocess
import sys
import threading
import time
from typing import Any, Callable

import belfry
import numpy as np
import pytest
from belfry._arguments import samples
from conftest import Program


def test_errors_are_those_of_the_program(recorded: pathlib.Path, tmp_path: pathlib.Path, program: Program) -> None:
    calls: list[tuple[str, Callable[[], object], pathlib.Path]] = [
        ("identify", lambda: belfry.Study(tmp_path / "nowhere"), tmp_path / "nowhere"),
        ("compare", belfry.Study(recorded).compare, recorded),
        ("diagnose", belfry.Study(recorded).diagnose, recorded),
    ]
    for command, call, path in calls:
        said = program(command, path)["error"]
        with pytest.raises(belfry.BelfryError) as raised:
            call()
        assert raised.value.message == said["message"]
        assert list(raised.value.causes) == said["causes"]
        assert all(part in str(raised.value) for part in [said["message"], *said["causes"]])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"band_hz": (2.0, 1.0)}, "band_hz: .*write the lower frequency first"),
        ({"band_hz": (0.1, 90.0)}, "band_hz: .*nothing above 25 Hz .half the sampling rate"),
        ({"band_hz": (0.1, float("nan"))}, "band_hz: .*both above 0"),
        ({"band_hz": 1.5}, "band_hz: .*such as"),
        ({"segment": 1000}, "segment: .*power of two"),
        ({"segment": 1024.0}, "segment: .*found 1024.0"),
        ({"unit": "feet"}, "unit: .*'m/s2'.*found 'feet'"),
        ({"unit": "V"}, "unit: .*found 'V'"),
        ({"points": ["a", "a"]}, r"points\[1\]: 'a' is already used by points\[0\]"),
        ({"points": ["a", ""]}, r"points\[1\]: .*found ''"),
        ({"points": "ab"}, "points: expected a list of names"),
        ({"points": ["a"]}, "points: expected 2 names.*found 1"),
        ({"method": "guess"}, "method: .*'subspace'"),
        ({"sampling_rate_hz": 0}, "sampling_rate_hz: .*above 0"),
        ({"sampling_rate_hz": float("nan")}, "sampling_rate_hz: .*found nan"),
        ({"sampling_rate_hz": "50"}, "sampling_rate_hz: .*found '50'"),
        ({"modes_hz": [1.0, 1.0]}, "modes_hz: .*each above 0 and once"),
        ({"modes_hz": [1.0], "drop_modes_hz": [2.0]}, "modes_hz: .*leave out"),
        ({"recording": np.zeros((0, 2))}, "recording: it has no samples"),
        ({"recording": np.zeros((0, 0))}, "recording: it has no column"),
        ({"recording": np.zeros((2, 2, 2))}, "recording: .*3 axes"),
        ({"recording": np.float64(1.0)}, "recording: .*0 axes"),
        ({"recording": [["a"]]}, "recording: expected real numbers"),
        ({"recording": [[1.0, 2.0], [3.0]]}, "recording: expected an array"),
        ({"recording": np.zeros((9, 2), dtype="datetime64[s]")}, "recording: expected real numbers"),
        ({"recording": np.zeros((20_000, 2), dtype=complex)}, "recording: expected real numbers, found complex128"),
        ({"recording": np.ma.zeros((20_000, 2), dtype=complex)}, "recording: expected real numbers, found complex128"),
        ({"recording": np.zeros((5000, 4097))}, "recording: .*4096"),
    ],
)
def test_arguments_that_cannot_be_meant(arguments: dict[str, Any], words: str) -> None:
    noise = np.random.default_rng(1).standard_normal((20_000, 2))
    with pytest.raises(belfry.ArgumentError, match=words) as raised:
        belfry.identify(**{"recording": noise, "sampling_rate_hz": 50.0, **arguments})
    assert isinstance(raised.value, ValueError) and isinstance(raised.value, belfry.BelfryError)
    assert_speaks_of_arguments(str(raised.value))


def assert_speaks_of_arguments(words: str) -> None:
    """No file that is gone by now, and no line of a study that the caller never wrote."""
    assert not [word for word in ("/tmp", "study.toml", "recording.npy", "[analysis]", "line ") if word in words], words


@pytest.mark.parametrize("arguments", [{}, {"points": ["a", "b", "c"]}, {"points": [str(row) for row in range(3000)]}])
def test_a_recording_that_is_transposed(arguments: dict[str, Any]) -> None:
    noise = np.random.default_rng(1).standard_normal((3000, 3))
    with pytest.raises(belfry.ArgumentError, match="transposed") as raised:
        belfry.identify(noise.T, 50.0, **arguments)
    # The shape that was found, and what it would mean.
    assert "(3, 3000): 3 samples of 3000 channels" in str(raised.value)
    assert_speaks_of_arguments(str(raised.value))


def test_names_that_are_those_of_the_rows() -> None:
    with pytest.raises(belfry.ArgumentError, match="expected 3 names.*found 5.*transposed"):
        belfry.identify(np.zeros((5, 3)), 50.0, points=["a", "b", "c", "d", "e"])
    with pytest.raises(belfry.ArgumentError, match="expected 3 names") as raised:
        belfry.identify(np.zeros((500, 3)), 50.0, points=["a", "b", "c", "d"])
    assert "transposed" not in str(raised.value)


def test_a_recording_that_is_too_short_is_told_without_a_file() -> None:
    with pytest.raises(belfry.BelfryError, match="too short") as raised:
        belfry.identify(np.zeros((10, 2)), 50.0)
    assert_speaks_of_arguments(str(raised.value))


@pytest.mark.parametrize("dtype", [np.float64, np.int16, object])
def test_masked_samples_are_missing(dtype: type) -> None:
    values = np.arange(12).reshape(6, 2).astype(dtype)
    mask = np.zeros(values.shape, dtype=bool)
    mask[2, 1] = True
    if dtype is object:
        values[2, 1] = None
    given = np.ma.array(values, mask=mask)
    taken = samples(given)
    assert taken.dtype == np.float64
    assert (np.isnan(taken) == mask).all()
    assert taken[~mask].tolist() == [value for value in range(12) if value != 5]
    # The caller's array is as it was.
    assert given.data[2, 1] == (None if dtype is object else 5)


def test_masked_samples_are_a_gap_to_the_library() -> None:
    noise = np.random.default_rng(1).standard_normal((20_000, 2))
    with pytest.raises(belfry.BelfryError, match="100.0 % of the samples of each are missing"):
        belfry.identify(np.ma.array(noise, mask=np.ones(noise.shape, dtype=bool)), 50.0)


@pytest.mark.parametrize("recording", [np.arange(6), [0, 1, 2, 3, 4, 5], np.arange(6, dtype=np.float32)])
def test_one_axis_is_one_channel(recording: Any) -> None:
    assert samples(recording).tolist() == [[0.0], [1.0], [2.0], [3.0], [4.0], [5.0]]


def test_arguments_of_a_study(recorded: pathlib.Path) -> None:
    study = belfry.Study(recorded)
    calls: list[tuple[str, Callable[[], object]]] = [
        ("method", lambda: study.identify(method="guess")),
        ("every_s", lambda: study.identify(every_s=0.5)),
        ("frequency_weight", lambda: study.update(frequency_weight=-1.0)),
    ]
    for argument, call in calls:
        with pytest.raises(belfry.ArgumentError, match=argument):
            call()


def test_noise_has_no_modes() -> None:
    noise = np.random.default_rng(1).standard_normal((100_000, 3))
    with pytest.raises(belfry.BelfryError, match="no modes were found"):
        belfry.identify(noise, 50.0)


def test_progress_is_told_and_its_exception_ends_the_work(copy: pathlib.Path) -> None:
    study, told = belfry.Study(copy), []
    study.diagnose(on_progress=lambda *progress: told.append(progress))
    assert len({stage for stage, _, _ in told}) > 1
    assert all(0 <= done <= total for _, done, total in told)

    before = (copy / "results/modes.json").read_bytes()
    for step in (study.diagnose, study.identify):
        heard: list[object] = []

        def listener(*progress: object) -> None:
            heard.append(progress)
            if len(heard) == 2:
                raise KeyError("enough")

        with pytest.raises(KeyError, match="enough"):
            step(on_progress=listener)  # type: ignore[operator]
        assert len(heard) == 2
    # What was there stays as it was, nothing is half written, and the study can be used.
    assert (copy / "results/modes.json").read_bytes() == before
    assert not list(copy.rglob("*.partial"))
    assert study.compare().mean_mac > 0.9


def test_other_threads_run_meanwhile(copy: pathlib.Path) -> None:
    """The longest that another thread was kept waiting is a small part of the time that the work took."""
    study, done, waits = belfry.Study(copy), threading.Event(), []

    def tick() -> None:
        last = time.monotonic()
        while not done.wait(0.005):
            now = time.monotonic()
            waits.append(now - last)
            last = now

    thread = threading.Thread(target=tick)
    thread.start()
    start = time.monotonic()
    study.diagnose()
    took = time.monotonic() - start
    done.set()
    thread.join()
    assert max(waits) < 0.5 * took, (max(waits), took)


@pytest.mark.parametrize("step", ["identify", "diagnose"])
def test_an_interruption_ends_the_work(copy: pathlib.Path, step: str) -> None:
    script = (
        "import belfry, signal, sys\n"
        # Whoever starts this in the background has it ignore interruptions.
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "try:\n"
        f"    belfry.Study(sys.argv[1]).{step}(on_progress=lambda *_: print('at work', flush=True))\n"
        "except KeyboardInterrupt:\n"
        "    print('interrupted')\n"
        "    belfry.Study(sys.argv[1]).compare()\n"
        "    print('goes on')\n"
    )
    running = subprocess.Popen([sys.executable, "-c", script, copy], stdout=subprocess.PIPE, text=True)
    assert running.stdout is not None
    assert running.stdout.readline() == "at work\n"
    running.send_signal(signal.SIGINT)
    said, _ = running.communicate(timeout=60)
    lines = [line for line in said.splitlines() if line != "at work"]
    assert lines == ["interrupted", "goes on"]
    assert running.returncode == 0
    assert not list(copy.rglob("*.partial"))


def test_a_study_that_another_program_writes_into_is_waited_for(copy: pathlib.Path) -> None:
    import fcntl

    stages: list[str] = []
    with open(copy / ".belfry-lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        threading.Timer(0.5, lambda: fcntl.flock(lock, fcntl.LOCK_UN)).start()
        belfry.Study(copy).compare(on_progress=lambda stage, *_: stages.append(stage))
    assert "waiting for another command" in stages
