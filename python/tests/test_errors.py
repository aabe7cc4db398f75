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
    ("arguments", "kind", "words"),
    [
        ({"band_hz": (2.0, 1.0)}, belfry.BelfryError, "write the lower frequency first"),
        ({"band_hz": (0.1, 90.0)}, belfry.BelfryError, "half the sampling rate"),
        ({"segment": 1000}, belfry.BelfryError, "power of two"),
        ({"unit": "feet"}, belfry.BelfryError, "feet"),
        ({"points": ["a", "a"]}, belfry.BelfryError, "already used"),
        ({"points": ["a"]}, ValueError, "expected 2 names"),
        ({"method": "guess"}, ValueError, "subspace"),
        ({"sampling_rate_hz": 0}, belfry.BelfryError, "sampling_rate_hz"),
        ({"sampling_rate_hz": float("nan")}, belfry.BelfryError, "sampling_rate_hz"),
        ({"recording": np.zeros((10, 2))}, belfry.BelfryError, "too short"),
        ({"recording": np.zeros((0, 2))}, belfry.BelfryError, "is empty"),
        ({"recording": np.zeros((0, 0))}, ValueError, "no column"),
        ({"recording": np.zeros((2, 2, 2))}, ValueError, "3 axes"),
        ({"recording": [["a"]]}, ValueError, "float"),
    ],
)
def test_arguments_that_cannot_be_meant(arguments: dict[str, Any], kind: type[Exception], words: str) -> None:
    noise = np.random.default_rng(1).standard_normal((20_000, 2))
    with pytest.raises(kind, match=words) as raised:
        belfry.identify(**{"recording": noise, "sampling_rate_hz": 50.0, **arguments})
    # No path of a file that is gone by now.
    assert "/tmp" not in str(raised.value)


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
