//! What a node cannot measure it refuses in words, and goes on with what it had.

use std::collections::BTreeSet;
use std::fmt::Write;
use std::path::Path;

use belfry_firmware::Identity;
use belfry_host::fleet::InProcess;
use belfry_host::keys::Keys;
use belfry_host::link::replay::{ReplayError, replay};
use belfry_host::link::{SessionError, Transport};
use belfry_host::window::ChannelData;
use belfry_shared::message::{Band, Configuration, RefusalReason, Summary};
use belfry_shared::time::HostTime;

use super::emulator::{Board, assert_same_bits, belfry};

const CHANNELS: usize = 4;

fn possible() -> Configuration {
    Configuration {
        channels: CHANNELS as u8,
        sampling_rate_uhz: 50_000_000,
        decimation: 2,
        segment: 256,
        summary: Summary::Lines { bits: 10 },
        bands: [Band { first_line: 1, lines: 100 }].into_iter().collect(),
    }
}

/// Configurations that the board cannot run, and what it is to say of each.
fn impossible() -> Vec<(Configuration, &'static str)> {
    let changed = |change: &dyn Fn(&mut Configuration), sentence| {
        let mut configuration = possible();
        change(&mut configuration);
        (configuration, sentence)
    };
    let with_bands = |bands: &[(u16, u16)], sentence| {
        let mut configuration = possible();
        configuration.bands = bands.iter().map(|&(first_line, lines)| Band { first_line, lines }).collect();
        (configuration, sentence)
    };
    let channels = "the node has 4 channels";
    let rate = "the sampling rate is not possible: the node samples up to 4000 Hz";
    let decimation = "the decimation has no split into at most three stages of 2 to 10";
    let segment = "the segment is no power of two from 256 to 4096";
    let bands = "a band is empty, out of order or beyond the last line";
    let summary = "the summary's bits or segments are out of range";
    vec![
        changed(&|c| c.channels = 5, channels),
        changed(&|c| c.channels = 0, channels),
        changed(&|c| c.sampling_rate_uhz = 4_000_000_001, rate),
        changed(&|c| c.sampling_rate_uhz = u64::MAX, rate),
        changed(&|c| c.sampling_rate_uhz = 0, rate),
        changed(&|c| c.decimation = 13, decimation),
        changed(&|c| c.decimation = 0, decimation),
        changed(&|c| c.decimation = u32::MAX, decimation),
        changed(&|c| c.segment = 300, segment),
        changed(&|c| c.segment = 8192, segment),
        changed(&|c| c.segment = 0, segment),
        with_bands(&[(50, 10), (20, 10)], bands),
        with_bands(&[(50, 10), (59, 10)], bands),
        with_bands(&[(50, 0)], bands),
        with_bands(&[(120, 9)], bands),
        with_bands(&[(u16::MAX, u16::MAX)], bands),
        with_bands(&[], bands),
        changed(&|c| c.summary = Summary::Lines { bits: 2 }, summary),
        changed(&|c| c.summary = Summary::Lines { bits: u8::MAX }, summary),
        changed(&|c| c.summary = Summary::Psd { segments: 0 }, summary),
        (too_large(), "a window needs 36316 bytes, the node has 25088"),
    ]
}

/// All lines of the longest segment in the finest code: more than the memory for windows.
fn too_large() -> Configuration {
    Configuration {
        segment: 4096,
        summary: Summary::Lines { bits: 16 },
        bands: [Band { first_line: 1, lines: 2047 }].into_iter().collect(),
        ..possible()
    }
}

/// A number for each reason: one that is added stands here, and has to come above.
fn kind(reason: &RefusalReason) -> usize {
    match reason {
        RefusalReason::Channels { .. } => 0,
        RefusalReason::SamplingRate { .. } => 1,
        RefusalReason::Decimation => 2,
        RefusalReason::Segment => 3,
        RefusalReason::Bands => 4,
        RefusalReason::Summary => 5,
        RefusalReason::Memory { .. } => 6,
        RefusalReason::Clock => panic!("the emulated board's clock runs"),
        RefusalReason::Unknown => panic!("a node has no reasons that it does not know"),
    }
}
const KINDS: usize = 7;

/// Some windows' worth of numbers that are not alike.
fn rows() -> impl Iterator<Item = Vec<f32>> {
    (0..1500_u32).map(|row| {
        (0..CHANNELS as u32).map(|channel| ((row * 7919 + channel * 104_729) % 1009) as f32 * 1e-3).collect()
    })
}

/// What comes of the rows.
fn windows(transport: &mut dyn Transport) -> Vec<Vec<ChannelData>> {
    let replayed = replay(transport, &Keys::default(), &possible(), HostTime(0), rows(), &mut |_| {}).unwrap();
    replayed.windows.into_iter().map(|window| window.channels).collect()
}

#[test]
#[cfg_attr(not(emulator), ignore = "needs qemu-system-arm and a compiler for the board")]
fn every_impossible_configuration_is_refused_in_words_and_the_node_goes_on() {
    let board = Board::start();
    let before = board.hello();
    let identity = Identity {
        node: before.node,
        boot: before.boot,
        channels: before.channels,
        full_scale_m_s2: f32::INFINITY,
        highest_rate_mhz: u32::MAX,
    };
    let expected = windows(&mut InProcess::new(identity));
    assert!(expected.len() > 1 && expected.iter().flatten().all(|data| matches!(data, ChannelData::Lines(_))));
    assert_eq!(windows(&mut board.port()), expected);
    let mut seen = BTreeSet::new();
    for (configuration, sentence) in impossible() {
        let refused = replay(&mut board.port(), &Keys::default(), &configuration, HostTime(0), rows(), &mut |_| {});
        let Err(ReplayError::Session(SessionError::Refused { node, reason })) = refused else {
            panic!("{configuration:?} is not refused: {refused:?}");
        };
        seen.insert(kind(&reason));
        let error = SessionError::Refused { node, reason };
        assert_eq!(error.to_string(), format!("node 1 cannot measure what the study asks: {sentence}"));
        let after = board.hello();
        assert_eq!((after.boot, after.configuration_hash), (before.boot, Some(possible().hash())), "{sentence}");
    }
    assert_eq!(seen.len(), KINDS, "every reason has come");
    assert_eq!(windows(&mut board.port()), expected);
}

/// A study of two channels at a sampling rate, with a minute's recording.
fn study(folder: &Path, sampling_rate_hz: u32) -> String {
    let folder = folder.join(format!("{sampling_rate_hz}"));
    let path = folder.to_str().unwrap().to_owned();
    assert!(belfry(&["init", &path, "--template", "blank"]).0);
    let file = folder.join("study.toml");
    let text = std::fs::read_to_string(&file).unwrap();
    let ours = text.replace("sampling_rate_hz = 50.0", &format!("sampling_rate_hz = {sampling_rate_hz}.0"));
    assert!(ours.contains(&format!("sampling_rate_hz = {sampling_rate_hz}.0")));
    std::fs::write(&file, ours).unwrap();
    let mut recording = "1,2\n".to_owned();
    for row in 0..60 * sampling_rate_hz {
        let value = |channel: u32| f64::from((row * 7919 + channel * 104_729) % 1009) * 1e-3;
        writeln!(recording, "{:.3},{:.3}", value(0), value(1)).unwrap();
    }
    std::fs::write(folder.join("recording_1.csv"), recording).unwrap();
    path
}

#[test]
#[cfg_attr(not(emulator), ignore = "needs qemu-system-arm and a compiler for the board")]
fn a_study_that_a_board_cannot_sample_is_refused_and_the_next_one_is_measured() {
    let board = Board::start();
    let folder = tempfile::tempdir().unwrap();
    let (done, _, said) = belfry(&["replay", &study(folder.path(), 5000), "--port", &board.line()]);
    assert!(!done);
    let sentence =
        "node 1 cannot measure what the study asks: the sampling rate is not possible: the node samples up to 4000 Hz";
    assert!(said.contains(sentence), "{said}");
    let (done, report, said) = belfry(&["replay", &study(folder.path(), 50), "--port", &board.line()]);
    assert!(done, "{said}");
    assert_same_bits(&report, 1);
}

#[test]
#[cfg_attr(not(emulator), ignore = "needs qemu-system-arm and a compiler for the board")]
fn a_board_without_a_sensor_cannot_be_calibrated_and_says_so_every_second() {
    let board = Board::start();
    let folder = tempfile::tempdir().unwrap();
    let study = study(folder.path(), 50);
    let (done, _, said) = belfry(&["calibrate", &study, "--port", &board.line()]);
    assert!(!done && said.contains("the sensor of node 1 gives no readings (absent: it gives no readings)"), "{said}");
    let (done, _, said) = belfry(&["calibrate", &study, "--port", &board.line(), "--read"]);
    assert!(!done && said.contains("node 1 keeps no calibration"), "{said}");
}
