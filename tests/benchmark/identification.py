#!/usr/bin/env python3
"""Belfry beside pyOMA2 on the same recordings: accuracy, CPU and memory.

    cargo build --release && python3 tests/benchmark/identification.py [--seeds 3] [--case day]

Makes a virtual environment with pyOMA2 beside the build (target/benchmark), simulates two coupled ten-storey chains (20
channels, 5 % noise, 12 modes, damping 1 %, closest pair 1.8 % apart), and prints one row a method. pyOMA2 is given the true
frequencies to pick at; Belfry picks by itself. Every method runs in a process of its own, so that CPU and memory are its.
"""
import argparse
import json
import os
import pathlib
import resource
import subprocess
import sys

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))
import environment  # noqa: E402

ROOT = pathlib.Path(__file__).resolve().parents[2]
WORK = ROOT / "target" / "benchmark"
BELFRY = ROOT / "target" / "release" / "belfry"
METHODS = ["EFDD", "FSDD", "SSI-cov"]
# Name: hours, sampling rate, band, how many times as fast the structure is.
CASES = {"day": (24.0, 2.5, [0.03, 1.0], 1.0), "hour": (1.0, 50.0, [0.6, 20.0], 20.0)}
# Segment of pyOMA2's spectra, in samples.
SEGMENT = 2048


def chains(case):
    """Frequencies in Hz and shapes (20 x 12) of two coupled chains of unit masses, the highest mode at 0.93 Hz (18.6 Hz)."""
    import numpy as np

    stiffness = np.zeros((20, 20))
    for chain, k in enumerate([1.0, 1.018**2]):
        for storey in range(10):
            i = 10 * chain + storey
            stiffness[i, i] += k
            if storey:
                stiffness[i - 1, i - 1] += k
                stiffness[i - 1, i] -= k
                stiffness[i, i - 1] -= k
    for i in range(10):
        stiffness[[i, i + 10], [i, i + 10]] += 1e-4
        stiffness[[i, i + 10], [i + 10, i]] -= 1e-4
    values, vectors = np.linalg.eigh(stiffness)
    return 0.93 * CASES[case][3] * np.sqrt(values[:12] / values[11]), vectors[:, :12]


def simulate(case, seed):
    """Accelerations, rows x channels: every mode an exact oscillator under white force of its own."""
    import numpy as np
    from scipy.signal import firwin, lfilter

    hours, rate, _, _ = CASES[case]
    # Made four times finer: an oscillator's step must be short beside its period.
    fine = 4
    step, rows = 1.0 / (rate * fine), int(hours * 3600 * rate)
    frequencies, shapes = chains(case)
    random = np.random.default_rng(seed)
    taps = firwin(20 * fine + 1, 0.9 / fine) if fine > 1 else np.ones(1)
    motion = np.zeros((rows, len(frequencies)))
    for mode, frequency in enumerate(frequencies):
        omega, damping = 2 * np.pi * frequency, 0.01
        pole = omega * complex(-damping, np.sqrt(1 - damping**2))
        power = (np.exp(2 * pole.real * step) - 1) / (2 * pole.real)
        square = (np.exp(2 * pole * step) - 1) / (2 * pole)
        covariance = 0.5 * np.array([[power + square.real, square.imag], [square.imag, power - square.real]])
        factor = np.linalg.cholesky(covariance)
        count = (rows + 400) * fine
        kicks = factor @ random.standard_normal((2, count))
        state = lfilter([1.0], [1.0, -np.exp(pole * step)], kicks[0] + 1j * kicks[1])
        velocity = (pole * state).imag / pole.imag
        acceleration = lfilter(taps, 1.0, np.diff(velocity, prepend=0.0) / step)
        motion[:, mode] = acceleration[::fine][400:]
    recorded = motion @ shapes.T
    recorded += 0.05 * recorded.std(axis=0) * random.standard_normal(recorded.shape)
    return recorded


def write_study(case, seed):
    import numpy as np

    hours, rate, band, _ = CASES[case]
    folder = WORK / f"{case}-{seed}"
    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / "recording.npy").exists():
        np.save(folder / "recording.npy", simulate(case, seed))
    sensors = "".join(f'[[setup.sensor]]\nchannel = "{i + 1}"\nnode = {i // 4 + 1}\n' for i in range(20))
    (folder / "study.toml").write_text(
        f'[structure]\nname = "Two chains"\n[[setup]]\nname = "one"\nfiles = ["recording.npy"]\n'
        f'sampling_rate_hz = {rate}\nunit = "m/s2"\n{sensors}[analysis]\nband_hz = {band}\n'
    )
    return folder


def pyoma(method, folder, case):
    """One method of pyOMA2 at the true frequencies: prints frequencies, damping ratios and shapes."""
    import numpy as np
    from pyoma2.algorithms import EFDD, FSDD, SSI
    from pyoma2.setup import SingleSetup

    _, rate, _, fast = CASES[case]
    data = np.load(folder / "recording.npy")
    frequencies, _ = chains(case)
    setup = SingleSetup(data, fs=rate)
    if method == "SSI-cov":
        algorithm = SSI(name=method, method="cov", br=60, ordmax=80)
    else:
        algorithm = (EFDD if method == "EFDD" else FSDD)(name=method, nxseg=SEGMENT)
    setup.add_algorithms(algorithm)
    setup.run_all()
    if method == "SSI-cov":
        setup.mpe(method, sel_freq=list(frequencies), order_in=60)
    else:
        # How far the peak may be from the true frequency, and how much of the bell is read: its defaults are for stiffer
        # structures.
        setup.mpe(method, sel_freq=list(frequencies), DF1=0.002 * fast, DF2=0.03 * fast)
    result = setup[method].result
    print(json.dumps({
        "frequency_hz": np.real(np.ravel(result.Fn)).tolist(),
        "damping_ratio": np.real(np.ravel(result.Xi)).tolist(),
        "re": np.real(result.Phi).tolist(),
        "im": np.imag(result.Phi).tolist(),
    }))


def run(command):
    """Output, CPU seconds and peak MB of a process."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    output, error = process.communicate()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if process.returncode:
        sys.exit(f"{' '.join(map(str, command))}\n{error.decode()[-2000:]}")
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return output.decode(), cpu


def peak_mb(command):
    """Peak memory of a process, by a process in between whose only child it is."""
    watcher = (
        "import resource, subprocess, sys; subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL, "
        "stderr=subprocess.DEVNULL); print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024)"
    )
    return float(run([sys.executable, "-c", watcher, *map(str, command)])[0])


def score(found, frequencies, shapes):
    """Errors of the modes found: every true mode takes the mode within 2 % that resembles it the most."""
    import numpy as np

    phi = np.array(found["re"]) + 1j * np.array(found["im"])
    def mac(mode, truth):
        a, b = phi[:, mode], shapes[:, truth]
        return abs(np.vdot(a, b)) ** 2 / (np.vdot(a, a).real * np.vdot(b, b))
    errors, damping, macs, missed, used = [], [], [], 0, set()
    for truth, frequency in enumerate(frequencies):
        near = [m for m, f in enumerate(found["frequency_hz"]) if m not in used and abs(f / frequency - 1) < 0.02]
        best = max(near, key=lambda m: mac(m, truth), default=None)
        if best is None or not mac(best, truth) > 0.8:
            missed += 1
            continue
        used.add(best)
        errors.append(100 * (found["frequency_hz"][best] / frequency - 1))
        damping.append(found["damping_ratio"][best] / 0.01)
        macs.append(mac(best, truth))
    return errors, damping, macs, missed, len(found["frequency_hz"]) - len(used)


def belfry(folder):
    report = json.loads(run([BELFRY, "identify", folder, "--direct", "--json"])[0])
    column = lambda part: [[mode["shape"][row][part] for mode in report["modes"]] for row in range(20)]
    return {
        "frequency_hz": [mode["frequency_hz"] for mode in report["modes"]],
        "damping_ratio": [mode["damping_ratio"] for mode in report["modes"]],
        "re": column("re"),
        "im": column("im"),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--case", choices=list(CASES), action="append")
    parser.add_argument("--child", nargs=3, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        method, folder, case = arguments.child
        return pyoma(method, pathlib.Path(folder), case)
    environment.enter(WORK, ["pyOMA_2==1.4.3"])

    import numpy as np

    if not BELFRY.exists():
        sys.exit("belfry is not built; run `cargo build --release` first")
    print(f"{'data':6} {'method':8} {'CPU s':>7} {'peak MB':>8} {'f error median / max %':>23} {'damping / truth':>16} "
          f"{'min MAC':>8} {'missed':>7} {'invented':>9}")
    for case in arguments.case or list(CASES):
        frequencies, shapes = chains(case)
        folders = [write_study(case, seed) for seed in range(1, arguments.seeds + 1)]
        for method in ["belfry", *METHODS]:
            rows = []
            for folder in folders:
                if method == "belfry":
                    command = [BELFRY, "identify", folder, "--direct"]
                    found = belfry(folder)
                else:
                    command = [sys.executable, __file__, "--child", method, folder, case]
                    found = json.loads(run(command)[0].splitlines()[-1])
                _, cpu = run(command)
                rows.append((cpu, peak_mb(command), score(found, frequencies, shapes)))
            errors = np.abs(np.concatenate([row[2][0] for row in rows]))
            damping = np.concatenate([row[2][1] for row in rows])
            print(f"{case:6} {method:8} {np.median([row[0] for row in rows]):7.2f} {max(row[1] for row in rows):8.0f} "
                  f"{np.median(errors):13.4f} / {errors.max():7.3f} {damping.min():8.3f}-{damping.max():6.3f} "
                  f"{min(min(row[2][2]) for row in rows):9.5f} {sum(row[2][3] for row in rows):7} "
                  f"{sum(row[2][4] for row in rows):9}", flush=True)


if __name__ == "__main__":
    main()
