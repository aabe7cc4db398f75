//! Where a model fails that is no tower: which sensors stand at which of its groups. A study's groups and sensors flow in, the misfit of each group
//! by that of its sensors flows out.

use crate::compare::{Comparison, GroupMisfit};
use crate::diagnose::{GroupSquare, Unexplained};
use crate::model::{Assembly, Custom, Structure, sides_m};
use crate::study::{Model, Sensor};

/// A group with the channels of the sensors at it.
#[derive(Debug, Clone)]
struct Part {
    group: String,
    channels: Vec<String>,
}

/// The groups of a model that is no tower, in the study's order; empty for a tower.
#[derive(Debug, Clone, Default)]
pub(super) struct Parts(Vec<Part>);

impl Parts {
    /// Those of a model: none where its nodes stand above each other, or it is higher than wide and its groups have heights. The sensors at a
    /// group are those that the study names, else those that see a row with an entry in the group's matrices: of groups that are known by runs
    /// nothing else says where they stand.
    pub(super) fn of(section: &Model, bare: &Structure, assembly: &Assembly, sensors: &[Sensor]) -> Self {
        let groups = || bare.customs.iter().filter(|custom| custom.group.is_some());
        let has_heights = groups().all(|group| group.group.is_some_and(|terms| terms.span_m.is_some()));
        if assembly.is_line() || (has_heights && !is_wide(bare, sensors)) {
            return Self::default();
        }
        let rows: Vec<(&Sensor, Vec<usize>)> =
            sensors.iter().map(|sensor| (sensor, assembly.rows_seen_by(sensor))).collect();
        let part = |group: &Custom| {
            let own = |name: &Option<String>| name.as_ref() == Some(&group.name);
            let of_group = section.customs.iter().filter(|source| source.name == group.name || own(&source.tied_to));
            let named: Vec<&String> = of_group.flat_map(|source| &source.channels).collect();
            let is_at_it = |(sensor, seen): &&(&Sensor, Vec<usize>)| match named.is_empty() {
                true => seen.iter().any(|row| group.touches(*row)),
                false => named.contains(&&sensor.channel),
            };
            let channels = rows.iter().filter(is_at_it).map(|(sensor, _)| sensor.channel.clone()).collect();
            Part { group: group.name.clone(), channels }
        };
        Self(groups().map(part).collect())
    }

    /// The mean over each group's sensors of what each has; groups whose sensors have nothing are left out.
    fn of_each<'a>(&'a self, value: impl Fn(&str) -> Option<f64> + 'a) -> impl Iterator<Item = (String, f64)> + 'a {
        self.0.iter().filter_map(move |Part { group, channels }| {
            let values: Vec<f64> = channels.iter().filter_map(|channel| value(channel)).collect();
            (!values.is_empty()).then(|| (group.clone(), values.iter().sum::<f64>() / values.len() as f64))
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
        let without = self.0.iter().filter(|part| part.channels.is_empty());
        comparison.groups_without_sensors = without.map(|part| part.group.clone()).collect();
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

/// Whether the nodes, or where nothing is known of them the sensors, spread horizontally more than vertically; not where neither has places.
fn is_wide(bare: &Structure, sensors: &[Sensor]) -> bool {
    let nodes = bare.layout();
    let [x_m, y_m, z_m] = if nodes.is_empty() {
        let place_m = |sensor: &Sensor| Some([sensor.offset_m[0], sensor.offset_m[1], sensor.elevation_m?]);
        sides_m(sensors.iter().filter_map(place_m))
    } else {
        sides_m(nodes.iter().map(|node| node.position_m))
    };
    x_m.hypot(y_m) > z_m
}
