#!/usr/bin/env python3
"""Minimises the paper's objective (Lei, Wang, Shen 2012, eq. 14) over the 55 entries of Psi with SciPy's SLSQP, twenty
starts a problem, and writes what it reaches into problems.json beside it, where the update's test reads it.

Needs SciPy only. The problems are written by
    cargo test -p belfry-host --lib update::tests::write_psi_problems -- --ignored
"""
import json
import pathlib
import sys
import time

import numpy as np
from scipy.optimize import minimize

STARTS = 20
FILE = pathlib.Path(__file__).with_name("problems.json")


def main():
    recorded = json.loads(FILE.read_text())
    for number, problem in enumerate(recorded["problems"], 1):
        model = np.array(problem["model_lambda"])
        measured = np.array(problem["measured_lambda"])
        chi = np.array(problem["shapes"])
        shapes = np.array(problem["measured_shapes"]).T
        shapes = shapes / np.linalg.norm(shapes, axis=0)
        weights = np.array(problem["weights"])
        m = len(model)
        upper = np.triu_indices(m)
        # Psi in units of sqrt(lambda_i lambda_j), so that all unknowns are of one size.
        scale = np.sqrt(np.outer(model, model))[upper]

        def modes(x):
            psi = np.zeros((m, m))
            psi[upper] = x * scale
            psi = psi + psi.T - np.diag(np.diag(psi))
            return np.linalg.eigh(np.diag(model) + psi)

        def objective(x):
            lam, v = modes(x)
            b = chi @ v
            mac = np.sum(b * shapes, axis=0) ** 2 / np.sum(b * b, axis=0)
            # Eigenvalues ascend and so do the measured ones.
            relative = np.sqrt(np.maximum(lam, 0) / measured) - 1
            return problem["frequency_weight"] * np.sum(relative**2) + np.sum(weights * (1 - mac) ** 2)

        random = np.random.default_rng(number)
        values, errors, seconds = [], [], []
        for start in range(STARTS):
            x0 = np.zeros(len(scale)) if start == 0 else random.normal(0, 0.1, len(scale))
            begin = time.perf_counter()
            result = minimize(objective, x0, method="SLSQP", options={"maxiter": 1000, "ftol": 1e-12})
            seconds.append(time.perf_counter() - begin)
            values.append(float(result.fun))
            errors.append(100 * float(np.max(np.abs(np.sqrt(np.maximum(modes(result.x)[0], 0) / measured) - 1))))
        best = int(np.argmin(values))
        problem["slsqp_best_objective"] = values[best]
        problem["slsqp_median_objective"] = float(np.median(values))
        problem["slsqp_largest_frequency_error_percent"] = errors[best]
        problem["slsqp_seconds_a_run"] = float(np.median(seconds))
        print(f"tower {number}: best {values[best]:.4e}, median {np.median(values):.4e}, frequency error "
              f"{errors[best]:.1e} %, {np.median(seconds):.2f} s a run", flush=True)
    FILE.write_text(json.dumps(recorded) + "\n")


if __name__ == "__main__":
    sys.exit(main())
