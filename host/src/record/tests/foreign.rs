//! One recording as other programs write it, in every format: the same numbers to the last bit. `tests/foreign/files.py` made the files.

use super::hdf5::{foreign, same};
use super::*;

/// Rows of a file with these channels.
fn rows(channels: &[&str], files: &[&str]) -> Vec<Vec<f64>> {
    read(&setup(channels, files), foreign()).unwrap_or_else(|error| panic!("{files:?}: {error}")).0
}

/// The whole numbers that the recording is made of, shares of 2^23.
fn counts() -> Vec<Vec<f64>> {
    same().into_iter().map(|row| row.into_iter().map(|value| value * f64::from(1 << 23)).collect()).collect()
}

#[test]
fn datasets_of_rows_and_of_channels_are_the_same_recording() {
    assert_eq!(rows(&["1", "2"], &["h5py_matrix.h5"]), same());
    assert_eq!(rows(&["top-x", "run 1/top-y"], &["h5py_channels.h5"]), same());
    assert_eq!(rows(&["1", "2"], &["h5py_channels.h5"]), same());
    let mut named = setup(&["1", "2"], &["h5py_latest.h5"]);
    let error = read(&named, foreign()).unwrap_err().to_string();
    for part in ["h5py_latest.h5: several matrices", "`variable`", "`flat` (3 × 2)", "`whole` (300 × 2)"] {
        assert!(error.contains(part), "no {part:?} in: {error}");
    }
    named.variable = Some("whole".to_owned());
    assert_eq!(read(&named, foreign()).unwrap().0, same());
    named.variable = Some("hole".to_owned());
    assert!(read(&named, foreign()).unwrap_err().to_string().contains("no numbers at `hole`"));
    for (file, channels) in [("h5py_matrix.h5", ["1"]), ("h5py_channels.h5", ["top-x"])] {
        let other = Setup { sampling_rate_hz: 51.0, ..setup(&channels, &[file]) };
        let error = read(&other, foreign()).unwrap_err().to_string();
        assert!(error.contains(file) && error.contains("50.0000 Hz by the file"), "{error}");
    }
}

#[test]
fn wav_files_give_shares_of_full_scale_and_floats_as_they_are() {
    for file in ["pcm24", "pcm32", "float", "double", "rf64"] {
        assert_eq!(rows(&["1", "2"], &[&format!("soundfile_{file}.wav")]), same(), "{file}");
        assert_eq!(
            rows(&["2"], &[&format!("soundfile_{file}.wav")]),
            same().iter().map(|row| [row[1]]).collect::<Vec<_>>()
        );
    }
    for (coarse, fine) in rows(&["1", "2"], &["soundfile_pcm16.wav"]).iter().flatten().zip(same().iter().flatten()) {
        // The upper two of three bytes.
        assert_eq!(*coarse, (fine * 32768.0).floor() / 32768.0);
    }
    let other = Setup { sampling_rate_hz: 48000.0, ..setup(&["1"], &["soundfile_pcm24.wav"]) };
    assert!(read(&other, foreign()).unwrap_err().to_string().contains("50.0000 Hz by the file"));
}

#[test]
fn miniseed_of_every_encoding_is_the_same_recording() {
    for (file, expected) in [
        ("obspy_steim1", counts()),
        ("obspy_steim2", counts()),
        ("obspy_int32", counts()),
        ("obspy_float", same()),
        ("obspy_double", same()),
        ("obspy_little", same()),
        ("pymseed_steim2", counts()),
        ("pymseed_double", same()),
    ] {
        let file = format!("{file}.mseed");
        assert_eq!(rows(&["XX.MAST.00.HNX", "HNY"], &[&file]), expected, "{file}");
    }
}

#[test]
fn a_gap_of_one_channel_is_missing_samples_and_files_share_a_line_of_time() {
    let setup = setup(&["HNX", "HNY"], &["obspy_part*.mseed"]);
    let (rows, report) = read(&setup, foreign()).unwrap();
    assert_eq!(rows.len(), 300);
    for (row, (found, expected)) in rows.iter().zip(same()).enumerate() {
        assert_eq!(found[0], expected[0]);
        assert!(if (120..150).contains(&row) { found[1].is_nan() } else { found[1] == expected[1] }, "row {row}");
    }
    assert_eq!([report.channels[0].missing, report.channels[1].missing], [0, 30]);
    let twice = Setup { files: vec!["obspy_double.mseed".to_owned(), "obspy_part1.mseed".to_owned()], ..setup };
    let error = read(&twice, foreign()).unwrap_err().to_string();
    assert!(error.contains("has samples twice"), "{error}");
}

#[test]
fn sac_files_of_two_channels_stand_beside_each_other() {
    assert_eq!(rows(&["HNX", "XX.MAST.00.HNY"], &["obspy_HNX.sac", "obspy_HNY.sac"]), same());
    assert_eq!(rows(&["HNY", "HNX"], &["*.sac"])[7], [same()[7][1], same()[7][0]]);
    // Beside miniSEED of the same time.
    assert_eq!(rows(&["HNX"], &["obspy_HNX.sac"]).len(), 300);
    let other = Setup { sampling_rate_hz: 50.1, ..setup(&["HNX"], &["obspy_HNX.sac"]) };
    assert!(
        read(&other, foreign())
            .unwrap_err()
            .to_string()
            .contains("obspy_HNX.sac, channel `HNX`: sampled at 50.0000 Hz")
    );
}

#[test]
fn tdms_in_segments_in_turn_and_raw_is_the_same_recording() {
    for file in ["nptdms.tdms", "interleaved.tdms", "daqmx.tdms"] {
        assert_eq!(rows(&["run 1/top-x", "top-y"], &[file]), same(), "{file}");
        assert_eq!(rows(&["top-y"], &[file]), same().iter().map(|row| [row[1]]).collect::<Vec<_>>(), "{file}");
        let other = Setup { sampling_rate_hz: 25.0, ..setup(&["top-x"], &[file]) };
        let error = read(&other, foreign()).unwrap_err().to_string();
        assert!(error.contains(&format!("{file}, channel `top-x`: sampled at 50.0000 Hz")), "{error}");
    }
    let whole = std::fs::read(foreign().join("interleaved.tdms")).unwrap();
    let one = setup(&["top-x"], &["a.tdms"]);
    let mut big_endian = whole.clone();
    big_endian[4] |= 1 << 6;
    expect_error(&one, &[("a.tdms", &big_endian)], &["a.tdms", "big-endian"]);
    expect_error(&one, &[("a.tdms", &whole[..whole.len() - 9])], &["a.tdms", "cut short"]);
    let words = setup(&["note"], &["nptdms.tdms"]);
    assert!(read(&words, foreign()).unwrap_err().to_string().contains("channel `run 1/note`: it holds text"));
    let scaled = std::fs::read(foreign().join("daqmx.tdms")).unwrap();
    let place = scaled.windows(6).position(|word| word == b"Linear").unwrap();
    let mut thermistor = scaled;
    thermistor[place..place + 6].copy_from_slice(b"Wobbly");
    expect_error(&one, &[("a.tdms", &thermistor)], &["a.tdms: channel `run 1/top-x`", "`Wobbly`", "export it scaled"]);
}

#[test]
fn udbf_of_a_gantner_logger_and_after_its_layout_is_read() {
    let names = [
        "GeneratorOutput",
        "GeneratedSinus",
        "Test_Running",
        "TotalTestNumber",
        "TestNumber",
        "TC1",
        "TC2",
        "TC3",
        "TC4",
    ];
    let of_logger = Setup { sampling_rate_hz: 1000.0, ..setup(&names, &["gantner.dat"]) };
    let numbers = setup(&["1", "2", "3", "4", "5", "6", "7", "8", "9"], &["gantner.npy"]);
    assert_eq!(read(&of_logger, foreign()).unwrap().0, read(&numbers, foreign()).unwrap().0);
    // By the device's clock, in nanoseconds since 2000.
    let start_ns = Recording::open(&of_logger, foreign()).unwrap().start_ns().unwrap();
    assert_eq!(start_ns, Some(946_684_800_000_000_000 + 570_130_526_677_000_135));
    for file in ["udbf_little.dat", "udbf_big.dat"] {
        assert_eq!(rows(&["top-x", "top-y"], &[file]), same(), "{file}");
        let other = Setup { sampling_rate_hz: 25.0, ..setup(&["top-x"], &[file]) };
        let error = read(&other, foreign()).unwrap_err().to_string();
        assert!(error.contains(&format!("{file}, channel `top-x`: sampled at 50.0000 Hz")), "{error}");
    }
    for (row, (found, expected)) in rows(&["top-x", "top-y"], &["udbf_gap.dat"]).iter().zip(same()).enumerate() {
        assert!(if (120..150).contains(&row) { found[1].is_nan() } else { *found == expected }, "row {row}");
    }
    // Two loggers: the second began ten samples and a fifth later.
    let both = rows(&["top-y", "top-x"], &["udbf_one.dat", "udbf_two.dat"]);
    assert_eq!(both.len(), 300);
    for (row, (found, expected)) in both.iter().zip(same()).enumerate() {
        assert_eq!(found[1], expected[0]);
        assert!(if (10..250).contains(&row) { found[0] == expected[1] } else { found[0].is_nan() }, "row {row}");
    }
    let whole = std::fs::read(foreign().join("udbf_little.dat")).unwrap();
    let one = setup(&["top-x"], &["a.dat"]);
    let changed = |place: usize, byte: u8| {
        let mut changed = whole.clone();
        changed[place] = byte;
        changed
    };
    expect_error(&one, &[("a.dat", &changed(1, 106))], &["a.dat: UDBF of version 1.06", "export it"]);
    expect_error(&one, &[("a.dat", &changed(0x30, 1))], &["a.dat", "checksum"]);
    // The time of the last row, a century before.
    let last = whole.len() - 20;
    expect_error(&one, &[("a.dat", &changed(last + 7, 0))], &["a.dat: the time of row 300 is not after that of row 1"]);
    expect_error(&one, &[("a.dat", &whole[..160])], &["a.dat"]);
}

/// Files cut at every length, and with bytes changed: rows, or an error that names the file.
#[test]
fn damaged_files_end_in_rows_or_in_an_error() {
    let folder = tempfile::tempdir().unwrap();
    for (name, channels) in [
        ("h5py_matrix.h5", ["1", "2"]),
        ("h5py_channels.h5", ["top-x", "top-y"]),
        ("soundfile_pcm24.wav", ["1", "2"]),
        ("soundfile_rf64.wav", ["1", "2"]),
        ("obspy_steim1.mseed", ["HNX", "HNY"]),
        ("obspy_steim2.mseed", ["HNX", "HNY"]),
        ("obspy_float.mseed", ["HNX", "HNY"]),
        ("pymseed_steim2.mseed", ["HNX", "HNY"]),
        ("obspy_HNX.sac", ["HNX", "HNX"]),
        ("nptdms.tdms", ["top-x", "top-y"]),
        ("interleaved.tdms", ["top-x", "top-y"]),
        ("daqmx.tdms", ["top-x", "top-y"]),
        ("udbf_big.dat", ["top-x", "top-y"]),
        ("udbf_gap.dat", ["top-x", "top-y"]),
    ] {
        let whole = std::fs::read(foreign().join(name)).unwrap();
        let setup = setup(&channels, &[name]);
        let check = |bytes: &[u8]| {
            std::fs::write(folder.path().join(name), bytes).unwrap();
            // Rows may be many where a time is damaged; those counted are those read, as `read` checks.
            if let Err(error) = Recording::open(&setup, folder.path()).and_then(|mut recording| {
                let (mut block, mut blocks) = (Block::new(), 0);
                while blocks < 20 && recording.next_block(&mut block)? {
                    blocks += 1;
                }
                recording.total_rows()
            }) {
                let error = error.to_string();
                assert!(error.contains(name) && error.len() < 1024, "{error}");
            }
        };
        (0..whole.len()).step_by(37).for_each(|length| check(&whole[..length]));
        for place in (0..whole.len().min(700)).step_by(3) {
            let mut changed = whole.clone();
            for mask in [0xff, 0x01] {
                changed[place] = whole[place] ^ mask;
                check(&changed);
            }
        }
    }
}

#[test]
fn a_vector_of_each_channel_is_a_recording_of_matlab() {
    for file in ["scipy_vectors.mat", "matlab73_vectors.mat"] {
        assert_eq!(rows(&["top_x", "top_y"], &[file]), same(), "{file}");
        let turned: Vec<Vec<f64>> = same().iter().map(|row| vec![row[1]]).collect();
        assert_eq!(rows(&["top_y"], &[file]), turned, "{file}");
        let mut one = setup(&["1"], &[file]);
        one.variable = Some("top_y".to_owned());
        assert_eq!(read(&one, foreign()).unwrap().0, turned, "{file}");
        for variable in [None, Some("top_x".to_owned())] {
            let channel = if variable.is_some() { "1" } else { "top_x" };
            let other = Setup { sampling_rate_hz: 51.0, variable, ..setup(&[channel], &[file]) };
            let error = read(&other, foreign()).unwrap_err().to_string();
            assert!(error.contains(file) && error.contains("channel `fs`: sampled at 50.0000 Hz"), "{error}");
        }
        let error = read(&setup(&["top_z"], &[file]), foreign()).unwrap_err().to_string();
        assert!(error.contains("no channel `top_z`") && error.contains("`top_x`, `top_y`"), "{error}");
    }
}

#[test]
fn rows_that_are_missing_by_times_in_hdf5_are_samples_that_are_missing() {
    let wanted = setup(&["top-y", "short", "top-x"], &["h5py_gap.h5"]);
    let (rows, report) = read(&wanted, foreign()).unwrap();
    assert_eq!((rows.len(), report.rows), (300, 300));
    for (at, (row, expected)) in rows.iter().zip(same()).enumerate() {
        if (100..150).contains(&at) {
            assert!(row.iter().all(|value| value.is_nan()), "row {at}");
            continue;
        }
        assert_eq!([row[0], row[2]], [expected[1], expected[0]], "row {at}");
        // One channel ends a sample before the others.
        assert!(if at == 299 { row[1].is_nan() } else { row[1] == expected[0] }, "row {at}");
    }
    let told: Vec<String> = report.warnings.iter().map(ToString::to_string).collect();
    assert!(told[0].contains("gap of 50 samples (1.000 s) at") && told[0].contains("h5py_gap.h5, row 101"), "{told:?}");
    let recording = Recording::open(&wanted, foreign()).unwrap();
    assert_eq!(recording.start_ns().unwrap(), Some(1_772_366_400_250_000_000));
    // As many rows are counted as one that is shorter has; `read` compares the two.
    assert_eq!(read(&setup(&["short"], &["h5py_gap.h5"]), foreign()).unwrap().0.len(), 299);
    // What is much shorter is no channel.
    let error = read(&setup(&["weights"], &["h5py_gap.h5"]), foreign()).unwrap_err().to_string();
    assert!(error.contains("no channel `weights`"), "{error}");
}

#[test]
fn numbers_of_hdf5_are_scaled_as_its_attributes_say() {
    let (rows, _) = read(&setup(&["2", "1"], &["h5py_scaled.h5"]), foreign()).unwrap();
    for (row, expected) in rows.iter().zip(same()) {
        assert_eq!(row, &[expected[1], expected[0]]);
    }
    assert_eq!(rows.len(), 300);
    let recording = Recording::open(&setup(&["1"], &["h5py_scaled.h5"]), foreign()).unwrap();
    assert_eq!(recording.start_ns().unwrap(), Some(1_772_366_400_250_000_000));
}
