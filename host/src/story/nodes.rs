//! How the nodes of a live study are, from its archive and its heartbeats.

use std::collections::BTreeMap;

use crate::archive::Archive;
use crate::heartbeats;
use crate::study::Study;
use crate::watch::{LOOKED_BACK_S, NEWEST_WINDOWS, NodeLimits, NodeNews, NodeState, WindowHead, node_state};
use crate::window::channels_by_node;

/// The state of each node at `now_s`, which was as `before` says; a sentence where the archive or the heartbeats cannot be read. A study of recordings
/// has no nodes.
pub(crate) fn nodes(
    study: &Study,
    before: &[NodeState],
    limits: &NodeLimits,
    now_s: f64,
) -> Result<Vec<NodeState>, String> {
    let mut all: BTreeMap<u16, NodeNews> = BTreeMap::new();
    let live = || study.setups.iter().filter(|setup| setup.live);
    if live().next().is_none() {
        return Ok(Vec::new());
    }
    if let Some(archive) = Archive::open(&study.folder).map_err(|error| error.to_string())? {
        for setup in live() {
            let configuration = archive.configurations(Some(&setup.name)).map_err(|error| error.to_string())?;
            let Some(configuration) = configuration.into_iter().next() else { continue };
            let sample_s = 1e6 / configuration.sampling_rate_uhz.max(1) as f64;
            for node in channels_by_node(setup).into_keys() {
                let heads = archive.newest_heads(&setup.name, node, NEWEST_WINDOWS);
                let heads = heads.map_err(|error| error.to_string())?;
                let news = all.entry(node).or_insert_with(|| NodeNews { node, ..NodeNews::default() });
                // A node that has served several setups is in the one that it served last.
                let time_s = |windows: &[WindowHead]| windows.first().map_or(f64::NEG_INFINITY, |one| one.time_s);
                if time_s(&heads) > time_s(&news.windows) {
                    *news = NodeNews {
                        node,
                        windows: heads,
                        heartbeats: Vec::new(),
                        sample_s,
                        decimated_s: sample_s * f64::from(configuration.decimation),
                    };
                }
            }
        }
    }
    let read = heartbeats::newest(&study.folder, LOOKED_BACK_S, all.len(), |heartbeat| {
        if let Some(news) = all.get_mut(&heartbeat.node).filter(|_| heartbeat.time_s > now_s - LOOKED_BACK_S) {
            news.heartbeats.push(heartbeat);
        }
    });
    read.map_err(|error| format!("{}: {error}", study.folder.join(heartbeats::HEARTBEATS_FILE).display()))?;
    let earlier = |node: u16| before.iter().find(|earlier| earlier.node == node);
    Ok(all.values().map(|news| node_state(news, earlier(news.node), limits, now_s)).collect())
}
