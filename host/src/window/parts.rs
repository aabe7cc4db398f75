//! Parts of a window: which configuration they can belong to, and how the parts of a whole window are decoded.

use std::collections::BTreeMap;

use belfry_shared::message::{ChannelState, Configuration, NodeMessage, Summary, WindowHead};
use belfry_shared::quantise::{decode_density, decode_lines, encoded_bytes};
use num_complex::Complex32;

use super::node_window::{ChannelData, NodeWindow};

/// Whether a part can belong to a window of the configuration.
pub(super) fn fits(configuration: &Configuration, message: &NodeMessage<'_>) -> bool {
    let in_band = |first_line: u16, count: usize| position(configuration, first_line, count).is_some();
    let is_channel = |channel: u8| channel < configuration.channels;
    match (message, configuration.summary) {
        (NodeMessage::Head(head), _) => head.channels.len() == usize::from(configuration.channels),
        (NodeMessage::Lines(part), Summary::Lines { bits }) => {
            let lines = usize::from(part.lines);
            part.bits == bits
                && lines > 0
                && is_channel(part.channel)
                && in_band(part.first_line, lines)
                && part.code.len() == encoded_bytes(lines, bits)
        }
        (NodeMessage::Density(part), Summary::Psd { .. }) => {
            !part.code.is_empty() && is_channel(part.channel) && in_band(part.first_line, part.code.len())
        }
        (NodeMessage::Peaks(part), Summary::Psd { .. }) => is_channel(part.channel),
        _ => false,
    }
}

/// Position of a run of lines among all bands' lines; `None` where no band holds it.
fn position(configuration: &Configuration, first_line: u16, count: usize) -> Option<usize> {
    let mut before = 0;
    for band in &configuration.bands {
        let offset = first_line.wrapping_sub(band.first_line);
        if first_line >= band.first_line && usize::from(offset) + count <= usize::from(band.lines) {
            return Some(before + usize::from(offset));
        }
        before += usize::from(band.lines);
    }
    None
}

/// Decodes a whole window; `None` where its parts contradict each other or the configuration.
pub(super) fn build(
    configuration: &Configuration,
    head: &WindowHead,
    parts: &BTreeMap<u16, Vec<u8>>,
) -> Option<NodeWindow> {
    let total = configuration.lines();
    let mut channels: Vec<ChannelData> = head
        .channels
        .iter()
        .map(|&state| match (state, configuration.summary) {
            (ChannelState::Sound { .. }, Summary::Lines { .. }) => {
                ChannelData::Lines(vec![Complex32::default(); total])
            }
            (ChannelState::Sound { segments }, Summary::Psd { .. }) => {
                ChannelData::Psd { segments, densities: vec![0.0; total], peaks: Vec::new() }
            }
            (state, _) => ChannelData::Unsound(state),
        })
        .collect();
    let mut filled = vec![0; channels.len()];
    for encoded in parts.values() {
        match belfry_shared::message::decode::<NodeMessage<'_>>(encoded).ok()? {
            NodeMessage::Lines(part) => {
                let count = usize::from(part.lines);
                let start = position(configuration, part.first_line, count)?;
                let ChannelData::Lines(lines) = channels.get_mut(usize::from(part.channel))? else { return None };
                decode_lines(part.code, part.bits, lines.get_mut(start..start + count)?).ok()?;
                filled[usize::from(part.channel)] += count;
            }
            NodeMessage::Density(part) => {
                let start = position(configuration, part.first_line, part.code.len())?;
                let ChannelData::Psd { densities, .. } = channels.get_mut(usize::from(part.channel))? else {
                    return None;
                };
                for (density, &code) in densities.get_mut(start..start + part.code.len())?.iter_mut().zip(part.code) {
                    *density = decode_density(part.base, code);
                }
                filled[usize::from(part.channel)] += part.code.len();
            }
            NodeMessage::Peaks(part) => {
                let ChannelData::Psd { peaks, .. } = channels.get_mut(usize::from(part.channel))? else { return None };
                *peaks = part.peaks.to_vec();
            }
            _ => return None,
        }
    }
    let all_filled = channels
        .iter()
        .zip(&filled)
        .all(|(channel, &filled)| filled == if matches!(channel, ChannelData::Unsound(_)) { 0 } else { total });
    all_filled.then_some(NodeWindow {
        name: head.name,
        configuration_hash: head.configuration_hash,
        grid_index: head.grid_index,
        middle_offset_us: head.middle_offset_us,
        drift_ppb: head.drift_ppb,
        channels,
    })
}
