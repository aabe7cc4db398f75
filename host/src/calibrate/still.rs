//! Still intervals: when the sensor lay untouched, and which of its faces was up.

use super::fit::AXES;

/// Readings of a second or so, in m/s².
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cell {
    /// How long it is, in s.
    pub seconds: f64,
    /// Mean of each axis.
    pub mean_m_s2: [f64; 3],
    /// Variance of each axis about that mean.
    pub variance: [f64; 3],
}

/// A face, by the axis that points up when the sensor lies there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Face {
    /// The axis, from 0.
    pub axis: usize,
    /// Whether it points up; else down.
    pub is_up: bool,
}

impl Face {
    /// All six.
    pub const ALL: [Self; 6] = [
        Self { axis: 0, is_up: true },
        Self { axis: 0, is_up: false },
        Self { axis: 1, is_up: true },
        Self { axis: 1, is_up: false },
        Self { axis: 2, is_up: true },
        Self { axis: 2, is_up: false },
    ];

    /// 1 where the axis points up: at rest it then reads gravity. Else -1.
    pub fn sign(self) -> f64 {
        if self.is_up { 1.0 } else { -1.0 }
    }
}

impl std::fmt::Display for Face {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let sign = if self.is_up { '+' } else { '-' };
        write!(formatter, "{sign}{}", AXES.get(self.axis).unwrap_or(&"?"))
    }
}

/// A time for which the sensor lay still.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Still {
    /// The face that was up.
    pub face: Face,
    /// How long, in s.
    pub seconds: f64,
    /// Mean of each axis in m/s².
    pub mean_m_s2: [f64; 3],
    /// Standard deviation of each mean, by how the means of its cells scatter.
    pub std_m_s2: [f64; 3],
}

/// The least time on a face, in s.
pub(super) const LEAST_S: f64 = 5.0;
/// A cell in which an axis scatters by more was moved or knocked: the sensor's own noise is 3.5 mm/s² over 250 Hz, and hands make a hundred times that.
const MOST_STD_M_S2: f64 = 0.1;
/// Nor do means of cells differ from the first of their interval by more while it lies still.
const MOST_STEP_M_S2: f64 = 0.02;
/// Cosine of 20 degrees: beyond that the sensor lies on no face.
const LEAST_COSINE: f64 = 0.94;
/// Sensitivity is up to 8 % off and offset 75 mg: what lies still reads gravity within this share.
const NEAR_GRAVITY: f64 = 0.25;
/// Readings come in steps: no mean is better known.
const LEAST_STD_M_S2: f64 = 3e-5;

/// The still intervals among cells that follow each other, where gravity is `gravity_m_s2`. An interval's first and last cell may have been moved in
/// part, and are left out.
pub fn still(cells: &[Cell], gravity_m_s2: f64) -> Vec<Still> {
    let is_quiet = |cell: &Cell| {
        cell.mean_m_s2.iter().chain(&cell.variance).all(|value| value.is_finite())
            && cell.variance.iter().all(|variance| *variance <= MOST_STD_M_S2 * MOST_STD_M_S2)
    };
    let goes_on = |first: &Cell, cell: &Cell| {
        let steps = first.mean_m_s2.iter().zip(cell.mean_m_s2).map(|(first, mean)| (mean - first).abs());
        is_quiet(cell) && steps.fold(0.0, f64::max) <= MOST_STEP_M_S2
    };
    let mut found = Vec::new();
    let mut rest = cells;
    while let Some((first, after)) = rest.split_first() {
        if !is_quiet(first) {
            rest = after;
            continue;
        }
        // Of the second cell on, as the first may still be settling.
        let reference = after.first().unwrap_or(first);
        let length = 1 + after.iter().take_while(|cell| goes_on(reference, cell)).count();
        let (interval, later) = rest.split_at(length);
        if let Some(still) = interval.get(1..length.saturating_sub(1)).and_then(|inner| lying(inner, gravity_m_s2)) {
            found.push(still);
        }
        rest = later;
    }
    found
}

/// What cells say that lay still; `None` where they are too short, or lie on no face.
fn lying(cells: &[Cell], gravity_m_s2: f64) -> Option<Still> {
    let seconds: f64 = cells.iter().map(|cell| cell.seconds).sum();
    if seconds < LEAST_S || cells.len() < 3 {
        return None;
    }
    let count = cells.len() as f64;
    let mean_m_s2: [f64; 3] =
        std::array::from_fn(|axis| cells.iter().map(|cell| cell.mean_m_s2[axis] * cell.seconds).sum::<f64>() / seconds);
    let std_m_s2 = std::array::from_fn(|axis| {
        let squares: f64 = cells.iter().map(|cell| (cell.mean_m_s2[axis] - mean_m_s2[axis]).powi(2)).sum();
        (squares / (count - 1.0) / count).sqrt().max(LEAST_STD_M_S2)
    });
    let size = mean_m_s2.iter().map(|mean| mean * mean).sum::<f64>().sqrt();
    let face = Face::ALL.into_iter().find(|face| face.sign() * mean_m_s2[face.axis] >= LEAST_COSINE * size)?;
    ((size / gravity_m_s2 - 1.0).abs() <= NEAR_GRAVITY).then_some(Still { face, seconds, mean_m_s2, std_m_s2 })
}

/// For how many seconds each face was up, in the order of [`Face::ALL`].
pub fn faces_of(still: &[Still]) -> [f64; 6] {
    Face::ALL.map(|face| still.iter().filter(|one| one.face == face).map(|one| one.seconds).sum())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cell(mean_m_s2: [f64; 3], std: f64) -> Cell {
        Cell { seconds: 1.0, mean_m_s2, variance: [std * std; 3] }
    }

    #[test]
    fn times_on_a_face_are_found_and_what_was_moved_is_not_in_them() {
        let mut cells = vec![cell([0.1, -0.1, 9.7], 3e-3); 10];
        // Half in the hand, then on the other side, where it is knocked once.
        cells.push(cell([3.0, 2.0, 8.0], 2.0));
        cells.extend(vec![cell([0.1, 0.1, -9.9], 3e-3); 8]);
        cells.push(cell([0.1, 0.1, -9.9], 0.5));
        cells.extend(vec![cell([0.1, 0.1, -9.9], 3e-3); 4]);
        // On an edge.
        cells.extend(vec![cell([6.9, 0.0, 6.9], 3e-3); 20]);
        let found = still(&cells, 9.81);
        let told: Vec<(String, f64)> = found.iter().map(|one| (one.face.to_string(), one.seconds)).collect();
        assert_eq!(told, [("+Z".to_owned(), 8.0), ("-Z".to_owned(), 6.0)]);
        let mut means = found[0].mean_m_s2.iter().zip([0.1, -0.1, 9.7]);
        assert!(means.all(|(mean, expected)| (mean - expected).abs() < 1e-12), "{found:?}");
        assert_eq!(faces_of(&found), [0.0, 0.0, 0.0, 0.0, 8.0, 6.0]);
    }

    #[test]
    fn a_sensor_that_creeps_or_falls_or_gives_nothing_lies_still_never() {
        let creeping: Vec<Cell> = (0..40).map(|second| cell([0.0, 0.01 * f64::from(second), 9.8], 3e-3)).collect();
        assert!(still(&creeping, 9.81).is_empty());
        assert!(still(&vec![cell([0.0, 0.0, 0.3], 3e-3); 40], 9.81).is_empty());
        assert!(still(&vec![cell([f64::NAN; 3], 3e-3); 40], 9.81).is_empty());
        assert!(still(&[], 9.81).is_empty());
        assert!(still(&[cell([0.0, 0.0, 9.8], 3e-3)], 9.81).is_empty());
    }
}
