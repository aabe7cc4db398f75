//! Nodes against the direct path, over sound and bad lines.

use belfry_shared::message::Summary;

use super::*;
use crate::link::memory::Faults;
use crate::spectra::direct::Welch;
use crate::study::{Direction, Sensor, Unit};

const RATE_HZ: f64 = 50.0;
const DECIMATION: u32 = 10;

fn grid() -> LineGrid {
    LineGrid { sampling_rate_hz: 5.0, segment: 256, first_line: 4, lines: 90 }
}

fn setup(channels: usize, a_node: usize) -> Setup {
    let sensors = (0..channels).map(|channel| Sensor {
        direction: Some(Direction::Up),
        ..Sensor::new(channel.to_string(), (channel / a_node) as u16 + 1)
    });
    Setup {
        name: "test".to_owned(),
        files: Vec::new(),
        live: false,
        block_s: None,
        utc_offset_h: None,
        variable: None,
        sampling_rate_hz: RATE_HZ,
        unit: Unit::MetrePerSecondSquared,
        temperature: None,
        sensors: sensors.collect(),
    }
}

/// Tones, a drift and noise, different in every channel, on an offset like gravity's.
fn rows(count: usize, channels: usize) -> Vec<f64> {
    let mut state = 42_u64;
    let mut noise = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as f64 / f64::from(1_u32 << 31) - 0.5
    };
    let mut rows = Vec::with_capacity(count * channels);
    for row in 0..count {
        let t = row as f64 / RATE_HZ;
        for channel in 0..channels {
            let c = channel as f64;
            let tones = 0.02 * (6.1 * t + c).sin() + 0.005 * (1.3 + c) * (9.7 * t).cos();
            rows.push(1.0 + c + 1e-5 * t + tones + 0.02 * noise());
        }
    }
    rows
}

fn through_nodes(setup: &Setup, rows: &[f64], options: &FleetOptions) -> (Vec<WindowLines>, FleetReport) {
    let mut windows = Vec::new();
    let mut fleet = Fleet::start(setup, DECIMATION, &grid(), options).unwrap();
    for block in rows.chunks(1000 * setup.sensors.len()) {
        fleet.push(block, &mut |window| windows.push(window)).unwrap();
    }
    let report = fleet.finish(&mut |window| windows.push(window)).unwrap();
    (windows, report)
}

fn directly(setup: &Setup, rows: &[f64]) -> Vec<WindowLines> {
    let mut windows = Vec::new();
    let mut welch = Welch::new(grid(), DECIMATION, setup.sensors.len()).unwrap();
    for row in rows.chunks(setup.sensors.len()) {
        welch.push(row, &mut |window| windows.push(window));
    }
    windows
}

fn bits(bits: u8) -> FleetOptions {
    FleetOptions { summary: Summary::Lines { bits }, ..FleetOptions::default() }
}

/// The largest difference of lines over the largest line, and whether the same channels speak in the same windows.
fn difference(a: &[WindowLines], b: &[WindowLines]) -> f64 {
    assert_eq!(a.len(), b.len(), "windows");
    let (mut worst, mut largest) = (0.0_f32, 0.0_f32);
    for (a, b) in a.iter().zip(b) {
        assert_eq!(a.grid_index, b.grid_index);
        for (channel, (a, b)) in a.channels.iter().zip(&b.channels).enumerate() {
            assert_eq!(a.is_some(), b.is_some(), "channel {channel} in a window");
            for (a, b) in a.iter().flatten().zip(b.iter().flatten()) {
                worst = worst.max((a - b).norm());
                largest = largest.max(b.norm());
            }
        }
    }
    f64::from(worst / largest)
}

#[test]
fn nodes_and_the_direct_path_make_the_same_windows() {
    let setup = setup(6, 2);
    let rows = rows(50 * 600, 6);
    let direct = directly(&setup, &rows);
    assert!(direct.len() > 20);
    let (sixteen, report) = through_nodes(&setup, &rows, &bits(16));
    // What the clock exchange leaves (tens of µs at first, 1e-4 rad at 2 Hz) and f32 on an offset of 6 m/s² (4e-7 of 0.02).
    let worst = difference(&sixteen, &direct);
    assert!(worst < 3e-4, "16 bits: {worst}");
    let (eight, _) = through_nodes(&setup, &rows, &bits(8));
    // Half a step of 1/127 in each component, up to 19 % more for the scale's steps.
    let worst = difference(&eight, &direct);
    assert!((1e-4..0.5 * 1.19 / 127.0 * 1.42 + 2e-3).contains(&worst), "8 bits: {worst}");
    assert_eq!(
        report.nodes.iter().map(|node| (node.node, node.channels)).collect::<Vec<_>>(),
        [(1, 2), (2, 2), (3, 2)]
    );
    assert!((report.duration_s - 600.0).abs() < 1e-9);
}

#[test]
fn with_two_percent_of_frames_damaged_every_window_arrives_exactly_once_and_unchanged() {
    let setup = setup(4, 2);
    let rows = rows(50 * 1200, 4);
    let (sound, _) = through_nodes(&setup, &rows, &bits(10));
    for seed in 1..=6 {
        let options = FleetOptions { faults: Faults::damaging(0.02), seed, ..bits(10) };
        let (windows, report) = through_nodes(&setup, &rows, &options);
        let indices: Vec<u64> = windows.iter().map(|window| window.grid_index).collect();
        assert_eq!(indices, (0..sound.len() as u64).collect::<Vec<_>>(), "seed {seed}");
        let damaged: u64 = report.nodes.iter().map(|node| node.to_host.damaged() + node.to_node.damaged()).sum();
        assert!(damaged > 0, "seed {seed}: the line did no damage");
        for node in &report.nodes {
            assert_eq!((node.session.windows, node.session.lost_windows), (sound.len() as u64, 0), "seed {seed}");
        }
        // Other clocks, so other remainders; the data are the same.
        assert!(difference(&windows, &sound) < 5e-3, "seed {seed}");
    }
}

#[test]
fn a_line_that_damages_every_fifth_frame_still_delivers_everything() {
    let setup = setup(4, 2);
    let rows = rows(50 * 600, 4);
    let expected = directly(&setup, &rows).len();
    for seed in 1..=4 {
        let options = FleetOptions { faults: Faults::damaging(0.2), seed, ..bits(10) };
        let (windows, report) = through_nodes(&setup, &rows, &options);
        assert_eq!(windows.len(), expected, "seed {seed}");
        assert!(windows.iter().all(|window| window.channels.iter().all(Option::is_some)), "seed {seed}");
        assert!(report.nodes.iter().all(|node| node.session.lost_windows == 0), "seed {seed}: {report:?}");
        assert!(report.nodes.iter().any(|node| node.session.asked_again > 0), "seed {seed}");
    }
}

#[test]
fn gaps_and_dead_channels_silence_the_same_windows_on_both_paths() {
    let setup = setup(4, 2);
    let mut rows = rows(50 * 900, 4);
    for row in 0..50 * 900 {
        if row == 9000 || (20_000..20_070).contains(&row) {
            rows[row * 4 + 1] = f64::NAN;
        }
        rows[row * 4 + 2] = 0.5;
        if row > 30_000 {
            rows[row * 4 + 3] = -1.25;
        }
    }
    let direct = directly(&setup, &rows);
    let (nodes, _) = through_nodes(&setup, &rows, &bits(16));
    assert!(difference(&nodes, &direct) < 2e-3);
    let silent = |channel: usize| direct.iter().filter(|window| window.channels[channel].is_none()).count();
    assert_eq!((silent(0), silent(2)), (0, direct.len()));
    assert!(silent(1) > 2 && silent(1) < 10 && silent(3) > 5 && silent(3) < direct.len());
}

#[test]
fn the_same_seed_gives_the_same_run() {
    let setup = setup(2, 1);
    let rows = rows(50 * 300, 2);
    let options = FleetOptions { faults: Faults::damaging(0.05), seed: 9, ..bits(8) };
    let (first, second) = (through_nodes(&setup, &rows, &options), through_nodes(&setup, &rows, &options));
    assert_eq!(first, second);
}

#[test]
fn a_line_too_slow_for_the_data_loses_windows_and_says_how_many() {
    let setup = setup(4, 4);
    let rows = rows(50 * 3600, 4);
    let expected = directly(&setup, &rows).len() as u64;
    // A window of 4 x 90 lines of 32 bits is 1.5 kB every 25.6 s, 570 bit/s on the line; this one carries 300.
    let options = FleetOptions { baud: 300, ..bits(16) };
    let (windows, report) = through_nodes(&setup, &rows, &options);
    let session = report.nodes[0].session;
    assert!(session.lost_windows > 0, "{session:?}");
    assert_eq!(session.windows + session.lost_windows, expected, "{session:?}");
    assert_eq!(windows.len() as u64, session.windows);
    // 9600 baud are plenty.
    let (windows, report) = through_nodes(&setup, &rows, &FleetOptions { baud: 9600, ..bits(16) });
    assert_eq!((windows.len() as u64, report.nodes[0].session.lost_windows), (expected, 0));
}

#[test]
fn a_line_that_passes_nothing_is_an_error_not_an_endless_wait() {
    let setup = setup(1, 1);
    let options = FleetOptions { faults: Faults { drop: 1.0, ..Faults::default() }, ..bits(8) };
    let mut fleet = Fleet::start(&setup, DECIMATION, &grid(), &options).unwrap();
    // It may be known while rows are still pushed.
    let pushed = fleet.push(&rows(100, 1), &mut |_| {});
    let error = pushed.and_then(|()| fleet.finish(&mut |_| {})).unwrap_err();
    assert!(matches!(error, FleetError::NotReady { node: 1 }), "{error}");
}

#[test]
fn settings_that_no_node_runs_come_back_as_its_refusal() {
    let setup = setup(1, 1);
    let grid = LineGrid { segment: 300, ..grid() };
    let fleet = Fleet::start(&setup, DECIMATION, &grid, &bits(8)).unwrap();
    let error = fleet.finish(&mut |_| {}).unwrap_err();
    assert!(error.to_string().contains("no power of two from 256 to 4096"), "{error}");
    assert!(matches!(Fleet::start(&setup, 13, &grid, &bits(8)), Err(FleetError::Settings { .. })));
}
