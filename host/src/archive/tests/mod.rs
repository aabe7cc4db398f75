//! What is stored comes back, once, to the setup it belongs to; a file that is no archive stays as it is.

mod creation;
mod cuts;
mod damage;
mod flips;
mod keeping;
mod losses;
mod migration;
mod packing;
mod ranges;

use belfry_shared::message::{Band, ChannelState, Peak, Summary, WindowName};
use belfry_shared::quantise::{decode_lines, encode_lines, encoded_bytes};
use num_complex::Complex32;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use belfry_shared::message::Configuration;
use belfry_shared::time::HostTime;

use super::*;
use crate::spectra::WindowLines;
use crate::study::{Setup, Study};
use crate::window::{ChannelData, KeptWindows, NodeWindow};

const LINES: u16 = 5;

/// Two nodes: node 1 with two channels, node 2 with one that stands between them.
fn setup() -> Setup {
    let text = r#"[structure]
name = "Mast"
[[setup]]
name = "now"
live = true
sampling_rate_hz = 50
[[setup.sensor]]
channel = "low"
node = 1
[[setup.sensor]]
channel = "middle"
node = 2
[[setup.sensor]]
channel = "top"
node = 1
[analysis]
band_hz = [0.5, 10.0]
"#;
    Study::from_text(text, Path::new("somewhere")).unwrap().setups.remove(0)
}

fn configuration(channels: u8, segment: u16) -> Configuration {
    let band = Band { first_line: 3, lines: LINES };
    Configuration {
        channels,
        sampling_rate_uhz: 50_000_000,
        decimation: 2,
        segment,
        summary: Summary::Lines { bits: 10 },
        bands: [band].into_iter().collect(),
    }
}

/// A line that tells its window, channel and place.
fn line(grid_index: u64, channel: usize, place: u16) -> Complex32 {
    Complex32::new(grid_index as f32 + 0.25, channel as f32 - 0.125 * f32::from(place))
}

fn window(configuration: &Configuration, node: u16, number: u32, grid_index: u64) -> NodeWindow {
    let of = |channel| ChannelData::Lines((0..LINES).map(|place| line(grid_index, channel, place)).collect());
    NodeWindow {
        name: WindowName { node, boot: 7, number },
        configuration_hash: configuration.hash(),
        grid_index,
        middle_offset_us: 0,
        drift_ppb: 0,
        channels: (0..usize::from(configuration.channels)).map(of).collect(),
    }
}

struct Bench {
    folder: tempfile::TempDir,
    archive: Archive,
}

impl Bench {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let archive = Archive::create(folder.path()).unwrap();
        Self { folder, archive }
    }

    /// With both nodes asked: the one with two channels, then the one with one.
    fn of_both() -> (Self, Configuration, Configuration) {
        let mut bench = Self::new();
        let (two, one) = (configuration(2, 256), configuration(1, 256));
        bench.ask(&two, 1);
        bench.ask(&one, 1);
        (bench, two, one)
    }

    /// With both asked, and so many windows that each sent from the epoch on.
    fn with_windows_of_both(windows: u32) -> Self {
        let (mut bench, two, one) = Self::of_both();
        for number in 0..windows {
            bench.store(&two, &sent(&two, 1, number, u64::from(number)));
            bench.store(&one, &sent(&one, 2, number, u64::from(number)));
        }
        bench
    }

    /// With node 1 asked, and so many windows that it sent from the epoch on.
    fn of_one(windows: u32) -> (Self, Configuration) {
        let mut bench = Self::new();
        let two = configuration(2, 256);
        bench.ask(&two, 1);
        for number in 0..windows {
            bench.store(&two, &sent(&two, 1, number, u64::from(number)));
        }
        (bench, two)
    }

    /// Asks the node that has as many channels.
    fn ask(&mut self, configuration: &Configuration, second: i64) {
        let (node, channels): (_, &[&str]) = match configuration.channels {
            1 => (2, &["middle"]),
            _ => (1, &["low", "top"]),
        };
        self.archive.ask("now", node, configuration, channels, HostTime(second * 1_000_000)).unwrap();
    }

    fn store(&mut self, configuration: &Configuration, window: &NodeWindow) {
        self.archive.store("now", configuration, window, HostTime(0)).unwrap();
    }

    /// The windows as another program reads them, while this one still has the archive open.
    fn read(&self) -> Result<Option<(CollectedSetup, Vec<WindowLines>)>, ArchiveError> {
        let read = read(self.folder.path(), &TimeRange::ALL)?;
        Ok(read.map(|(setup, windows, damages)| {
            assert_eq!(damages, []);
            (setup, windows)
        }))
    }
}

/// A window of random lines as its node codes them.
fn sent(configuration: &Configuration, node: u16, number: u32, grid_index: u64) -> NodeWindow {
    let mut random = ChaCha8Rng::seed_from_u64(u64::from(number) * 100 + u64::from(node));
    let mut part = || random.random_range(-1.0_f32..1.0);
    let mut window = window(configuration, node, number, grid_index);
    for channel in &mut window.channels {
        let mut lines: Vec<Complex32> = (0..LINES).map(|_| Complex32::new(part(), part())).collect();
        let mut code = vec![0; encoded_bytes(lines.len(), 10)];
        encode_lines(&lines, 10, &mut code).unwrap();
        decode_lines(&code, 10, &mut lines).unwrap();
        *channel = ChannelData::Lines(lines);
    }
    window
}

/// What is read of an archive: its windows, and what is damaged.
type Read = (CollectedSetup, Vec<WindowLines>, Vec<Damage>);

fn read(folder: &Path, range: &TimeRange) -> Result<Option<Read>, ArchiveError> {
    read_as(&setup(), folder, range)
}

fn read_as(setup: &Setup, folder: &Path, range: &TimeRange) -> Result<Option<Read>, ArchiveError> {
    let Some(archive) = Archive::open(folder)? else { return Ok(None) };
    let Some(collected) = archive.collected(setup, range)? else { return Ok(None) };
    let mut windows = Vec::new();
    let damages = collected.each_window(setup, &mut |window| windows.push(window))?;
    Ok(Some((collected.setup, windows, damages)))
}

#[test]
fn windows_come_back_in_the_order_of_the_grid_each_channel_in_its_place() {
    let (mut bench, two, one) = Bench::of_both();
    assert_eq!(bench.read().unwrap(), None);
    // Out of order, node 2 lacks grid index 1001, and node 1 says one window twice.
    for (number, grid_index) in [(2, 1002), (0, 1000), (1, 1001), (1, 1001), (3, 1003), (4, 1004)] {
        bench.store(&two, &window(&two, 1, number, grid_index));
    }
    for (number, grid_index) in [(1, 1002), (0, 1000), (2, 1003)] {
        bench.store(&one, &window(&one, 2, number, grid_index));
    }
    // Another setup's windows, and a node that no sensor names.
    bench.archive.store("before", &two, &window(&two, 5, 0, 1000), HostTime(0)).unwrap();
    bench.store(&two, &window(&two, 9, 0, 1000));
    let (collected, windows) = bench.read().unwrap().unwrap();
    assert_eq!((collected.windows, collected.first_grid_index, collected.other_windows), (5, 1000, 0));
    // A hop is 128 samples at 25 Hz.
    assert!((collected.start_s - 1000.0 * 5.12).abs() < 1e-6);
    assert_eq!((collected.grid.sampling_rate_hz, collected.grid.segment, collected.decimation), (25.0, 256, 2));
    // The last start waits for node 2, which may be about to send.
    let starts: Vec<u64> = windows.iter().map(|window| window.grid_index).collect();
    assert_eq!(starts, [0, 1, 2, 3]);
    for whole in &windows {
        let grid_index = whole.grid_index + 1000;
        let expected = |channel: usize| Some((0..LINES).map(|place| line(grid_index, channel, place)).collect());
        // Channels of node 1 are sensors 0 and 2, that of node 2 is sensor 1.
        let middle = if whole.grid_index == 1 { None } else { expected(0) };
        assert_eq!(whole.channels, [expected(0), middle, expected(1)]);
    }
}

#[test]
fn a_gain_that_is_found_later_counts_for_windows_that_were_stored_before() {
    let bench = Bench::with_windows_of_both(4);
    let mut calibrated = setup();
    // Of the second channel of node 1.
    calibrated.sensors[2].gain = Some(1.5);
    let (_, plain) = bench.read().unwrap().unwrap();
    let (_, windows, _) = read_as(&calibrated, bench.folder.path(), &TimeRange::ALL).unwrap().unwrap();
    assert!(!plain.is_empty() && plain.len() == windows.len());
    for (plain, with_gain) in plain.iter().zip(&windows) {
        assert_eq!(plain.channels[..2], with_gain.channels[..2]);
        let [plain, with_gain] = [plain, with_gain].map(|window| window.channels[2].as_ref().unwrap());
        assert!(plain.iter().zip(with_gain).all(|(plain, with_gain)| *plain * 1.5 == *with_gain));
    }
}

#[test]
fn what_is_not_lines_comes_back_too_and_a_gap_is_told_with_its_reason() {
    let mut bench = Bench::new();
    let two = configuration(2, 256);
    let psd = ChannelData::Psd {
        segments: 3,
        densities: vec![1.0, 2.5e-12],
        peaks: vec![Peak { frequency_hz: 0.5, density: 3.0 }],
    };
    let states = [ChannelState::Missing, ChannelState::Clipped, ChannelState::Constant, ChannelState::Overrun];
    let mut channels = vec![psd];
    channels.extend(states.map(ChannelData::Unsound));
    let stored = NodeWindow { channels: channels.clone(), ..window(&two, 1, 0, 0) };
    bench.store(&two, &stored);
    let mut statement = bench.archive.connection.prepare("SELECT * FROM channel ORDER BY channel").unwrap();
    let rows = statement.query_map([], codec::ChannelRow::read);
    let read: Vec<ChannelData> = rows.unwrap().map(|row| codec::data(&row.unwrap()).unwrap()).collect();
    assert_eq!(read, channels);
}

#[test]
fn the_newest_settings_count_and_what_was_measured_with_others_is_told() {
    let mut bench = Bench::new();
    let (old, new) = (configuration(2, 256), configuration(2, 512));
    bench.ask(&old, 1);
    bench.ask(&new, 2);
    bench.store(&old, &window(&old, 1, 0, 10));
    let (collected, _) = bench.read().unwrap().unwrap();
    assert_eq!((collected.grid.segment, collected.other_windows), (256, 0), "as long as nothing newer has come");
    for (number, grid_index) in [(1, 20), (2, 21), (3, 22)] {
        bench.store(&new, &window(&new, 1, number, grid_index));
    }
    let (collected, windows) = bench.read().unwrap().unwrap();
    assert_eq!((collected.grid.segment, collected.windows, collected.other_windows), (512, 3, 1));
    assert_eq!(windows.len(), 1, "node 2 may be about to send the other two");
    // Asked again, the old ones are the newest.
    bench.ask(&old, 3);
    assert_eq!(bench.read().unwrap().unwrap().0.grid.segment, 256);
}

#[test]
fn channels_go_by_the_names_that_they_had_when_they_were_measured() {
    let mut bench = Bench::new();
    let two = configuration(2, 256);
    // A hop is 5.12 s. From 100 s on the node's cables are swapped, and the study with them; then one sensor is another.
    bench.archive.ask("now", 1, &two, &["low", "top"], HostTime(0)).unwrap();
    bench.archive.ask("now", 1, &two, &["top", "low"], HostTime(100_000_000)).unwrap();
    bench.archive.ask("now", 1, &two, &["top", "gone"], HostTime(150_000_000)).unwrap();
    for (number, grid_index) in [(0, 1), (1, 20), (2, 30), (3, 31), (4, 32)] {
        bench.store(&two, &window(&two, 1, number, grid_index));
    }
    let (_, windows) = bench.read().unwrap().unwrap();
    let expected = |grid_index, channel| Some((0..LINES).map(|place| line(grid_index, channel, place)).collect());
    let seen: Vec<_> = windows.iter().map(|window| window.channels.clone()).collect();
    assert_eq!(seen[0], [expected(1, 0), None, expected(1, 1)]);
    assert_eq!(seen[1], [expected(20, 1), None, expected(20, 0)]);
    assert_eq!(seen[2], [None, None, expected(30, 0)]);
}

#[test]
fn two_programs_store_at_once() {
    let mut bench = Bench::new();
    let two = configuration(2, 256);
    bench.ask(&two, 1);
    let folder = bench.folder.path().to_owned();
    let other = std::thread::spawn(move || {
        let mut archive = Archive::create(&folder).unwrap();
        for number in 0..40 {
            let two = configuration(2, 256);
            archive.store("now", &two, &window(&two, 9, number, u64::from(number)), HostTime(0)).unwrap();
        }
    });
    for number in 0..40 {
        bench.store(&two, &window(&two, 1, number, u64::from(number)));
    }
    other.join().unwrap();
    let count: i64 = bench.archive.connection.query_row("SELECT count(*) FROM window", [], |row| row.get(0)).unwrap();
    assert_eq!(count, 80);
}

#[test]
fn a_life_that_is_met_again_says_what_is_kept_and_where_it_began() {
    let mut bench = Bench::new();
    let two = configuration(2, 256);
    let met = |bench: &mut Bench, setup, boot, next, second: i64| {
        let before = bench.archive.kept(1, boot).unwrap();
        bench.archive.meet(setup, 1, boot, next, HostTime(second * 1_000_000)).unwrap();
        before
    };
    assert_eq!(met(&mut bench, "now", 7, 40, 1), None);
    assert_eq!(bench.archive.kept(1, 7).unwrap(), Some(KeptWindows { first: 40, ..KeptWindows::default() }));
    for number in [40, 42] {
        bench.store(&two, &window(&two, 1, number, u64::from(number)));
    }
    assert_eq!(
        met(&mut bench, "now", 7, 43, 2),
        Some(KeptWindows { first: 40, numbers: vec![40, 42], last: Some((42, 42)), ..KeptWindows::default() })
    );
    assert_eq!(met(&mut bench, "now", 8, 0, 3), None);
}

#[test]
fn a_window_goes_to_the_setup_that_its_node_served_and_to_none_while_it_moved() {
    let mut bench = Bench::new();
    let two = configuration(2, 256);
    bench.ask(&two, 1);
    // The node serves "before" from 100 s on, "now" from 200 s on, and "before" again from 300 s on. A hop is 5.12 s.
    for (setup, second) in [("before", 100), ("before", 150), ("now", 200), ("before", 300)] {
        bench.archive.meet(setup, 1, 7, 3, HostTime(second * 1_000_000)).unwrap();
    }
    for (number, grid_index) in [(3, 30), (4, 38), (5, 45), (6, 70)] {
        bench.store(&two, &window(&two, 1, number, grid_index));
    }
    let setups: Vec<(u32, String)> = {
        let mut statement =
            bench.archive.connection.prepare("SELECT number, setup FROM window ORDER BY number").unwrap();
        statement.query_map([], |row| Ok((row.get(0)?, row.get(1)?))).unwrap().map(Result::unwrap).collect()
    };
    let expected = [(3, "before"), (4, ""), (5, "now"), (6, "before")];
    assert_eq!(setups, expected.map(|(number, setup)| (number, setup.to_owned())));
}

#[test]
fn a_file_that_is_no_archive_is_named_and_stays_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    assert!(Archive::open(folder.path()).unwrap().is_none());
    let file = folder.path().join(ARCHIVE_FILE);
    std::fs::write(&file, "temperatures of last week, in a table that is long enough to be taken for a page").unwrap();
    let told = |result: Result<(), ArchiveError>| result.unwrap_err().to_string();
    assert!(told(Archive::create(folder.path()).map(drop)).contains("no archive of belfry"));
    assert!(told(Archive::open(folder.path()).map(drop)).contains("no archive of belfry"));
    assert!(std::fs::read_to_string(&file).unwrap().starts_with("temperatures"));
    // A database of another program.
    std::fs::remove_file(&file).unwrap();
    Connection::open(&file).unwrap().execute_batch("CREATE TABLE bills (sum REAL)").unwrap();
    let bytes = std::fs::read(&file).unwrap();
    assert!(told(Archive::create(folder.path()).map(drop)).contains("no archive of belfry"));
    assert_eq!(std::fs::read(&file).unwrap(), bytes);
    // An archive of the future.
    std::fs::remove_file(&file).unwrap();
    drop(Archive::create(folder.path()).unwrap());
    Connection::open(&file).unwrap().pragma_update(None, "user_version", 9).unwrap();
    assert!(told(Archive::create(folder.path()).map(drop)).contains("version 9"));
}

#[test]
fn what_is_lost_or_unsound_and_when_a_node_started_anew_is_counted_for_each_node() {
    let mut bench = Bench::new();
    let (one, two) = (configuration(1, 256), configuration(2, 256));
    bench.ask(&one, 0);
    bench.ask(&two, 0);
    for number in [0, 1, 4] {
        bench.store(&two, &window(&two, 1, number, u64::from(number)));
    }
    let mut clipped = window(&two, 1, 5, 5);
    clipped.channels[1] = ChannelData::Unsound(ChannelState::Clipped);
    bench.store(&two, &clipped);
    let mut again = window(&two, 1, 0, 9);
    again.name.boot = 8;
    bench.store(&two, &again);
    bench.store(&one, &window(&one, 2, 3, 3));
    let health = bench.archive.health().unwrap();
    let counts: Vec<_> = health
        .iter()
        .map(|node| (node.node, node.channels, node.windows, node.lost_windows, node.bad_windows, node.restarts))
        .collect();
    assert_eq!(counts, [(1, 2, 5, 2, 1, 1), (2, 1, 1, 0, 0, 0)]);
    assert!(health.iter().all(|node| node.setup == "now"));
}
