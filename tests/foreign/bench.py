#!/usr/bin/env python3
"""How often Belfry is right about structures of another finite element code, OpenSees.

    cargo build --release && python3 tests/foreign/bench.py --cases 30 [--structure lattice|frame|tube] [--seed N]

Makes a virtual environment with openseespy beside the build (target/foreign). Every case is another structure with a hidden
effect, a wrong channel, something that no effect describes, or nothing; see README.md beside this file.
"""
import argparse
import concurrent.futures
import json
import math
import multiprocessing
import os
import pathlib
import re
import secrets
import statistics
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))
import environment  # noqa: E402

ROOT = pathlib.Path(__file__).resolve().parents[2]
WORK = ROOT / "target" / "foreign"
PACKAGES = ["openseespy==3.7.1.2", "numpy==2.4.6"]
STRUCTURES = ["lattice", "frame", "tube"]
# Draws of a structure and a size before a case is given up.
DRAWS = 12
# Error of the table's frequencies in percent above which a structure is drawn anew: it is no beam.
WORST_TABLE_PERCENT = 4.0
HEADER = (f"{'case':>4} {'structure':9} {'truth':24} {'moves':>6} {'table':>6} {'modes':>7} {'before':>7} {'after':>6} "
          f"{'verdict':9} {'':3} named, or (first candidate)")
# Twins that no modes tell apart.
TWINS = {"mass-scale": "stiffness-scale"}


def deck(structure, seed):
    """Cases of a structure in the order in which they are made: every effect once, three sound ones, channels, outsiders."""
    import defects
    import numpy as np

    effects = defects.EFFECTS + defects.OWN_EFFECTS.get(structure, [])
    cards = [("effect", kind) for kind in effects] + [("channel", kind) for kind in defects.CHANNELS]
    cards += [("outsider", kind) for kind in defects.OUTSIDERS[structure]] + [("sound", "nothing")] * 3
    np.random.default_rng([seed, STRUCTURES.index(structure)]).shuffle(cards)
    return [tuple(map(str, card)) for card in cards]


def make(structure, category, kind, random):
    """Draws structures until one can hide what it should: sound body and modes, table, errors, truth, body and modes with it."""
    import defects
    import numpy as np
    import structures
    import study
    import world

    reasons = []
    for _ in range(DRAWS):
        try:
            body = structures.KINDS[structure](random, slender=kind == "p-delta")
            if structure == "frame":
                structures.place_axis(body, study.twist_axis_m(body, world.answers_at_top(body)))
            sound = world.modes(body, defects.MODES)
            table, errors = study.beam_table(body, sound)
            if np.abs(errors).max() > WORST_TABLE_PERCENT:
                raise ValueError(f"the beam is off by {np.abs(errors).max():.1f} %")
            if kind in defects.FORGOTTEN:
                truth, table, errors = defects.forget(kind, body, sound, table)
                changed, modes = body, sound
            elif category == "effect":
                truth, changed, modes = defects.hide_effect(kind, body, sound, table, random)
            elif category == "outsider":
                truth, changed, modes = defects.hide_outsider(kind, body, sound, random)
            else:
                truth, changed, modes = defects.Truth(category, kind), body, sound
            return body, sound, (table, errors), truth, changed, modes
        except (ValueError, RuntimeError, np.linalg.LinAlgError) as error:
            reasons.append(str(error))
    raise RuntimeError(f"no structure shows it: {reasons[-1]}")


def belfry(arguments, *words):
    """What a command prints as JSON."""
    done = subprocess.run([arguments.belfry, *map(str, words), "--json"], capture_output=True, text=True, timeout=600)
    if done.returncode:
        raise RuntimeError(f"belfry {words[0]}: {done.stderr.strip()[-300:]}")
    return json.loads(done.stdout)


def run_case(arguments, structure, category, kind, index, folder):
    """Makes, records and diagnoses one case; all that is known of it as plain data."""
    import defects
    import numpy as np
    import study

    random = np.random.default_rng([arguments.seed, index])
    begin = time.perf_counter()
    body, sound, (table, errors), truth, changed, modes = make(structure, category, kind, random)
    placed = study.sensors(body, random)
    if category == "channel":
        truth = defects.hide_channel(kind, [sensor.channel for sensor in placed], random)
    seen = study.shapes(changed, modes, placed, arguments.rigid)
    samples, rate_hz, damping = study.record(changed, modes, seen, arguments.hours, random)
    study.spoil(samples, truth)
    band_hz = None
    if arguments.modes:
        ends = modes.frequencies_hz[modes.lowest(arguments.modes + 1)]
        band_hz = [round(float(hz), 4) for hz in (0.5 * ends[0], 0.5 * (ends[-2] + ends[-1]))]
    study.write_study(folder, changed, placed, samples, rate_hz, band_hz, table.effects())
    study.write_table(table.rows, folder / "beam.csv")
    made_s = time.perf_counter() - begin
    identified = belfry(arguments, "identify", folder, "--direct")
    compared = belfry(arguments, "compare", folder)
    diagnosed = belfry(arguments, "diagnose", folder)
    case = {
        "index": index, "structure": structure, "category": category, "kind": kind, "name": body.name,
        "detail": truth.detail, "place_m": truth.place_m, "channels": truth.channels, "values": truth.values,
        "shift_percent": truth.shift_percent, "height_m": body.height_m(), "mass_t": body.total_mass_kg() / 1000,
        "first_period_s": 1 / sound.frequencies_hz[0], "table_errors_percent": errors.tolist(),
        "table_mac": study.likeness(table, sound, 8).tolist(), "coupled_shear_m": table.coupled_shear_m,
        "frame_shares": table.frame_shares,
        "sampling_rate_hz": rate_hz,
        **judge_modes(identified, modes, seen, truth), **judge_pairing(compared), **judge_diagnosis(diagnosed, truth, body),
        "damping_ratio": damping[modes.lowest(20)].tolist(), "made_s": made_s,
    }
    if case["named"]:
        try:
            belfry(arguments, "add", folder, case["named"][0])
            case["error_after_percent"] = belfry(arguments, "compare", folder)["mean_abs_frequency_error_percent"]
        except RuntimeError as error:
            case["add_failed"] = str(error)
    case["seconds"] = time.perf_counter() - begin
    return case


def judge_modes(identified, truth_modes, shapes, truth):
    """How many of the true modes are found, in the range of those that are, and how well."""
    import numpy as np

    found = identified["modes"]
    if not found:
        return {"modes_true": 0, "modes_found": 0, "modes_more": 0, "identified_error_percent": None}
    measured = np.array([[point["re"] for point in mode["shape"]] for mode in found]).T
    columns = [int(name) - 1 for name in truth.channels]
    keep = [row for row in range(len(shapes)) if row not in columns]
    end_hz = max(mode["frequency_hz"] for mode in found) * 1.001
    wanted = [mode for mode in truth_modes.lowest(99) if truth_modes.frequencies_hz[mode] < end_hz]
    used, errors = set(), []
    for mode in wanted:
        true_hz, a = truth_modes.frequencies_hz[mode], shapes[keep, mode]
        best = None
        for i, other in enumerate(found):
            b = measured[keep, i]
            likeness = (a @ b) ** 2 / max((a @ a) * (b @ b), 1e-300)
            near = abs(other["frequency_hz"] / true_hz - 1) < 0.015 and likeness > 0.8
            if i not in used and near and (best is None or likeness > best[1]):
                best = i, likeness
        if best is not None:
            used.add(best[0])
            errors.append(abs(100 * (found[best[0]]["frequency_hz"] / true_hz - 1)))
    return {
        "modes_true": len(wanted), "modes_found": len(errors), "modes_more": len(found) - len(errors),
        "identified_error_percent": statistics.mean(errors) if errors else None,
    }


def judge_pairing(compared):
    """How the beam's modes agree with the measured ones."""
    return {
        "modes_paired": len(compared["pairs"]), "modes_unpaired": len(compared["unpaired"]),
        "error_before_percent": compared["mean_abs_frequency_error_percent"], "mac_before": compared["mean_mac"],
    }


def same(kind, channels, name):
    """Whether a name means the hidden effect; places along the height are judged apart, channels are not."""
    said, _, place = name.partition("@")
    if TWINS.get(said, said) != kind:
        return False
    return not channels or sorted(re.findall(r"\d+", place)) == sorted(channels)


def judge_diagnosis(diagnosed, truth, body):
    """Verdict, names, and whether they are right."""
    verdict = diagnosed["verdict"]
    named = diagnosed["best"] + [name for names in diagnosed["ambiguous"] for name in names]
    named = list(dict.fromkeys(named)) if verdict in ("effect", "ambiguous") else []
    candidates = diagnosed["candidates"]
    names = [c["effect"] + (f"@{c['where']}" if c["where"] else "") for c in candidates]
    right = [same(truth.kind, truth.channels, name) for name in named]
    result = {
        "verdict": verdict, "named": named, "candidates": names[:5],
        "log_bayes_factors": [c["log_bayes_factor"] for c in candidates[:5]],
        "present": diagnosed["present"], "goodness_of_fit": diagnosed["goodness_of_fit"],
        "first_right": None, "in_set": None, "candidate_first": None, "place_error_percent": None,
        "value_deviations": None, "false_effect": bool(named) and not any(right),
        "adequate": verdict == "adequate" if truth.category == "sound" else None,
        "unknown": verdict == "unknown" if truth.category == "outsider" else None,
        "error_after_percent": None,
    }
    if truth.category in ("effect", "channel"):
        result["first_right"] = bool(right) and right[0]
        result["in_set"] = any(right)
        result["candidate_first"] = bool(names) and same(truth.kind, truth.channels, names[0])
        if result["candidate_first"]:
            place = candidates[0]["where"]
            if truth.place_m is not None and place:
                result["place_error_percent"] = 100 * abs(float(place.rstrip("m")) - truth.place_m) / body.height_m()
            result["stated"] = stated(candidates[0], truth)
            distances = [max(low - value, value - high, 0.0) / std for _, value, std, (low, high) in result["stated"]]
            result["value_deviations"] = max(distances) if distances else None
    return result


def stated(candidate, truth):
    """Of each value that has a true interval: its name, itself, its stated standard deviation, and the interval."""
    found = []
    for parameter in candidate["parameters"]:
        value, std, interval = parameter["value"], parameter["std"], truth.values.get(parameter["name"])
        if interval is None or not std:
            continue
        if candidate["effect"] == "mass-scale":
            value, std = 1 / (1 + value) - 1, std / (1 + value) ** 2
        found.append((parameter["name"], value, std, interval))
    return found


def line(case):
    """A case in a line."""
    head = f"{case['index']:4} {case['structure']:9} {case['kind']:24}"
    if "failed" in case:
        return f"{head} failed: {case['failed'][:160]}"
    after = case["error_after_percent"]
    marks = {True: "yes", False: "NO", None: ""}
    right = next((case[key] for key in ("in_set", "adequate", "unknown") if case[key] is not None), None)
    names = ", ".join(case["named"]) or f"({next(iter(case['candidates']), '-')})"
    more = ""
    if case["place_error_percent"] is not None:
        more += f"; {case['place_error_percent']:.0f} % of the height off"
    if case["value_deviations"] is not None:
        more += f"; {case['value_deviations']:.1f} deviations off"
    worst = max(map(abs, case["table_errors_percent"]))
    return (f"{head} {case['shift_percent']:5.1f}% {worst:5.1f}% {case['modes_found']:3}/{case['modes_true']:<3} "
            f"{case['error_before_percent']:6.2f}% {'     -' if after is None else f'{after:5.2f}%'} "
            f"{case['verdict']:9} {marks[right]:3} {names}{more} [{case['seconds']:.0f} s]")


def wilson(right, count):
    """A share in percent with its 95 % interval."""
    if not count:
        return "-"
    z, share = 1.96, right / count
    middle = (share + z * z / (2 * count)) / (1 + z * z / count)
    half = z * math.sqrt(share * (1 - share) / count + z * z / (4 * count * count)) / (1 + z * z / count)
    low, high = (min(max(100 * x, 0.0), 100.0) for x in (middle - half, middle + half))
    return f"{right}/{count} = {100 * share:.0f} % ({low:.0f}-{high:.0f})"


def table(cases):
    """A column for each structure, a row for each measure; shares with Wilson's 95 % intervals."""
    columns = [*dict.fromkeys(case["structure"] for case in cases), "all"]
    shares = {
        "named first": lambda c: c["first_right"],
        "in the named set": lambda c: c["in_set"],
        "first candidate, whatever the verdict": lambda c: c["candidate_first"],
        "sound: adequate": lambda c: c["adequate"],
        "outsiders: unknown": lambda c: c["unknown"],
        "false effects": lambda c: c["false_effect"],
        "value within two deviations": lambda c: None if c["value_deviations"] is None else c["value_deviations"] <= 2,
    }
    means = {
        "place off, % of the height": lambda c: c["place_error_percent"],
        "table off, %, worst of 8 modes": lambda c: max(map(abs, c["table_errors_percent"])),
        "table's least MAC of 8 modes": lambda c: min(c["table_mac"]),
        "modes found, % of true ones": lambda c: 100 * c["modes_found"] / max(c["modes_true"], 1),
        "frequency of modes found off, %": lambda c: c["identified_error_percent"],
        "frequency error before, %": lambda c: c["error_before_percent"],
        "the same where an effect was added": lambda c: c["error_before_percent"] if c["error_after_percent"] else None,
        "and after it was added, %": lambda c: c["error_after_percent"],
    }
    rows = [["", *columns]]
    by_column = [[c for c in cases if column in ("all", c["structure"])] for column in columns]
    done = [[c for c in part if "failed" not in c] for part in by_column]
    rows.append(["cases (failed)", *(f"{len(a)} ({len(a) - len(b)})" for a, b in zip(by_column, done))])
    for name, of in shares.items():
        judged = [[of(c) for c in part if of(c) is not None] for part in done]
        rows.append([name, *(wilson(sum(part), len(part)) for part in judged)])
    for name, of in means.items():
        judged = [[of(c) for c in part if of(c) is not None] for part in done]
        rows.append([name, *(f"{statistics.mean(part):.3g}" if part else "-" for part in judged)])
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return "\n".join("  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip() for row in rows)


def quiet():
    """Drops what OpenSees prints on standard error; exceptions come back by themselves."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=30)
    parser.add_argument("--structure", choices=STRUCTURES, action="append", help="repeat for more; default all three")
    parser.add_argument("--seed", type=int, help="default: drawn now, and printed")
    parser.add_argument("--keep", type=pathlib.Path, metavar="DIR", help="keep every case's study here")
    parser.add_argument("--belfry", type=pathlib.Path, default=ROOT / "target" / "release" / "belfry")
    parser.add_argument("--hours", type=float, default=6.0, help="length of a recording")
    parser.add_argument("--modes", type=int, help="end Belfry's band above so many modes; default: Belfry's own choice")
    parser.add_argument("--rigid", action="store_true", help="sensors see the rigid motion of sections, not that of nodes")
    parser.add_argument("--only", metavar="KIND", help="hide nothing but this (an effect, an outsider, or `nothing`)")
    parser.add_argument("--json", type=pathlib.Path, metavar="FILE", help="default: target/foreign/results-SEED.json")
    arguments = parser.parse_args()
    environment.enter(WORK, PACKAGES)

    if not arguments.belfry.exists():
        sys.exit("belfry is not built; run `cargo build --release` first, or name one with --belfry")
    arguments.belfry = arguments.belfry.resolve()
    if arguments.seed is None:
        arguments.seed = secrets.randbelow(2**31)
    print(f"seed {arguments.seed}", flush=True)
    wanted = arguments.structure or STRUCTURES
    decks = {structure: deck(structure, arguments.seed) for structure in wanted}
    if arguments.only:
        decks = {structure: [card for card in cards if card[1] == arguments.only] for structure, cards in decks.items()}
        wanted = [structure for structure in wanted if decks[structure]]
        if not wanted:
            sys.exit(f"no structure hides `{arguments.only}`")
    results = arguments.json or WORK / f"results-{arguments.seed}.json"
    cases = []
    print(HEADER, flush=True)
    for index in range(arguments.cases):
        structure = wanted[index % len(wanted)]
        cards = decks[structure]
        category, kind = cards[index // len(wanted) % len(cards)]
        with tempfile.TemporaryDirectory(dir=WORK) as scratch:
            folder = (arguments.keep or pathlib.Path(scratch)) / f"{index:03}-{structure}-{kind}"
            folder.mkdir(parents=True, exist_ok=True)
            try:
                # In a process of its own: OpenSees keeps state, and a crash of it is one failed case.
                with concurrent.futures.ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), quiet) as process:
                    case = process.submit(run_case, arguments, structure, category, kind, index, folder).result()
            except Exception as error:  # A case that fails is reported, and the bench goes on.
                case = {"index": index, "structure": structure, "category": category, "kind": kind,
                        "failed": f"{type(error).__name__}: {error}"}
        cases.append(case)
        print(line(case), flush=True)
        results.write_text(json.dumps({"seed": arguments.seed, "cases": cases}, indent=1) + "\n")
    print(table(cases))
    print(f"all results: {results}")


if __name__ == "__main__":
    main()
