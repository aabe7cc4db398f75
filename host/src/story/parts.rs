//! Where a model fails that is no tower: which sensors see which of its groups. A study's groups and sensors flow in, the misfit of each group by
//! that of its sensors flows out.

use crate::compare::{Comparison, GroupMisfit};
use crate::diagnose::{GroupSquare, Unexplained};
use crate::model::{Assembly, Custom, LayoutNode, LoadedModel, sides_m};
use crate::study::Sensor;

/// The groups of a model that is no tower, each with the channels at its nodes, in the study's order; empty for a tower.
#[derive(Debug, Clone, Default)]
pub(super) struct Parts(Vec<(String, Vec<String>)>);

impl Parts {
    /// Those of a model: none where its nodes stand above each other, or it is higher than wide and its groups have heights.
    pub(super) fn of(model: &LoadedModel, assembly: &Assembly, sensors: &[Sensor]) -> Self {
        let groups = || model.customs.iter().filter(|custom| custom.group.is_some());
        let has_heights = groups().all(|group| group.group.is_some_and(|terms| terms.span_m.is_some()));
        if assembly.is_line() || (has_heights && !is_wide(&model.bare().layout())) {
            return Self::default();
        }
        let rows: Vec<(&Sensor, Vec<usize>)> =
            sensors.iter().map(|sensor| (sensor, assembly.rows_seen_by(sensor))).collect();
        let part = |group: &Custom| {
            let at_it = rows.iter().filter(|(_, seen)| seen.iter().any(|row| group.touches(*row)));
            (group.name.clone(), at_it.map(|(sensor, _)| sensor.channel.clone()).collect::<Vec<String>>())
        };
        Self(groups().map(part).filter(|(_, channels)| !channels.is_empty()).collect())
    }

    /// The mean over each group's sensors of what each has; groups whose sensors have nothing are left out.
    fn of_each<'a>(&'a self, value: impl Fn(&str) -> Option<f64> + 'a) -> impl Iterator<Item = (String, f64)> + 'a {
        self.0.iter().filter_map(move |(name, channels)| {
            let values: Vec<f64> = channels.iter().filter_map(|channel| value(channel)).collect();
            (!values.is_empty()).then(|| (name.clone(), values.iter().sum::<f64>() / values.len() as f64))
        })
    }

    /// Tells a comparison's misfit by group, where there are groups, instead of by height.
    pub(super) fn tell(&self, comparison: &mut Comparison) {
        let square = |channel: &str| {
            let sensor = comparison.by_sensor.iter().find(|sensor| sensor.channel == channel);
            sensor.map(|sensor| sensor.misfit * sensor.misfit)
        };
        let by_group: Vec<GroupMisfit> =
            self.of_each(square).map(|(group, square)| GroupMisfit { group, misfit: square.sqrt() }).collect();
        if !by_group.is_empty() {
            comparison.by_height.clear();
            comparison.by_group = by_group;
        }
    }

    /// The same of what a diagnosis leaves.
    pub(super) fn tell_left(&self, left: &mut Unexplained) {
        let square = |channel: &str| {
            left.by_sensor.iter().find(|sensor| sensor.channel == channel).map(|sensor| sensor.mean_square)
        };
        let by_group: Vec<GroupSquare> =
            self.of_each(square).map(|(group, mean_square)| GroupSquare { group, mean_square }).collect();
        if !by_group.is_empty() {
            left.by_height.clear();
            left.by_group = by_group;
        }
    }
}

/// Whether nodes spread horizontally more than vertically; not where nothing is known of them.
fn is_wide(nodes: &[LayoutNode]) -> bool {
    let [x_m, y_m, z_m] = sides_m(nodes.iter().map(|node| node.position_m));
    x_m.hypot(y_m) > z_m
}
