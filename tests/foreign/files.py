"""Writes one recording, and small matrices, in the formats of other programs, by those programs' own libraries: what host/tests-data holds.

    python3 tests/foreign/files.py [FOLDER]

Values are multiples of 2^-23 between -1 and 1, so that single precision and 24 bits hold them exactly: every format must give the same numbers.
"""

import pathlib
import sys

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))
import environment

ROOT = pathlib.Path(__file__).resolve().parents[2]
environment.enter(
    ROOT / "target/foreign-files",
    ["h5py==3.16.0", "hdf5storage==0.2.2", "numpy==1.26.4", "scipy==1.17.1", "npTDMS==1.13.0", "soundfile==0.14.0", "obspy==1.5.1", "pyNastran==1.4.1", "pyuff==2.5.8", "pymseed==1.0.1"],
)

import h5py
import numpy as np

FOLDER = pathlib.Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "host/tests-data"
FOLDER.mkdir(parents=True, exist_ok=True)
RATE_HZ, ROWS = 50.0, 300
NAMES = ["top-x", "top-y"]
RANDOM = np.random.default_rng(23)
COUNTS = RANDOM.integers(-(2**23), 2**23, (ROWS, 2))
RECORD = COUNTS / 2.0**23


def stiffness():
    """A chain of six springs, as SciPy's compressed columns."""
    import scipy.sparse as sparse

    return sparse.diags_array([[-1.0] * 5, [2.0] * 5 + [1.0], [-1.0] * 5], offsets=[-1, 0, 1]).tocsc() * 1e6


def matlab(path, variables, **options):
    """A file as MATLAB's save -v7.3 lays it out: its own block of 512 bytes first, dimensions turned round, classes as attributes."""
    with h5py.File(path, "w", userblock_size=512, **options) as file:
        for name, value in variables.items():
            if hasattr(value, "indptr"):
                group = file.create_group(name)
                group.attrs["MATLAB_class"] = np.bytes_("double")
                group.attrs["MATLAB_sparse"] = np.uint64(value.shape[0])
                group["data"] = value.data
                group["ir"] = value.indices.astype("u8")
                group["jc"] = value.indptr.astype("u8")
            elif isinstance(value, str):
                file[name] = np.frombuffer(value.encode("utf-16-le"), "u2").reshape(-1, 1)
                file[name].attrs["MATLAB_class"] = np.bytes_("char")
            else:
                chunks = (1, 64) if value.ndim == 2 else (64, 1)
                large = {"chunks": chunks, "compression": "gzip"} if value.size > 50 else {}
                dataset = file.create_dataset(name, data=np.atleast_2d(value).T, **large)
                dataset.attrs["MATLAB_class"] = np.bytes_("double")
    block = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Sun Nov 29 12:00:00 2026 HDF5 schema 1.00 ."
    with open(path, "r+b") as file:
        file.write(block.ljust(116) + bytes(8) + b"\x00\x02IM")


def write_hdf5():
    matlab(FOLDER / "matlab73.mat", {"K": stiffness(), "M": np.diag([2.0e3] * 6), "note": "a chain"})
    matlab(FOLDER / "matlab73_record.mat", {"acc": RECORD, "fs": np.array(RATE_HZ)})
    import hdf5storage

    hdf5storage.savemat(str(FOLDER / "hdf5storage.mat"), {"acc": RECORD}, format="7.3", oned_as="column")
    with h5py.File(FOLDER / "h5py_matrix.h5", "w") as file:
        dataset = file.create_dataset("data", data=RECORD, chunks=(64, 1), shuffle=True, compression="gzip", fletcher32=True)
        dataset.attrs["sampling_rate_hz"] = RATE_HZ
    with h5py.File(FOLDER / "h5py_channels.h5", "w", track_order=True) as file:
        file.attrs["title"] = "a mast"
        group = file.create_group("run 1")
        group.attrs["fs"] = RATE_HZ
        for name, column in zip(NAMES, RECORD.T):
            dataset = group.create_dataset(name, data=column.astype("f4" if name == "top-x" else ">f8"))
            dataset.attrs["units"] = "m/s2"
    with h5py.File(FOLDER / "h5py_latest.h5", "w", libver="latest") as file:
        file.create_dataset("whole", data=RECORD, chunks=RECORD.shape, compression="gzip")
        file["flat"] = RECORD[:3]
    with h5py.File(FOLDER / "h5py_unread.h5", "w", libver="latest") as file:
        file.create_dataset("listed", data=RECORD, chunks=(50, 2))


def write_vectors():
    """A vector of each channel, with times of which some are missing, numbers that are to be scaled, and a channel that ends early."""
    import scipy.io

    kept = np.r_[0:100, 150:ROWS]
    times_s = 1772366400.25 + np.arange(ROWS) / RATE_HZ
    with h5py.File(FOLDER / "h5py_gap.h5", "w") as file:
        file["time"] = times_s[kept]
        for name, column in zip(NAMES, RECORD.T):
            file[name] = column[kept]
        file["short"] = RECORD[kept[:-1], 0]
        file["weights"] = np.ones(10)
    with h5py.File(FOLDER / "h5py_scaled.h5", "w") as file:
        file.attrs["start_time"] = "2026-03-01T12:00:00.25Z"
        dataset = file.create_dataset("data", data=COUNTS.astype("i4") + 5)
        dataset.attrs.update({"scale_factor": 2.0**-23, "add_offset": -5 * 2.0**-23, "dt": 1 / RATE_HZ})
    vectors = {"fs": RATE_HZ, "t": np.arange(ROWS) / RATE_HZ, "top_x": RECORD[:, 0], "top_y": RECORD[:, 1], "note": "a mast"}
    scipy.io.savemat(FOLDER / "scipy_vectors.mat", vectors, do_compression=True, oned_as="column")
    matlab(FOLDER / "matlab73_vectors.mat", {name: np.asarray(value) for name, value in vectors.items() if name != "note"})


def write_nastran():
    """The chain by grid points 11 to 16 along x, single fields and double ones, as pyNastran writes them."""
    from pyNastran.bdf.bdf import BDF

    model = BDF(debug=False)
    grids = [11 + at for at in range(6)]
    whole = stiffness().tocoo()
    lower = [entry for entry in zip(whole.row, whole.col, whole.data) if entry[0] >= entry[1]]
    for name, entries, kind in [("KAAX", lower, 2), ("MAAX", [(at, at, 2e3) for at in range(6)], 1)]:
        columns = [(grids[column], 1) for _, column, _ in entries]
        rows = [(grids[row], 1) for row, _, _ in entries]
        model.add_dmig(name, 6, kind, kind, 0, 6, columns, rows, [value for *_, value in entries])
    for size in (8, 16):
        model.write_bdf(str(FOLDER / f"pynastran_{size}.bdf"), size=size, is_double=size == 16, enddata=False)
    places = BDF(debug=False)
    for grid in grids:
        places.add_grid(grid, [0.0, 0.0, 3000.0 * (grid - 10)])
    for size in (8, 16):
        places.write_bdf(str(FOLDER / f"pynastran_grids_{size}.bdf"), size=size, is_double=size == 16, enddata=False)


def write_complex():
    """The chain with structural damping, which no model of K and M has, and a gyroscopic one, which is not symmetric."""
    import scipy.io
    import scipy.sparse as sparse

    damped = stiffness() * (1.0 + 0.02j)
    gyroscopic = stiffness() + sparse.diags_array([[5e5] * 5, [-5e5] * 5], offsets=[-1, 1]).tocsc()
    np.save(FOLDER / "numpy_complex.npy", damped.toarray())
    np.save(FOLDER / "numpy_gyroscopic.npy", gyroscopic.toarray())
    sparse.save_npz(FOLDER / "scipy_complex.npz", sparse.csr_matrix(damped))
    sparse.save_npz(FOLDER / "scipy_gyroscopic.npz", sparse.csr_matrix(gyroscopic))
    scipy.io.mmwrite(FOLDER / "scipy_complex.mtx", damped)
    scipy.io.mmwrite(FOLDER / "scipy_gyroscopic.mtx", gyroscopic)
    scipy.io.savemat(FOLDER / "scipy_matrices.mat", {"full": damped.toarray(), "few": damped, "gyroscopic": gyroscopic})
    import hdf5storage

    matrices = {"full": damped.toarray(), "gyroscopic": gyroscopic.toarray()}
    hdf5storage.savemat(str(FOLDER / "hdf5storage_matrices.mat"), matrices, format="7.3", oned_as="column")
    # MATLAB keeps complex numbers in compounds of `real` and `imag`, as hdf5storage does.
    parts = np.zeros(damped.nnz, [("real", "f8"), ("imag", "f8")])
    parts["real"], parts["imag"] = damped.data.real, damped.data.imag
    with h5py.File(FOLDER / "hdf5storage_matrices.mat", "r+") as file:
        group = file.create_group("few")
        group.attrs["MATLAB_class"], group.attrs["MATLAB_sparse"] = np.bytes_("double"), np.uint64(6)
        group["data"], group["ir"], group["jc"] = parts, damped.indices.astype("u8"), damped.indptr.astype("u8")


def write_geometry():
    """Where the grid points stand: datasets 164 (mm) and 2411; and lines between them, dataset 82."""
    import pyuff

    path = FOLDER / "pyuff_nodes.unv"
    path.unlink(missing_ok=True)
    file = pyuff.UFF(str(path))
    file.write_sets(pyuff.prepare_164(1, "SI: mm", 2, 1000.0, 1.0, 1.0, 273.15), "add")
    numbers = np.arange(11.0, 17.0)
    ones, zeros = np.ones(6), np.zeros(6)
    file.write_sets(
        {"type": 2411, "node_nums": numbers, "def_cs": ones, "disp_cs": ones, "color": ones, "x": zeros, "y": zeros, "z": 3000.0 * (numbers - 10)},
        "add",
    )
    path = FOLDER / "pyuff_lines.unv"
    path.unlink(missing_ok=True)
    file = pyuff.UFF(str(path))
    for number, nodes in enumerate([[11, 12, 13, 14, 15, 16], [11, 13, 0, 14, 16]], 1):
        line = {"type": 82, "trace_num": number, "n_nodes": len(nodes), "color": 1, "id": f"line {number}", "nodes": np.array(nodes)}
        file.write_sets(line, "add")


def write_wav():
    """Whole numbers are shares of full scale: 32 and 24 bits hold the recording exactly, 16 bits its upper part."""
    import soundfile

    for name, subtype, data in [
        ("pcm24", "PCM_24", COUNTS.astype("i4") << 8),
        ("pcm32", "PCM_32", COUNTS.astype("i4") << 8),
        ("pcm16", "PCM_16", (COUNTS >> 8).astype("i2")),
        ("float", "FLOAT", RECORD.astype("f4")),
        ("double", "DOUBLE", RECORD),
    ]:
        soundfile.write(FOLDER / f"soundfile_{name}.wav", data, int(RATE_HZ), subtype=subtype)
    soundfile.write(FOLDER / "soundfile_rf64.wav", RECORD, int(RATE_HZ), subtype="DOUBLE", format="RF64")


def write_seismic():
    """By ObsPy: the counts themselves in Steim's forms and as whole numbers, the recording as floats; a gap in the second file."""
    import obspy

    def trace(values, channel, start=0):
        header = {"network": "XX", "station": "MAST", "location": "00", "channel": channel, "sampling_rate": RATE_HZ}
        header["starttime"] = obspy.UTCDateTime(2026, 3, 1, 12) + start / RATE_HZ
        return obspy.Trace(np.ascontiguousarray(values), header)

    whole = COUNTS.astype("i4")
    for name, encoding, values in [
        ("steim1", "STEIM1", whole),
        ("steim2", "STEIM2", whole),
        ("int32", "INT32", whole),
        ("float", "FLOAT32", RECORD.astype("f4")),
        ("double", "FLOAT64", RECORD),
    ]:
        stream = obspy.Stream([trace(values[:, 0], "HNX"), trace(values[:, 1], "HNY")])
        stream.write(str(FOLDER / f"obspy_{name}.mseed"), format="MSEED", encoding=encoding, reclen=512)
    stream = obspy.Stream([trace(RECORD[:, 0], "HNX"), trace(RECORD[:, 1], "HNY")])
    stream.write(str(FOLDER / "obspy_little.mseed"), format="MSEED", encoding="FLOAT64", reclen=512, byteorder="<")
    # Version 3 by the FDSN's own library.
    import pymseed

    for name, encoding, values, kind in [
        ("steim2", pymseed.DataEncoding.STEIM2, whole, "i"),
        ("double", pymseed.DataEncoding.FLOAT64, RECORD, "d"),
    ]:
        with pymseed.MS3TraceList() as traces:
            for column, last in enumerate("XY"):
                identifier, start = f"FDSN:XX_MAST_00_H_N_{last}", "2026-03-01T12:00:00Z"
                traces.add_data(identifier, values[:, column].tolist(), kind, RATE_HZ, starttime_str=start)
            traces.to_file(
                FOLDER / f"pymseed_{name}.mseed", overwrite=True, max_record_length=512, encoding=encoding, format_version=3
            )
    parts = [trace(RECORD[:, 0], "HNX"), trace(RECORD[:120, 1], "HNY"), trace(RECORD[150:, 1], "HNY", 150)]
    obspy.Stream(parts[:2]).write(str(FOLDER / "obspy_part1.mseed"), format="MSEED", encoding="FLOAT64", reclen=512)
    obspy.Stream(parts[2:]).write(str(FOLDER / "obspy_part2.mseed"), format="MSEED", encoding="FLOAT64", reclen=512)
    for channel, column, order in [("HNX", 0, "<"), ("HNY", 1, ">")]:
        single = trace(RECORD[:, column].astype("f4"), channel)
        single.write(str(FOLDER / f"obspy_{channel}.sac"), format="SAC", byteorder=order)


def write_tdms():
    """By npTDMS one channel after the other, in three segments; it writes no others, so channels in turn and raw numbers of DAQmx are put
    together here after NI's description, and npTDMS reads them back."""
    from nptdms import ChannelObject, GroupObject, RootObject, TdmsFile, TdmsWriter

    properties = {"wf_increment": 1 / RATE_HZ, "unit_string": "m/s^2", "wf_start_time": np.datetime64("2026-03-01T12:00:00.25")}
    with TdmsWriter(FOLDER / "nptdms.tdms") as writer:
        root, group = RootObject({"title": "a mast"}), GroupObject("run 1", {"operator": "nobody"})
        for rows in (RECORD[:100], RECORD[100:101], RECORD[101:]):
            channels = [
                ChannelObject("run 1", "top-x", rows[:, 0], properties),
                ChannelObject("run 1", "top-y", rows[:, 1].astype("f4"), properties),
                ChannelObject("run 1", "note", ["a", "few", "words"]),
            ]
            writer.write_segment([root, group, *channels])

    def text(word):
        return np.uint32(len(word)).tobytes() + word.encode()

    def property_of(name, value):
        kinds = {str: (0x20, text), int: (7, lambda number: np.uint32(number).tobytes()), float: (10, lambda number: np.float64(number).tobytes())}
        kind, raw = kinds[type(value)]
        return text(name) + np.uint32(kind).tobytes() + raw(value)

    def segment(contents, objects, data):
        metadata = np.uint32(len(objects)).tobytes() + b"".join(objects)
        lead = b"TDSm" + np.array([contents, 4713], "<u4").tobytes()
        return lead + np.array([len(metadata) + len(data), len(metadata)], "<u8").tobytes() + metadata + data

    def channel(name, index, values):
        listed = [property_of(*item) for item in values.items()]
        return text(f"/'run 1'/'{name}'") + index + np.uint32(len(listed)).tobytes() + b"".join(listed)

    metadata, new_list, raw, interleaved, daqmx = 1 << 1, 1 << 2, 1 << 3, 1 << 5, 1 << 7
    index = np.array([20, 10, 1], "<u4").tobytes() + np.uint64(ROWS).tobytes()
    objects = [channel(name, index, {"wf_increment": 1 / RATE_HZ}) for name in NAMES]
    whole = segment(metadata | new_list | raw | interleaved, objects, RECORD.astype("<f8").tobytes())
    (FOLDER / "interleaved.tdms").write_bytes(whole)
    # A row of one card: 32 bits of each channel, and 2 bytes that are no channel's; counts to the recording by a line.
    objects = []
    for place, name in enumerate(NAMES):
        scaler = np.array([5, 0, 4 * place, 0, 0], "<u4").tobytes()
        index = np.array([0x1269, 0xFFFFFFFF, 1], "<u4").tobytes() + np.uint64(100).tobytes()
        index += np.uint32(1).tobytes() + scaler + np.array([1, 10], "<u4").tobytes()
        scale = {
            "NI_Number_Of_Scales": 2,
            "NI_Scale[1]_Scale_Type": "Linear",
            "NI_Scale[1]_Linear_Slope": 2.0**-23,
            "NI_Scale[1]_Linear_Y_Intercept": 0.5 * place,
            "NI_Scale[1]_Linear_Input_Source": 0,
            "wf_increment": 1 / RATE_HZ,
        }
        objects.append(channel(name, index, scale))
    rows = np.zeros(ROWS, dtype=[("x", "<i4"), ("y", "<i4"), ("rest", "<u2")])
    rows["x"], rows["y"], rows["rest"] = COUNTS[:, 0], COUNTS[:, 1] - (1 << 22), 7
    (FOLDER / "daqmx.tdms").write_bytes(segment(metadata | new_list | raw | daqmx, objects, rows.tobytes()))
    for name in ("nptdms", "interleaved", "daqmx"):
        group = TdmsFile.read(FOLDER / f"{name}.tdms")["run 1"]
        for place, channel in enumerate(NAMES):
            assert np.array_equal(group[channel][:], RECORD[:, place]), name


def write_udbf():
    """Of a Gantner logger itself: the first rows of a recording that comes with Gantner's package ginsapy, with its numbers as numpy reads them. And the
    recording after the layout of that file, in either order of bytes, with a gap, and as two loggers have it."""
    import subprocess
    import tempfile
    import zipfile

    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--dest", folder, "ginsapy==0.4.0"], check=True)
        wheel = zipfile.ZipFile(next(pathlib.Path(folder).glob("ginsapy*.whl")))
        whole = wheel.read("ginsapy/examples/GinsDataloggerReadDatFiles.dat")
    data, row = 0x150, np.dtype([("time", "<u8"), ("values", "<f4", 9)])
    (FOLDER / "gantner.dat").write_bytes(whole[: data + 500 * row.itemsize])
    np.save(FOLDER / "gantner.npy", np.frombuffer(whole, row, 500, data)["values"])

    def text(words):
        return len(words.encode("latin-1") + b"\0"), words.encode("latin-1") + b"\0"

    def file(name, order, columns, kinds, numbers, ahead_s=0.0):
        def word(number):
            return np.array(number, order + "u2").tobytes()

        def words(what):
            length, raw = text(what)
            return word(length) + raw

        reals = [np.array(number, order + "f8").tobytes() for number in (1.0, 1e-9, 36526.0, RATE_HZ)]
        head = bytes([order == ">"]) + word(107) + words("UniversalDataBinFile - GANTNER instruments") + b"\0" + word(0)
        head += reals[0] + word(14) + reals[1] + reals[2] + reals[3] + word(len(columns))
        for column, (kind, _) in zip(columns, kinds):
            head += words(column) + word(0) + word(kind) + word(8) + word(3) + words("m/s\u00b2") + word(0)
        head += b"*" * 8
        head += b"*" * (-len(head) % 16)
        rows = np.zeros(len(numbers), [("time", order + "u8")] + [(column, order + kind) for column, (_, kind) in zip(columns, kinds)])
        # 2026-03-01 12:00:00.25 in nanoseconds since 2000.
        rows["time"] = [825_681_600_250_000_000 + round((number / RATE_HZ + ahead_s) * 1e9) for number in numbers]
        for column in columns:
            rows[column] = RECORD[numbers, NAMES.index(column)]
        (FOLDER / name).write_bytes(head + rows.tobytes())

    every, kinds = np.arange(ROWS), [(12, "f8"), (8, "f4")]
    file("udbf_little.dat", "<", NAMES, kinds, every)
    file("udbf_big.dat", ">", NAMES, kinds, every)
    file("udbf_gap.dat", "<", NAMES, kinds, np.delete(every, slice(120, 150)))
    file("udbf_one.dat", "<", NAMES[:1], kinds[:1], every)
    # The second logger began ten samples and a fifth later, and stopped before.
    file("udbf_two.dat", "<", NAMES[1:], kinds[1:], every[10:250], 0.2 / RATE_HZ)


np.save(FOLDER / "same.npy", RECORD)
write_hdf5()
write_vectors()
write_complex()
write_nastran()
write_geometry()
write_wav()
write_seismic()
write_tdms()
write_udbf()
