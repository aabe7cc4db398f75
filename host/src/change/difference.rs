//! The difference of a mode in two measurements, as numbers with their covariance.

use nalgebra::{Cholesky, DMatrix, DVector};

use crate::compare::{ChiSquared, Errors, complement, shape_deviations};
use crate::modes::{CLOSE, MeasuredCovarianceFactor, MeasuredMode, MeasuredShape};

/// Numbers `[ln f_now - ln f_before ; Nᵀ phi_now]` of a pair, with N the orthogonal complement of the shape before; of a mode among close
/// ones, of the span of these before, in which shapes turn at the slightest change.
#[derive(Debug, Clone)]
pub(crate) struct Difference {
    /// Index of the mode before.
    pub(crate) before: usize,
    /// Index of the mode now.
    pub(crate) now: usize,
    /// What has changed.
    pub(crate) numbers: DVector<f64>,
    /// Its covariance by the errors of both measurements.
    pub(crate) covariance: DMatrix<f64>,
    /// The shapes, where both measurements have them at enough sensors.
    pub(crate) shape: Option<ShapeDifference>,
}

/// How a shape has changed.
#[derive(Debug, Clone)]
pub(crate) struct ShapeDifference {
    /// The sensors that both measurements have.
    pub(crate) sensors: Vec<usize>,
    /// The modes before that span it, its own first; at these sensors, shapes of unit length.
    pub(crate) spanned_by: Vec<(usize, MeasuredMode)>,
    /// The combination of them that is nearest to the shape now.
    pub(crate) combination: DVector<f64>,
    /// What that leaves of the shape now, which is of unit length.
    pub(crate) moved: DVector<f64>,
    /// Now at these sensors, its shape of unit length.
    pub(crate) now: MeasuredMode,
}

/// Whether two pairs (indices before and now) are of close modes, in either measurement.
pub(super) fn is_close(
    before: &[MeasuredMode],
    now: &[MeasuredMode],
    one: (usize, usize),
    other: (usize, usize),
) -> bool {
    let near = |a: &MeasuredMode, b: &MeasuredMode| (a.frequency_hz / b.frequency_hz).ln().abs() < CLOSE;
    near(&before[one.0], &before[other.0]) || near(&now[one.1], &now[other.1])
}

impl Difference {
    /// Of a pair (indices before and now) in a group of close ones, itself included.
    pub(super) fn of(
        before: &[MeasuredMode],
        now: &[MeasuredMode],
        pair: (usize, usize),
        group: &[(usize, usize)],
    ) -> Self {
        let (one, other) = (&before[pair.0], &now[pair.1]);
        let shape = ShapeDifference::of(before, other, pair.0, group);
        let across = shape.as_ref().and_then(|shape| complement(&shape.span()));
        let shape = shape.filter(|_| across.is_some());
        let across = across.unwrap_or_else(|| DMatrix::zeros(0, 0));
        let size = 1 + across.ncols();
        let mut numbers = DVector::zeros(size);
        numbers[0] = (other.frequency_hz / one.frequency_hz).ln();
        let mut covariance = DMatrix::zeros(size, size);
        // How the numbers follow the errors of a mode: of its frequency, and of its shape.
        let mut add = |mode: &MeasuredMode, by_frequency: f64, by_shape: f64| {
            let errors = Errors::of(mode, mode.shape.as_ref().filter(|_| size > 1));
            let mut follows = DMatrix::zeros(size, errors.own.len());
            follows[(0, 0)] = by_frequency;
            if size > 1 {
                let mut of_shape = follows.view_mut((1, 1), (size - 1, errors.own.len() - 1));
                of_shape.copy_from(&(across.transpose() * by_shape));
            }
            let joint = &follows * &errors.joint;
            covariance +=
                &follows * DMatrix::from_diagonal(&errors.own) * follows.transpose() + &joint * joint.transpose();
        };
        match &shape {
            Some(shape) => {
                numbers.rows_mut(1, size - 1).copy_from(&across.tr_mul(&shape.moved));
                add(&shape.now, 1.0, 1.0);
                for (at, ((index, mode), by)) in shape.spanned_by.iter().zip(shape.combination.iter()).enumerate() {
                    debug_assert!(at > 0 || *index == pair.0);
                    add(mode, if at == 0 { -1.0 } else { 0.0 }, -by);
                }
            }
            None => {
                add(other, 1.0, 0.0);
                add(one, -1.0, 0.0);
            }
        }
        Self { before: pair.0, now: pair.1, numbers, covariance, shape }
    }

    /// The relative standard deviation of the frequency's change.
    pub(crate) fn frequency_std(&self) -> f64 {
        self.covariance[(0, 0)].sqrt()
    }

    /// Squares of the frequency's difference, in deviations.
    pub(super) fn of_frequency(&self) -> f64 {
        self.numbers[0].powi(2) / self.covariance[(0, 0)]
    }

    /// Squares of the shape's difference, in deviations, with how many numbers they are of; `None` without a shape.
    pub(super) fn of_shape(&self) -> Option<(f64, usize)> {
        let count = self.numbers.len() - 1;
        (count > 0).then_some(())?;
        let factor = Cholesky::new(self.covariance.view((1, 1), (count, count)).into_owned())?;
        let numbers = self.numbers.rows(1, count);
        Some((numbers.dot(&factor.solve(&numbers)), count))
    }

    /// The test whether this mode has changed.
    pub(super) fn test(&self) -> ChiSquared {
        let size = self.numbers.len();
        match Cholesky::new(self.covariance.clone()) {
            Some(factor) => ChiSquared::of(self.numbers.dot(&factor.solve(&self.numbers)), size),
            None => ChiSquared::of(self.of_frequency(), 1),
        }
    }

    /// The mode as a structure would show it now that had the frequency `frequency_hz` before and at the sensors the shapes `images` (one
    /// for each of those that span it): both moved as measured, with the deviations of both measurements.
    pub(crate) fn moved_from(&self, now: &MeasuredMode, frequency_hz: f64, images: &[DVector<f64>]) -> MeasuredMode {
        let moved_hz = frequency_hz * self.numbers[0].exp();
        let mut mode = MeasuredMode {
            frequency_hz: moved_hz,
            frequency_std_hz: Some(self.frequency_std() * moved_hz),
            damping_ratio: None,
            damping_ratio_std: None,
            stated: now.stated.clone(),
            shape: None,
            covariance_factor: None,
            number: now.number,
        };
        let Some(shape) = self.shape.as_ref().filter(|shape| shape.spanned_by.len() == images.len()) else {
            return mode;
        };
        let by = || shape.combination.iter();
        let mut values = shape.moved.clone();
        for (image, by) in images.iter().zip(by()) {
            values.axpy(*by, image, 1.0);
        }
        let squares = |mode: &MeasuredMode| {
            let deviations = mode.shape.as_ref().map(shape_deviations).unwrap_or_default();
            DVector::from_vec(deviations).map(|deviation| deviation * deviation)
        };
        let mut variances = squares(&shape.now);
        for ((_, before), by) in shape.spanned_by.iter().zip(by()) {
            variances.axpy(by * by, &squares(before), 1.0);
        }
        let imaginary = |mode: &MeasuredMode| mode.shape.as_ref().and_then(|shape| shape.imaginary.clone());
        let own = &shape.spanned_by[0].1;
        let late = |now: DVector<f64>, before: DVector<f64>| now - before * shape.combination[0];
        mode.covariance_factor = shape.joint().map(|(frequency, of_shape)| MeasuredCovarianceFactor {
            group: self.now,
            frequency_hz: frequency.row(0) * moved_hz,
            shape: of_shape,
        });
        mode.shape = Some(MeasuredShape {
            sensors: shape.sensors.clone(),
            values,
            imaginary: imaginary(&shape.now).zip(imaginary(own)).map(|(now, before)| late(now, before)),
            stds: Some(variances.map(f64::sqrt)),
        });
        mode
    }
}

impl ShapeDifference {
    /// `None` where one of the measurements has no shape, or too few sensors in common.
    fn of(before: &[MeasuredMode], now: &MeasuredMode, own: usize, group: &[(usize, usize)]) -> Option<Self> {
        before[own].shape.as_ref()?;
        let others = group.iter().map(|(index, _)| *index).filter(|&index| index != own);
        let spanning: Vec<usize> =
            std::iter::once(own).chain(others.filter(|&index| before[index].shape.is_some())).collect();
        let has = |mode: &MeasuredMode, sensor: usize| mode.shape.as_ref().is_some_and(|s| s.sensors.contains(&sensor));
        let is_common = |sensor: usize| has(now, sensor) && spanning.iter().all(|&index| has(&before[index], sensor));
        let now = unit_length(now.at_sensors(&is_common))?;
        let spanned_by =
            spanning.iter().map(|&index| Some((index, unit_length(before[index].at_sensors(&is_common))?)));
        let spanned_by: Vec<(usize, MeasuredMode)> = spanned_by.collect::<Option<_>>()?;
        let shape = now.shape.as_ref()?;
        let (sensors, values) = (shape.sensors.clone(), shape.values.clone());
        if spanned_by.len() >= sensors.len() {
            return None;
        }
        let mut difference = Self { sensors, spanned_by, combination: DVector::zeros(0), moved: values.clone(), now };
        let span = difference.span();
        let decomposition = span.clone().svd(true, true);
        let values_of = &decomposition.singular_values;
        let is_span = values_of.min() > ALIKE * values_of.max();
        is_span.then_some(())?;
        difference.combination = decomposition.solve(&values, 0.0).ok()?;
        difference.moved = values - span * &difference.combination;
        Some(difference)
    }

    /// The shapes before, sensors x modes.
    fn span(&self) -> DMatrix<f64> {
        let shapes = self.spanned_by.iter().filter_map(|(_, mode)| mode.shape.as_ref());
        DMatrix::from_columns(&shapes.map(|shape| shape.values.clone()).collect::<Vec<_>>())
    }

    /// What the errors of frequency and shape have in common, as rows whose products are covariances: those of now beside those of its own
    /// mode before; `None` where no measurement states them.
    fn joint(&self) -> Option<(DMatrix<f64>, DMatrix<f64>)> {
        let of = |mode: &MeasuredMode, sign: [f64; 2]| {
            let mut joint = Errors::of(mode, mode.shape.as_ref()).joint;
            for (row, mut values) in joint.row_iter_mut().enumerate() {
                values *= sign[row.min(1)];
            }
            joint
        };
        let (now, before) = (of(&self.now, [1.0; 2]), of(&self.spanned_by[0].1, [-1.0, -self.combination[0]]));
        let columns = now.ncols();
        (columns + before.ncols() > 0).then_some(())?;
        let mut both = now.clone().resize_horizontally(columns + before.ncols(), 0.0);
        both.columns_mut(columns, before.ncols()).copy_from(&before);
        Some((both.rows(0, 1).into_owned(), both.rows(1, both.nrows() - 1).into_owned()))
    }
}

/// Shapes before whose span is thinner than this, in shares of its length, are one.
const ALIKE: f64 = 0.05;

/// A mode with its shape, deviations and covariances at unit length; `None` without a shape.
fn unit_length(mut mode: MeasuredMode) -> Option<MeasuredMode> {
    let shape = mode.shape.as_mut()?;
    let length = shape.values.norm();
    (length > 0.0 && shape.values.len() > 1).then_some(())?;
    shape.values /= length;
    if let Some(imaginary) = &mut shape.imaginary {
        *imaginary /= length;
    }
    if let Some(stds) = &mut shape.stds {
        *stds /= length;
    }
    if let Some(factor) = &mut mode.covariance_factor {
        factor.shape /= length;
    }
    Some(mode)
}
