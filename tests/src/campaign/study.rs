//! The study of a run: what its nodes measure is drawn.

use std::fs;
use std::io;
use std::path::Path;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::NODES;

/// What is measured.
pub(super) struct Drawn {
    pub(super) rate_hz: f64,
    segment: usize,
    /// Channels of each node.
    pub(super) channels: Vec<usize>,
    /// The bytes of a node's key; `None` where it has none.
    pub(super) keys: Vec<Option<[u8; 32]>>,
    /// Bytes of each node's memory chip, 0 where it has none, and whether it is NOR flash.
    pub(super) chips: Vec<(usize, bool)>,
}

/// Sizes of memory chips. The smallest is too small for a long outage.
const CHIP_BYTES: [usize; 4] = [0, 0, 48 << 10, 512 << 10];

const DECIMATED_RATE_HZ: i64 = 5;

impl Drawn {
    pub(super) fn new(random: &mut ChaCha8Rng) -> Self {
        let rate_hz = [10.0, 20.0][random.random_range(0..2)];
        let segment = [256, 512, 1024][random.random_range(0..3)];
        Self {
            rate_hz,
            segment,
            channels: (0..NODES).map(|_| random.random_range(1..=4)).collect(),
            keys: (0..NODES).map(|_| random.random::<bool>().then(|| random.random())).collect(),
            chips: (0..NODES)
                .map(|_| (CHIP_BYTES[random.random_range(0..CHIP_BYTES.len())], random.random()))
                .collect(),
        }
    }

    /// µs from the beginning of a window to that of the next.
    pub(super) fn hop_us(&self) -> i64 {
        (self.segment / 2) as i64 * 1_000_000 / DECIMATED_RATE_HZ
    }

    pub(super) fn write(&self, folder: &Path) -> io::Result<()> {
        let mut text = "[structure]\nname = \"Mast\"\n[[setup]]\nname = \"now\"\nlive = true\n".to_owned();
        text += &format!("sampling_rate_hz = {}\n", self.rate_hz);
        for (index, &channels) in self.channels.iter().enumerate() {
            for channel in 0..channels {
                let node = index + 1;
                text += &format!("[[setup.sensor]]\nchannel = \"{node}-{channel}\"\nnode = {node}\n");
            }
        }
        text += &format!(
            "[analysis]\nband_hz = [0.3, 1.5]\ndecimated_rate_hz = {DECIMATED_RATE_HZ}.0\nsegment = {}\n",
            self.segment
        );
        fs::write(folder.join("study.toml"), text)
    }
}
