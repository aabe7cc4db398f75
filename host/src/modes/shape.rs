//! From the components of a file to a real shape.

use std::path::Path;

use nalgebra::{DMatrix, DVector, RowDVector};
use num_complex::Complex64;

use super::error::MeasuredError;
use super::measured::{MeasuredCovarianceFactor, MeasuredMode, MeasuredShape};
use super::stated::StatedMode;
use crate::identify::phase_collinearity;
use crate::study::Sensor;

/// A mode as its file gives it.
pub(super) struct RawMode {
    pub(super) number: usize,
    pub(super) frequency_hz: f64,
    pub(super) frequency_std_hz: Option<f64>,
    pub(super) damping_ratio: Option<f64>,
    pub(super) damping_ratio_std: Option<f64>,
    pub(super) stated: Option<StatedMode>,
    /// Of a computed shape as it is scaled in the file, in kg; above 0.
    pub(super) modal_mass: Option<f64>,
    pub(super) components: Vec<RawComponent>,
    /// Its group and the frequency's row, where the file tells how errors are correlated.
    pub(super) scatter: Option<(usize, Vec<f64>)>,
}

/// A component of a shape.
pub(super) struct RawComponent {
    /// Index into the study's sensors.
    pub(super) sensor: usize,
    /// NaN where it is unknown.
    pub(super) value: Complex64,
    pub(super) std: Option<f64>,
    /// Its row, as long as the frequency's; empty where the file has none.
    pub(super) scatter: Vec<f64>,
}

/// Below this a shape is said to be complex.
const LEAST_COLLINEARITY: f64 = 0.9;

impl RawMode {
    /// `seen`: the sensors at which any mode of the file has a component, so that a mode without one is worth a warning.
    pub(super) fn finish(
        self,
        file: &Path,
        sensors: &[Sensor],
        seen: &[bool],
        warnings: &mut Vec<String>,
    ) -> Result<MeasuredMode, MeasuredError> {
        let number = self.number;
        let real = real_shape(file, number, self.components, sensors, seen, warnings)?;
        let (shape, of_shape) = real.map_or((None, None), |(shape, scatter)| (Some(shape), Some(scatter)));
        if seen.contains(&true) && shape.is_none() {
            warnings.push(format!("{}, mode {number}: no shape, only its frequency is compared", file.display()));
        }
        if self.frequency_std_hz.is_some_and(|std| std <= 0.0) {
            warnings.push(format!(
                "{}, mode {number}: the frequency's deviation is not above 0, so it counts as unknown",
                file.display()
            ));
        }
        let known = |value: Option<f64>| value.filter(|value| value.is_finite() && *value > 0.0);
        Ok(MeasuredMode {
            number,
            frequency_hz: self.frequency_hz,
            frequency_std_hz: known(self.frequency_std_hz),
            damping_ratio: known(self.damping_ratio),
            damping_ratio_std: known(self.damping_ratio_std),
            stated: self.stated,
            shape,
            covariance_factor: self.scatter.map(|(group, row)| MeasuredCovarianceFactor {
                group,
                shape: of_shape.unwrap_or_else(|| DMatrix::zeros(0, row.len())),
                frequency_hz: RowDVector::from_vec(row),
            }),
        })
    }
}

fn real_shape(
    file: &Path,
    number: usize,
    mut components: Vec<RawComponent>,
    sensors: &[Sensor],
    seen: &[bool],
    warnings: &mut Vec<String>,
) -> Result<Option<(MeasuredShape, DMatrix<f64>)>, MeasuredError> {
    let channel = |sensor: usize| sensors.get(sensor).map_or_else(String::new, |sensor| sensor.channel.clone());
    components.sort_by_key(|component| component.sensor);
    if let Some(pair) = components.windows(2).find(|pair| pair[0].sensor == pair[1].sensor) {
        let channel = channel(pair[0].sensor);
        return Err(MeasuredError::ChannelTwice { file: file.to_owned(), number, channel });
    }
    if let Some(infinite) = components.iter().find(|component| component.value.is_infinite()) {
        let channel = channel(infinite.sensor);
        return Err(MeasuredError::Infinite { file: file.to_owned(), number, channel });
    }
    // Unknown in this mode: said to be so, or left out although other modes have it.
    let known: Vec<usize> = components.iter().filter(|c| !c.value.is_nan()).map(|c| c.sensor).collect();
    let said = |sensor: usize| components.iter().any(|component| component.sensor == sensor);
    let unknown: Vec<String> = (0..sensors.len())
        .filter(|sensor| !known.contains(sensor) && (said(*sensor) || seen.get(*sensor) == Some(&true)))
        .map(channel)
        .collect();
    let negative: Vec<String> =
        components.iter().filter(|c| c.std.is_some_and(|std| std < 0.0)).map(|c| channel(c.sensor)).collect();
    components.retain(|component| !component.value.is_nan());
    if components.is_empty() {
        return Ok(None);
    }
    let at = format!("{}, mode {number}", file.display());
    if components.len() == 1 {
        warnings.push(format!("{at}: a component at channel {} alone is no shape", channel(components[0].sensor)));
        return Ok(None);
    }
    if !unknown.is_empty() {
        warnings.push(format!(
            "{at}: the shape has no component at channel {}; the mode is compared at the others",
            unknown.join(", ")
        ));
    }
    if !negative.is_empty() {
        warnings.push(format!(
            "{at}: the deviation at channel {} is negative, so it counts as unknown",
            negative.join(", ")
        ));
    }
    let values: Vec<Complex64> = components.iter().map(|component| component.value).collect();
    // The phase that maximises the sum of squared real parts is half that of the sum of squares.
    let turn = Complex64::cis(-0.5 * values.iter().map(|value| value * value).sum::<Complex64>().arg());
    let real: Vec<f64> = values.iter().map(|value| (value * turn).re).collect();
    let is_complex = values.iter().any(|value| value.im != 0.0);
    let largest = real.iter().copied().max_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap_or(0.0);
    if largest == 0.0 || !largest.is_finite() {
        return Err(MeasuredError::ZeroShape { file: file.to_owned(), number });
    }
    let collinearity = phase_collinearity(&values);
    if collinearity < LEAST_COLLINEARITY {
        warnings.push(format!(
            "{at}: the shape is complex (phase collinearity {collinearity:.2}); only its real part is compared"
        ));
    }
    let size = components.len();
    let stds = components.iter().map(|c| c.std.filter(|std| *std >= 0.0).map_or(f64::NAN, |std| std / largest.abs()));
    let stds = DVector::from_iterator(size, stds);
    let imaginary = values.iter().map(|value| (value * turn).im / largest);
    // The turn is too small to mix in errors of imaginary parts.
    let columns = components.iter().map(|component| component.scatter.len()).min().unwrap_or(0);
    let scatter = DMatrix::from_fn(size, columns, |row, column| turn.re * components[row].scatter[column] / largest);
    let shape = MeasuredShape {
        imaginary: is_complex.then(|| DVector::from_iterator(size, imaginary)),
        sensors: components.iter().map(|component| component.sensor).collect(),
        values: DVector::from_iterator(size, real.iter().map(|value| value / largest)),
        stds: stds.iter().any(|std| std.is_finite()).then_some(stds),
    };
    Ok(Some((shape, scatter)))
}
