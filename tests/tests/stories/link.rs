//! What crosses the wire: how many bytes, and that every window arrives exactly once although frames are damaged.

use belfry_host::fleet::{Fleet, FleetOptions, FleetReport};
use belfry_host::link::memory::Faults;
use belfry_host::spectra::{LineGrid, WindowLines};
use belfry_host::study::{Direction, Sensor, Setup, Unit};
use belfry_shared::message::Summary;
use belfry_tests::clock::{self, ClockStudy};

const RATE_HZ: f64 = 50.0;
/// Raw data of a 24 bit channel at 50 Hz.
const RAW_BYTES_PER_SECOND: f64 = 150.0;

fn setup(channels: usize, a_node: usize) -> Setup {
    let sensors = (0..channels).map(|channel| Sensor {
        direction: Some(Direction::Up),
        ..Sensor::new(channel.to_string(), (channel / a_node) as u16 + 1)
    });
    Setup {
        name: "wire".to_owned(),
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

/// Runs a fleet over `seconds` of noise and a tone.
fn run(
    channels: usize,
    a_node: usize,
    seconds: usize,
    decimation: u32,
    grid: &LineGrid,
    options: &FleetOptions,
) -> (Vec<WindowLines>, FleetReport) {
    let mut state = 3_u64;
    let mut windows = Vec::new();
    let mut fleet = Fleet::start(&setup(channels, a_node), decimation, grid, options).unwrap();
    let mut block = Vec::new();
    for second in 0..seconds {
        block.clear();
        for row in 0..RATE_HZ as usize {
            let t = (second * RATE_HZ as usize + row) as f64 / RATE_HZ;
            for channel in 0..channels {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                block.push((state >> 33) as f64 * 1e-12 + 1e-3 * (2.0 * t + channel as f64).sin());
            }
        }
        fleet.push(&block, &mut |window| windows.push(window)).unwrap();
    }
    let report = fleet.finish(&mut |window| windows.push(window)).unwrap();
    (windows, report)
}

/// 0.05 to 1.5 Hz of 4096 points at 5 Hz.
fn reference_grid() -> LineGrid {
    LineGrid { sampling_rate_hz: 5.0, segment: 4096, first_line: 41, lines: 1188 }
}

#[test]
fn lines_of_the_reference_band_take_less_than_five_bytes_a_second_and_densities_less_than_half_a_byte() {
    // Six hours of a node with four channels: 51 windows of lines, six of densities.
    let hours = 6;
    // On a line that jitters as well, where clocks take more exchanges.
    let summaries = [(Summary::Lines { bits: 6 }, 5.0), (Summary::Psd { segments: 8 }, 0.5)];
    for ((summary, most), jitter_us) in summaries.into_iter().flat_map(|summary| [(summary, 0), (summary, 5_000)]) {
        let faults = Faults { jitter_us, ..Faults::default() };
        let options = FleetOptions { summary, faults, ..FleetOptions::default() };
        let (_, report) = run(4, 4, hours * 3600, 10, &reference_grid(), &options);
        let windows = report.nodes[0].session.windows;
        assert!(windows >= 5 && report.nodes[0].session.lost_windows == 0);
        let bytes = report.wire_bytes_per_second_and_channel();
        println!(
            "{summary:?}, {jitter_us} µs of jitter: {bytes:.2} bytes per second and channel, {:.0} times less than raw",
            RAW_BYTES_PER_SECOND / bytes
        );
        // The first window starts after the filter has settled and nothing is sent of the last, incomplete one.
        assert!(bytes < most, "{summary:?}: {bytes} bytes per second and channel");
        assert!(bytes > 0.5 * most * 0.5, "{summary:?}: {bytes} is too little to be all data");
    }
}

#[test]
fn keys_take_at_most_three_percent_of_the_bytes_that_a_node_sends() {
    // 10 bits are what nodes send where nothing is said; with 6, frames are as many for fewer bytes.
    for bits in [10, 6] {
        let bytes = |has_keys: bool| {
            let options = FleetOptions { summary: Summary::Lines { bits }, has_keys, ..FleetOptions::default() };
            let (windows, report) = run(4, 4, 6 * 3600, 10, &reference_grid(), &options);
            assert!(windows.len() >= 50 && report.nodes[0].session.unsealed_frames == 0);
            [report.nodes[0].to_host.bytes as f64, report.nodes[0].to_node.bytes as f64]
        };
        let (plain, sealed) = (bytes(false), bytes(true));
        let more = |sealed: f64, plain: f64| 100.0 * (sealed / plain - 1.0);
        let (from_node, both) = (more(sealed[0], plain[0]), more(sealed.iter().sum(), plain.iter().sum()));
        println!(
            "{bits} bits: {} and {} bytes to host and node without a key, {} and {} with: {from_node:.2} % more of the node's, {both:.2} % of all",
            plain[0], plain[1], sealed[0], sealed[1]
        );
        assert!(from_node < 3.0 && both < 3.5, "{bits} bits: {from_node} %, {both} %");
    }
}

#[test]
fn with_two_percent_of_frames_damaged_every_window_of_eight_nodes_arrives_exactly_once() {
    let grid = LineGrid { sampling_rate_hz: 6.25, segment: 512, first_line: 5, lines: 118 };
    let options = FleetOptions { faults: Faults::damaging(0.02), seed: 4, ..FleetOptions::default() };
    let (windows, report) = run(20, 3, 20 * 60, 8, &grid, &options);
    // 1200 s less the filter's 2 x 2.1 s in segments of 81.9 s, every 41 s.
    let expected = ((1200.0 - 4.2 - 81.92_f64) / 40.96).floor() as usize + 1;
    assert_eq!(
        windows.iter().map(|window| window.grid_index as usize).collect::<Vec<_>>(),
        (0..expected).collect::<Vec<_>>()
    );
    assert!(windows.iter().all(|window| window.channels.iter().all(Option::is_some)));
    let damaged: u64 = report.nodes.iter().map(|node| node.to_host.damaged() + node.to_node.damaged()).sum();
    assert!(damaged > 10, "{damaged} frames damaged");
    for node in &report.nodes {
        assert_eq!((node.session.windows as usize, node.session.lost_windows), (expected, 0), "node {}", node.node);
    }
}

#[test]
fn crystals_that_drift_apart_and_lines_that_jitter_leave_shapes_as_they_are() {
    // A slice of the day that ``studies clock` takes, with crystals in sun and shade.
    let study = ClockStudy { hours: 4.0, crystal_ppm: 50.0, swing_ppm: 10.0, jitter_ms: 5.0, seed: 1 };
    let report = clock::run(&study).unwrap();
    assert!(report.windows > 80, "{report}");
    // Without the remainder at the segments' middles it is 1e-3, and phases are off by 5 degrees and more.
    assert!(report.modes.len() > 10 && report.worst_mac_loss() < 1e-5, "{report}");
    // Four hours have few averages: phases of the weakest components are their own.
    assert!(report.worst_phase_deg() < 0.7 && report.nodes_apart_deg() < 0.1, "{report}");
    for (node, mean_us, rms_us) in &report.nodes {
        assert!(mean_us.abs() < 250.0 && *rms_us < 500.0, "node {node}: {report}");
    }
}
