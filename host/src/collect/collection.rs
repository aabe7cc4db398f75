//! A collection: one live setup of a study, its nodes, and what each of them has to measure.

use std::collections::BTreeMap;
use std::time::Duration;

use belfry_shared::message::Summary;
use belfry_shared::time::HostTime;

use super::settings::{CollectOptions, CollectionError, Settings, settings, study_file};
use crate::archive::Archive;
use crate::keys::Keys;
use crate::spectra::LineGrid;
use crate::study::{Setup, Study};
use crate::window::{Configurations, channels_by_node, node_configuration};

/// What is to be collected.
#[derive(Debug, Clone)]
pub struct Collection {
    /// The setup.
    pub setup: String,
    /// Baud rate of the lines.
    pub baud: u32,
    /// Its nodes, and what each has to measure.
    pub nodes: BTreeMap<u16, Configurations>,
    /// The nodes' keys.
    pub keys: Keys,
    /// Whether windows that nodes hold for another study are dropped.
    pub drop_foreign: bool,
    /// The lines that the nodes send.
    pub grid: LineGrid,
    /// Raw samples a decimated one.
    pub decimation: u32,
    /// Why these lines, in words.
    pub reason: String,
}

impl Collection {
    /// What a study's nodes are to measure, from now (in Unix time) on; it is noted in the archive.
    ///
    /// # Errors
    /// [`CollectionError`].
    pub fn of<'s>(
        study: &'s Study,
        archive: &mut Archive,
        options: &CollectOptions,
        now: Duration,
    ) -> Result<(&'s Setup, Self), CollectionError> {
        let setup = Self::live_setup(study, options.setup.as_deref())?;
        let Settings { grid, decimation, bits, reason } = settings(study, setup, archive, options)?;
        // Of other setups too: a node that has moved may still have windows of the one before.
        let earlier = archive.configurations(None)?;
        let now = HostTime::since_epoch(now);
        let mut nodes = BTreeMap::new();
        for (node, channels) in channels_by_node(setup) {
            let summary = Summary::Lines { bits };
            let current = node_configuration(setup.sampling_rate_hz, decimation, &grid, channels.len(), summary)
                .ok_or(CollectionError::Inexpressible { node })?;
            let names: Vec<&str> = channels.iter().map(|&channel| setup.sensors[channel].channel.as_str()).collect();
            archive.ask(&setup.name, node, &current, &names, now)?;
            nodes.insert(node, Configurations { current, earlier: earlier.clone() });
        }
        let CollectOptions { baud, drop_foreign, ref keys, .. } = *options;
        let keys = keys.clone();
        Ok((setup, Self { setup: setup.name.clone(), baud, nodes, keys, drop_foreign, grid, decimation, reason }))
    }

    /// The live setup of a study; the one of this name where one is given.
    ///
    /// # Errors
    /// Where there is none, or which is meant is not clear.
    pub fn live_setup<'s>(study: &'s Study, name: Option<&str>) -> Result<&'s Setup, CollectionError> {
        let live: Vec<&Setup> = study.setups.iter().filter(|setup| setup.live).collect();
        let names = || live.iter().map(|setup| format!("\"{}\"", setup.name)).collect::<Vec<_>>().join(", ");
        match (name, live.as_slice()) {
            (_, []) => Err(CollectionError::NoLiveSetup { file: study_file(study) }),
            (None, [setup]) => Ok(setup),
            (None, _) => Err(CollectionError::SeveralLiveSetups { names: names() }),
            (Some(name), live) => live
                .iter()
                .find(|setup| setup.name == name)
                .copied()
                .ok_or_else(|| CollectionError::NotLive { name: name.to_owned(), names: names() }),
        }
    }
}
