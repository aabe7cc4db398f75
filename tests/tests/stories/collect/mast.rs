//! The mast that is measured: its motion, its study, its nodes' firmware, and what has come of it into the archive.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use belfry_firmware::{Identity, Memory, Node};
use rand::{RngExt, SeedableRng};

/// Rows a second: fast, so that a window takes a quarter of a second.
pub(super) const RATE_HZ: f64 = 1000.0;
/// The structure's modes: frequency in Hz, damping ratio, shape at the four sensors.
pub(super) const MODES: [(f64, f64, [f64; 4]); 2] =
    [(40.0, 0.01, [0.2, 0.5, 0.8, 1.0]), (90.0, 0.01, [0.7, 0.9, -0.2, -0.8])];
/// The structure's motion from the moment when the nodes were switched on: modes driven by noise, in m/s².
pub(super) fn motion(seconds: f64) -> Vec<[f32; 4]> {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(4);
    let mut noise = move || 2.0 * random.random::<f64>() - 1.0;
    // Two-pole resonators; their impulse response is that of the mode.
    let poles = MODES.map(|(frequency_hz, damping, _)| {
        let omega = std::f64::consts::TAU * frequency_hz / RATE_HZ;
        let radius = (-damping * omega).exp();
        (2.0 * radius * (omega * (1.0 - damping * damping).sqrt()).cos(), -radius * radius)
    });
    let mut states = [(0.0, 0.0); 2];
    (0..(seconds * RATE_HZ) as usize)
        .map(|_| {
            let mut row = [0.0_f64; 4];
            for ((state, (a, b)), (_, _, shape)) in states.iter_mut().zip(poles).zip(MODES) {
                *state = (a * state.0 + b * state.1 + 0.01 * noise(), state.0);
                row.iter_mut().zip(shape).for_each(|(value, factor)| *value += factor * state.0);
            }
            row.map(|value| (value + 1e-3 * noise()) as f32)
        })
        .collect()
}

pub(super) fn fresh_node(number: u16, boot: u32) -> Node<Box<Memory>> {
    Node::new(Identity { boot, ..identity(number) }, Box::new(Memory::new()))
}

/// A node's identity, before it has drawn a boot id.
pub(super) fn identity(number: u16) -> Identity {
    let full_scale_m_s2 = 20.0;
    Identity { node: number, boot: 0, channels: 2, full_scale_m_s2, highest_rate_mhz: 4_000_000 }
}

/// See [`belfry_tests::folder_in_memory`].
pub(super) fn folder_in_memory() -> tempfile::TempDir {
    belfry_tests::folder_in_memory().unwrap()
}

/// Writes a study of four sensors on two nodes, which send 32 lines of every segment of 256.
pub(super) fn write_study(folder: &Path) {
    let mut text = "[structure]\nname = \"Mast\"\n[[setup]]\nname = \"now\"\nlive = true\n".to_owned();
    text += &format!("sampling_rate_hz = {RATE_HZ}\n");
    for (channel, node) in [("a", 3), ("b", 3), ("c", 8), ("d", 8)] {
        text += &format!("[[setup.sensor]]\nchannel = \"{channel}\"\nnode = {node}\n");
    }
    text += "[analysis]\nband_hz = [15.0, 150.0]\nsegment = 256\n";
    fs::write(folder.join("study.toml"), text).unwrap();
}

/// The archive of a study, as another program reads it.
pub(super) fn archive(folder: &Path) -> rusqlite::Connection {
    rusqlite::Connection::open(folder.join("archive.sqlite")).unwrap()
}

/// Numbers of a node's windows, life by life.
pub(super) fn lives(folder: &Path, node: u16) -> BTreeMap<u32, Vec<u32>> {
    let archive = archive(folder);
    let mut lives: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    // Before its tables are there, the archive has none.
    let Ok(mut statement) = archive.prepare("SELECT boot, number FROM window WHERE node = ?1 ORDER BY boot, number")
    else {
        return lives;
    };
    let rows = statement.query_map([node], |row| Ok((row.get(0)?, row.get(1)?))).unwrap();
    for (boot, number) in rows.map(Result::unwrap) {
        lives.entry(boot).or_default().push(number);
    }
    lives
}

/// Numbers of the windows of a node that has had one life.
pub(super) fn numbers(folder: &Path, node: u16) -> Vec<u32> {
    let lives = lives(folder, node);
    assert!(lives.len() <= 1, "lives of node {node}: {:?}", lives.keys());
    lives.into_values().next().unwrap_or_default()
}

/// Whether these are all numbers from 0 on.
pub(super) fn is_without_gaps(numbers: &[u32]) -> bool {
    numbers.iter().copied().eq(0..numbers.len() as u32)
}
