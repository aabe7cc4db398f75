//! A calibration in the places where it is kept: in study.toml, by sensor, and in the node, by axis.

use belfry_shared::message::{AxisCalibration, Calibration, Hello};
use belfry_shared::time::HostTime;

use super::fit::{AXES, Axis};
use crate::study::edit::CalibrationEntry;
use crate::study::{Sensor, Setup};

/// What a node is told to keep.
pub fn to_node(axes: &[Axis; 3], now: HostTime) -> Calibration {
    let millionths = |value: f64| (1e6 * value).round();
    let axis = |axis: &Axis| AxisCalibration {
        gain_ppm: millionths(axis.gain - 1.0) as i32,
        gain_std_ppm: millionths(axis.gain_std) as u32,
        offset_um_s2: millionths(axis.offset_m_s2) as i32,
    };
    Calibration { time: now, axes: axes.iter().map(axis).collect() }
}

/// The channels of a node in a setup, in the order of its axes.
fn channels(setup: &Setup, node: u16) -> impl Iterator<Item = &Sensor> {
    setup.sensors.iter().filter(move |sensor| sensor.node == node)
}

/// What study.toml is to say of a node's sensors in these setups.
pub fn from_node(setups: &[&Setup], node: u16, calibration: &Calibration) -> Vec<CalibrationEntry> {
    let entry = |setup: &Setup, sensor: &Sensor, axis: &AxisCalibration| CalibrationEntry {
        setup: setup.name.clone(),
        channel: sensor.channel.clone(),
        gain: axis.gain(),
        gain_std: axis.gain_std(),
        offset_m_s2: axis.offset_m_s2(),
    };
    let of_setup = |setup: &&Setup| -> Vec<CalibrationEntry> {
        channels(setup, node).zip(&calibration.axes).map(|(sensor, axis)| entry(setup, sensor, axis)).collect()
    };
    setups.iter().flat_map(of_setup).collect()
}

/// What study.toml is to say of three channels, as far as they are sensors of these setups.
pub fn entries(setups: &[&Setup], names: [&str; 3], axes: &[Axis; 3]) -> Vec<CalibrationEntry> {
    let of_setup = |setup: &&Setup| -> Vec<CalibrationEntry> {
        let has = |name: &str| setup.sensors.iter().any(|sensor| sensor.channel == name);
        let known = names.into_iter().zip(axes).filter(|(name, _)| has(name));
        known
            .map(|(channel, axis)| CalibrationEntry {
                setup: setup.name.clone(),
                channel: channel.to_owned(),
                gain: axis.gain,
                gain_std: axis.gain_std,
                offset_m_s2: axis.offset_m_s2,
            })
            .collect()
    };
    setups.iter().flat_map(of_setup).collect()
}

/// A gain of a node's and one of study.toml are the same within this.
const ALIKE: f64 = 2e-6;

/// A sentence where a node has a calibration of which study.toml says otherwise, or nothing: then nothing, or something else, is applied.
pub fn differs(setup: &Setup, hello: &Hello) -> Option<String> {
    let calibration = hello.calibration.as_ref()?;
    let other: Vec<String> = channels(setup, hello.node)
        .zip(&calibration.axes)
        .zip(AXES)
        .filter(|((sensor, axis), _)| sensor.gain.is_none_or(|gain| (gain - axis.gain()).abs() > ALIKE))
        .map(|((sensor, axis), name)| {
            let said = sensor.gain.map_or_else(|| "none".to_owned(), |gain| gain.to_string());
            format!("{} ({name}) {:.6} in the node, {said} in study.toml", sensor.channel, axis.gain())
        })
        .collect();
    (!other.is_empty()).then(|| {
        format!(
            "node {} was calibrated, and study.toml, which is what counts, has other gains: {}; `belfry calibrate --read` takes those of the node",
            hello.node,
            other.join("; ")
        )
    })
}
