"""Reads what `belfry export` writes by other programs' libraries: universal files by pyuff, Parquet by PyArrow,
animations by Pillow.

    python3 tests/foreign/exports.py BELFRY STUDY

The study has modes (`belfry identify`) and a model. Frequencies, geometry and shapes must be those that Belfry says itself.
"""

import json
import pathlib
import subprocess
import sys
import tempfile

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))
import environment

ROOT = pathlib.Path(__file__).resolve().parents[2]
environment.enter(ROOT / "target/foreign-exports", ["numpy==1.26.4", "pyuff==2.5.8", "pyarrow==21.0.0", "pillow==11.3.0"])

import numpy as np
import pyarrow.parquet
import pyuff
from PIL import Image

BELFRY, STUDY = pathlib.Path(sys.argv[1]).resolve(), pathlib.Path(sys.argv[2]).resolve()
FOLDER = pathlib.Path(tempfile.mkdtemp())


def belfry(*words):
    subprocess.run([BELFRY, "export", STUDY, *words], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def sets(path, kind):
    file = pyuff.UFF(str(path))
    return [file.read_sets(at) for at, one in enumerate(file.get_set_types()) if one == kind]


def nodes_of_lines(lines):
    """Numbers of nodes that lines join; 0 lifts the pen."""
    return {int(node) for line in lines for node in np.asarray(line["nodes"]).ravel() if node > 0}


def measured_modes():
    path = FOLDER / "modes.uff"
    belfry("--format", "uff55", "--output", str(path))
    belfry("--format", "parquet", "--output", str(FOLDER / "modes.parquet"))
    modes = json.loads((STUDY / "results/modes.json").read_text())["modes"]
    read = sets(path, 55)
    assert len(read) == len(modes), (len(read), len(modes))
    for one, mode in zip(read, modes):
        # The eigenvalue of a damped mode; six digits in the file.
        frequency_hz = abs(one["eig"]) / (2 * np.pi)
        assert abs(frequency_hz / mode["frequency_hz"] - 1) < 1e-5, (frequency_hz, mode["frequency_hz"])
    [nodes] = sets(path, 15)
    lines = sets(path, 82)
    numbers = [int(node) for node in nodes["node_nums"]]
    assert nodes_of_lines(lines) == set(numbers)
    # Sensors at one place are one node.
    places = list(zip(nodes["x"], nodes["y"], nodes["z"]))
    assert len(set(places)) == len(places) == len(set(numbers)), places
    table = pyarrow.parquet.read_table(FOLDER / "modes.parquet").to_pydict()
    expected = [(mode["number"], part["channel"], part["re"], part["im"]) for mode in modes for part in mode["shape"]]
    found = sorted(zip(table["mode"], table["channel"], table["re"], table["im"]))
    assert [one[:2] for one in found] == [one[:2] for one in sorted(expected)]
    # Belfry reads its own JSON to within the last bit.
    assert np.allclose([one[2:] for one in found], [one[2:] for one in sorted(expected)], rtol=1e-15, atol=1e-18)
    return len(read)


def model_modes():
    belfry("--of", "model", "--output", str(FOLDER / "model"))
    path = FOLDER / "model/model_shapes.uff"
    [nodes] = sets(path, 2411)
    numbers = [int(number) for number in nodes["node_nums"]]
    assert nodes_of_lines(sets(path, 82)) == set(numbers)
    shapes = [line.split(",") for line in (FOLDER / "model/model_shapes.csv").read_text().splitlines()]
    table = pyarrow.parquet.read_table(FOLDER / "model/model_shapes.parquet").to_pydict()
    assert list(table) == shapes[0]
    for at, name in enumerate(shapes[0]):
        cells = [row[at] for row in shapes[1:]]
        assert table[name] == (cells if name in ("node", "dof") else [float(cell) if cell else None for cell in cells]), name
    names = ["ux", "uy", "uz", "rx", "ry", "rz"]
    read = sets(path, 55)
    for index, one in enumerate(read):
        column = shapes[0].index(f"mode_{index + 1}")
        largest = max(abs(float(row[column])) for row in shapes[1:])
        for row in shapes[1:]:
            node, dof = int(row[1]), names.index(row[2])
            at = list(one["node_nums"]).index(node)
            value = one[f"r{dof + 1}"][at]
            assert abs(value - float(row[column])) <= 1e-5 * largest, (index, row[:4], value)
    return len(read)


def animations():
    belfry("--of", "animation", "--output", str(FOLDER / "moving"))
    files = sorted((FOLDER / "moving").glob("animation_*.png"))
    for file in files:
        with Image.open(file) as picture:
            assert picture.is_animated and picture.n_frames == 24, picture
            frames = []
            for number in range(picture.n_frames):
                picture.seek(number)
                frames.append(np.asarray(picture.convert("RGB"), dtype=int))
        # Half a period apart the structure is elsewhere; a period of a cosine goes back the way that it came.
        assert (frames[0] != frames[12]).any()
    return len(files)


print(f"{measured_modes()} measured modes and {model_modes()} of the model are read by pyuff as Belfry says them, {animations()} animations by Pillow")
