//! Names in a file of modes and the study's sensors.
//!
//! A name flows in, the sensor that is meant flows out; or the channels that there are, for errors.

use crate::study::Sensor;

/// The sensor that a file calls `name`: by channel, else by point where only one sensor has it.
pub(super) fn sensor_named(sensors: &[Sensor], name: &str) -> Option<usize> {
    sensors.iter().position(|sensor| sensor.channel == name).or_else(|| {
        let mut at_point = (0..sensors.len()).filter(|&index| sensors[index].point == name);
        at_point.next().filter(|_| at_point.next().is_none())
    })
}

/// The channels there are, in words.
pub(super) fn known_channels(sensors: &[Sensor]) -> String {
    if sensors.is_empty() {
        return "none: give the study its [[sensor]]s".to_owned();
    }
    sensors.iter().map(|sensor| sensor.channel.as_str()).collect::<Vec<_>>().join(", ")
}
