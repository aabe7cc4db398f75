//! Channels whose gain drifts over the record.
//!
//! Modes, and what was seen of the gains, flow in; modes whose deviations know of it flow out.

use super::result::Mode;
use super::ssi::component_of_mut;
use crate::study::Setup;

/// A channel's components are means over the record. When its gain was right nobody knows: they are off by half of its change at most, where
/// it was right at some time, and that much is their standard deviation besides.
const OFF: f64 = 0.5;

/// A channel whose gain drifts.
#[derive(Debug, Clone, PartialEq)]
pub struct Drift {
    /// The channel, in the setup's order; behind it those of which it may be one as well, for they move much as it does.
    pub channels: Vec<usize>,
    /// By how much the gain changes from the record's beginning to its end: 0.1 for a tenth more.
    pub change: f64,
}

/// Widens the deviations of shapes at a setup's channels whose gains drift.
pub fn widen_drifting(modes: &mut [Mode], setup: &Setup, drifts: &[Drift]) {
    let channels = drifts.iter().flat_map(|drift| drift.channels.iter().map(|&channel| (channel, drift.change)));
    for (channel, change) in channels {
        let Some(sensor) = setup.sensors.get(channel) else { continue };
        for mode in modes.iter_mut() {
            if let Some(component) = component_of_mut(&mut mode.shape, &setup.name, sensor) {
                component.std = component.std.hypot(OFF * change * component.re);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::ShapeComponent;
    use crate::identify::accuracy::tests::found;
    use crate::study::{Study, template};

    #[test]
    fn the_channel_that_drifts_is_as_uncertain_as_half_of_its_change() {
        let study = Study::from_text(template::CANTON_STUDY, std::path::Path::new(".")).unwrap();
        let setup = &study.setups[0];
        let component = |sensor: &crate::study::Sensor| ShapeComponent {
            channel: sensor.channel.clone(),
            point: sensor.point.clone(),
            re: -0.4,
            im: 0.1,
            std: 0.03,
        };
        let mut modes = vec![found().modes.remove(0)];
        modes[0].shape = setup.sensors.iter().map(component).collect();
        widen_drifting(&mut modes, setup, &[Drift { channels: vec![2], change: -0.2 }]);
        for (index, component) in modes[0].shape.iter().enumerate() {
            let std = if index == 2 { 0.05 } else { 0.03 };
            assert!((component.std - std).abs() < 1e-12, "{index}: {}", component.std);
        }
        // A channel that the study has not is no reason to stop.
        widen_drifting(&mut modes, setup, &[Drift { channels: vec![99], change: 0.5 }]);
    }
}
