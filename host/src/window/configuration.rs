//! What a node is asked to measure: its configuration made from a setup and the lines of the analysis, and read back from it.

use std::collections::BTreeMap;

use belfry_shared::message::{Band, Configuration, Summary};

use crate::spectra::LineGrid;
use crate::study::Setup;

/// What a node's windows can have been measured with.
#[derive(Debug, Clone, PartialEq)]
pub struct Configurations {
    /// What it is to measure with now.
    pub current: Configuration,
    /// What it measured with before: its outbox may still hold such windows.
    pub earlier: Vec<Configuration>,
}

impl Configurations {
    /// One, and none before.
    pub fn only(current: Configuration) -> Self {
        Self { current, earlier: Vec::new() }
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = &Configuration> {
        std::iter::once(&self.current).chain(&self.earlier)
    }

    /// The one of a hash.
    pub fn by_hash(&self, hash: u32) -> Option<&Configuration> {
        self.iter().find(|configuration| configuration.hash() == hash)
    }
}

/// The configuration of a node with `channels` channels for a setup's spectral settings.
pub fn node_configuration(
    sampling_rate_hz: f64,
    decimation: u32,
    grid: &LineGrid,
    channels: usize,
    summary: Summary,
) -> Option<Configuration> {
    let band = Band { first_line: u16::try_from(grid.first_line).ok()?, lines: u16::try_from(grid.lines).ok()? };
    Some(Configuration {
        channels: u8::try_from(channels).ok()?,
        sampling_rate_uhz: (sampling_rate_hz * 1e6).round() as u64,
        decimation,
        segment: u16::try_from(grid.segment).ok()?,
        summary,
        bands: [band].into_iter().collect(),
    })
}

/// The lines and the decimation of a configuration that sends one run of lines: what decides which windows can be averaged
/// together. The inverse of [`node_configuration`].
pub fn node_lines(configuration: &Configuration) -> Option<(LineGrid, u32)> {
    let [band] = configuration.bands.as_slice() else { return None };
    matches!(configuration.summary, Summary::Lines { .. }).then(|| {
        let grid = LineGrid {
            sampling_rate_hz: configuration.sampling_rate_uhz as f64 * 1e-6 / f64::from(configuration.decimation),
            segment: usize::from(configuration.segment),
            first_line: usize::from(band.first_line),
            lines: usize::from(band.lines),
        };
        (grid, configuration.decimation)
    })
}

/// The channels (indices into the setup's) of each node number.
pub fn channels_by_node(setup: &Setup) -> BTreeMap<u16, Vec<usize>> {
    let mut channels_of: BTreeMap<u16, Vec<usize>> = BTreeMap::new();
    for (channel, sensor) in setup.sensors.iter().enumerate() {
        channels_of.entry(sensor.node).or_default().push(channel);
    }
    channels_of
}
