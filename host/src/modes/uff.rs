//! Modes as universal file datasets 55 ("data at nodes"), real or complex normal modes.
//!
//! Between lines of `-1` stands a dataset, its number first; others than 55 are read over. Of a dataset 55: five lines of
//! text; record 6 (model type, analysis type 2 for normal and 3 or 7 for complex modes, data characteristic, specific
//! type, data type 2 real or 5 complex, values a node); record 7 (integers, the mode number the fourth of them, or the
//! last before); record 8 (frequency, modal mass and damping, or for complex modes the eigenvalue); then for each node its
//! label and its values. A node's label and direction name a channel or a point: `12x`, `12y`, `12z` (also `12X`, `12:+x`). Where no channel
//! is named so, nodes 1, 2 and so on are the places of the study's sensors as [`super::nodes`] numbers them, else its channels in their order.

use std::collections::BTreeSet;
use std::path::Path;

use num_complex::Complex64;

use super::channel::known_channels;
use super::error::MeasuredError;
use super::nodes::numbered;
use super::shape::{RawComponent, RawMode};
use crate::numbers::fortran;
use crate::study::Sensor;

const DIRECTIONS: [&str; 3] = ["x", "y", "z"];
const NORMAL_MODE: i64 = 2;
const COMPLEX_MODES: [i64; 2] = [3, 7];
const COMPLEX_DATA: [i64; 2] = [5, 6];
/// More real numbers than this no mode's record 8 has.
const MOST_REALS: usize = 100;

pub(super) fn modes(
    path: &Path,
    text: &str,
    sensors: &[Sensor],
    warnings: &mut Vec<String>,
) -> Result<Vec<RawMode>, MeasuredError> {
    let nodal = nodal_modes(path, text)?;
    let named = NodeNames::of(&nodal, sensors);
    let numbered = match &named {
        NodeNames::Named(_) => None,
        NodeNames::ByPlace(numbers) => {
            Some(("places of sensors", numbers.iter().map(|(node, ..)| *node).max().unwrap_or(0)))
        }
        NodeNames::InOrder(directions) => Some(("channels", directions.len() as i64)),
    };
    if let Some((what, last)) = numbered {
        warnings.push(format!(
            "{}: nodes 1 to {last} are taken for the study's {what} in their order, as no channel is named by node and direction (12x)",
            path.display()
        ));
    }
    nodal
        .into_iter()
        .map(|mode| {
            let mut components = Vec::new();
            for (node, values) in &mode.values {
                for (direction, value) in values.iter().enumerate() {
                    match named.sensor(*node, direction) {
                        Some(sensor) => {
                            components.push(RawComponent { sensor, value: *value, std: None, scatter: Vec::new() })
                        }
                        // A direction that nothing measured is written as zero.
                        None if value.norm_sqr() == 0.0 => {}
                        None => {
                            return Err(MeasuredError::UnknownNode {
                                file: path.to_owned(),
                                node: *node,
                                direction: DIRECTIONS[direction],
                                known: known_channels(sensors),
                            });
                        }
                    }
                }
            }
            Ok(RawMode {
                modal_mass: mode.modal_mass,
                scatter: None,
                number: mode.number,
                frequency_hz: mode.frequency_hz,
                frequency_std_hz: None,
                stated: None,
                damping_ratio: Some(mode.damping_ratio),
                damping_ratio_std: None,
                components,
            })
        })
        .collect()
}

/// Names of all places at which some mode moves: node and direction, such as `12x`.
pub(super) fn places(path: &Path, text: &str) -> Result<Vec<String>, MeasuredError> {
    let modes = nodal_modes(path, text)?;
    let places: BTreeSet<(i64, usize)> = moving(&modes).collect();
    Ok(places.into_iter().map(|(node, direction)| format!("{node}{}", DIRECTIONS[direction])).collect())
}

fn nodal_modes(path: &Path, text: &str) -> Result<Vec<NodalMode>, MeasuredError> {
    let mut lines = Lines { path, lines: text.lines().collect(), next: 0 };
    let mut nodal: Vec<NodalMode> = Vec::new();
    while let Some(line) = lines.take() {
        if line.trim() != "-1" {
            continue;
        }
        let Some(dataset) = lines.take() else { break };
        match dataset.trim() {
            "55" => nodal.extend(lines.dataset_55(nodal.len() + 1)?),
            "2414" => {
                return Err(lines.syntax("dataset 2414 is not read; export the modes as dataset 55"));
            }
            _ => lines.skip_dataset(),
        }
    }
    Ok(nodal)
}

/// A mode at nodes: translations along x, y, z.
struct NodalMode {
    number: usize,
    frequency_hz: f64,
    damping_ratio: f64,
    /// Above 0, where the file states one.
    modal_mass: Option<f64>,
    values: Vec<(i64, [Complex64; 3])>,
}

/// Which sensor a node and direction is.
enum NodeNames {
    /// By names.
    Named(Vec<(i64, usize, usize)>),
    /// By the numbers that places get where Belfry writes such a file.
    ByPlace(Vec<(i64, usize, usize)>),
    /// Nodes 1 to p, one direction each, for p sensors.
    InOrder(Vec<usize>),
}

impl NodeNames {
    fn of(modes: &[NodalMode], sensors: &[Sensor]) -> Self {
        let named: Vec<(i64, usize, usize)> = sensors
            .iter()
            .enumerate()
            .filter_map(|(index, sensor)| {
                let (node, direction) =
                    node_and_direction(&sensor.channel).or_else(|| node_and_direction(&sensor.point))?;
                Some((node, direction, index))
            })
            .collect();
        if !named.is_empty() {
            return Self::Named(named);
        }
        if let Some(numbers) = by_place(modes, sensors) {
            return Self::ByPlace(numbers);
        }
        let in_order = modes.first().and_then(|first| {
            let labels_fit = first.values.len() == sensors.len()
                && (1..).zip(&first.values).all(|(label, (node, _))| label == *node);
            labels_fit.then_some(())?;
            let direction_of = |node: i64| {
                let moves = |direction: &usize| {
                    modes
                        .iter()
                        .flat_map(|mode| &mode.values)
                        .any(|(other, values)| *other == node && values[*direction].norm_sqr() > 0.0)
                };
                let mut moving = (0..3).filter(moves);
                moving.next().filter(|_| moving.next().is_none())
            };
            first.values.iter().map(|(node, _)| direction_of(*node)).collect::<Option<Vec<usize>>>()
        });
        in_order.map_or(Self::Named(Vec::new()), Self::InOrder)
    }

    fn sensor(&self, node: i64, direction: usize) -> Option<usize> {
        match self {
            Self::Named(named) | Self::ByPlace(named) => named
                .iter()
                .find(|(label, along, _)| (*label, *along) == (node, direction))
                .map(|(_, _, sensor)| *sensor),
            Self::InOrder(directions) => {
                let index = usize::try_from(node).ok()?.checked_sub(1)?;
                (directions.get(index) == Some(&direction)).then_some(index)
            }
        }
    }
}

/// Numbers of the sensors' places, where several sensors share one, and the file has these nodes and moves them along these directions alone.
fn by_place(modes: &[NodalMode], sensors: &[Sensor]) -> Option<Vec<(i64, usize, usize)>> {
    let numbered = numbered(&sensors.iter().collect::<Vec<_>>(), 1, &mut Vec::new());
    let nodes: BTreeSet<i64> = numbered.iter().map(|one| one.node).collect();
    if nodes.len() == sensors.len() {
        return None;
    }
    let of_file: BTreeSet<i64> = modes.first()?.values.iter().map(|(node, _)| *node).collect();
    let expected: BTreeSet<(i64, usize)> = numbered.iter().map(|one| (one.node, one.axis)).collect();
    let moving: BTreeSet<(i64, usize)> = moving(modes).collect();
    let numbers = || numbered.iter().zip(0..).map(|(one, sensor)| (one.node, one.axis, sensor));
    (of_file == nodes && moving == expected).then(|| numbers().collect())
}

/// Nodes and the directions in which they move in some mode.
fn moving(modes: &[NodalMode]) -> impl Iterator<Item = (i64, usize)> {
    modes.iter().flat_map(|mode| &mode.values).flat_map(|(node, values)| {
        let moves = (0..3).filter(|&direction| values[direction].norm_sqr() > 0.0);
        moves.map(|direction| (*node, direction))
    })
}

/// `12x`, `12X`, `12:x`, `12:+X`.
pub(crate) fn node_and_direction(name: &str) -> Option<(i64, usize)> {
    let lower = name.to_ascii_lowercase();
    let direction = DIRECTIONS.iter().position(|direction| lower.ends_with(direction))?;
    let label = lower.get(..lower.len() - 1)?.trim_end_matches(['+', ':', ' ']);
    Some((label.parse().ok()?, direction))
}

struct Lines<'a> {
    path: &'a Path,
    lines: Vec<&'a str>,
    next: usize,
}

impl<'a> Lines<'a> {
    fn take(&mut self) -> Option<&'a str> {
        let line = self.lines.get(self.next).copied();
        self.next += 1;
        line
    }

    fn syntax(&self, reason: &str) -> MeasuredError {
        MeasuredError::Syntax { file: self.path.to_owned(), line: self.next as u64, reason: reason.to_owned() }
    }

    fn skip_dataset(&mut self) {
        while self.take().is_some_and(|line| line.trim() != "-1") {}
    }

    fn integers(&mut self, least: usize, what: &str) -> Result<Vec<i64>, MeasuredError> {
        let line = self.take().unwrap_or("");
        let numbers: Option<Vec<i64>> = line.split_whitespace().map(|word| word.parse().ok()).collect();
        numbers.filter(|numbers| numbers.len() >= least).ok_or_else(|| {
            self.syntax(&format!("expected {what}, at least {least} whole numbers, found `{}`", line.trim()))
        })
    }

    /// Numbers over as many lines as they take; Fortran's D exponents are read too.
    fn numbers(&mut self, count: usize, what: &str) -> Result<Vec<f64>, MeasuredError> {
        let mut numbers = Vec::new();
        while numbers.len() < count {
            let line = self.take().filter(|line| line.trim() != "-1");
            let line = line.ok_or_else(|| self.syntax(&format!("the dataset ends where {what} was expected")))?;
            for word in line.split_whitespace() {
                let number = fortran(word);
                numbers.push(number.ok_or_else(|| self.syntax(&format!("`{word}` is no number ({what})")))?);
            }
        }
        Ok(numbers)
    }

    /// `None` for a dataset that holds no mode.
    fn dataset_55(&mut self, position: usize) -> Result<Option<NodalMode>, MeasuredError> {
        for _ in 0..5 {
            let text = self.take().filter(|line| line.trim() != "-1");
            text.ok_or_else(|| self.syntax("the dataset ends within its five lines of text"))?;
        }
        let kinds = self.integers(6, "model, analysis, data characteristic, specific, data type and values a node")?;
        let (analysis, data_type) = (kinds[1], kinds[4]);
        let is_complex_mode = COMPLEX_MODES.contains(&analysis);
        if analysis != NORMAL_MODE && !is_complex_mode {
            self.skip_dataset();
            return Ok(None);
        }
        let values_a_node = usize::try_from(kinds[5]).ok().filter(|count| (1..=6).contains(count));
        let values_a_node = values_a_node.ok_or_else(|| self.syntax("expected 1 to 6 values a node"))?;
        let complex = COMPLEX_DATA.contains(&data_type);
        let specifics = self.integers(4, "counts, load case and mode number")?;
        let number = usize::try_from(specifics[3]).ok().filter(|&number| number > 0).unwrap_or(position);
        let counted = usize::try_from(specifics[1]).unwrap_or(0).max(if is_complex_mode { 2 } else { 1 });
        if counted > MOST_REALS {
            return Err(self.syntax(&format!("{counted} numbers of a mode are announced, where a few are expected")));
        }
        let reals = self.numbers(counted, "frequency and damping")?;
        let (frequency_hz, damping_ratio) = if is_complex_mode {
            // The eigenvalue s: |s| is the undamped circular frequency.
            let eigenvalue = Complex64::new(reals[0], reals[1]);
            let circular = eigenvalue.norm();
            (circular / std::f64::consts::TAU, if circular > 0.0 { -eigenvalue.re / circular } else { 0.0 })
        } else {
            (reals[0], reals.get(2).copied().unwrap_or(0.0))
        };
        let mut values = Vec::new();
        loop {
            let line = self.take().ok_or_else(|| self.syntax("the file is cut off: it ends within a dataset"))?;
            if line.trim() == "-1" {
                break;
            }
            let label = line.split_whitespace().next().and_then(|word| word.parse::<i64>().ok());
            let label =
                label.ok_or_else(|| self.syntax(&format!("expected a node's label, found `{}`", line.trim())))?;
            let per_value = if complex { 2 } else { 1 };
            let numbers = self.numbers(values_a_node * per_value, "a node's values")?;
            let mut translations = [Complex64::ZERO; 3];
            for (place, value) in translations.iter_mut().zip(numbers.chunks(per_value)) {
                *place = Complex64::new(value[0], value.get(1).copied().unwrap_or(0.0));
            }
            values.push((label, translations));
        }
        let stated = reals.get(1).copied().filter(|mass| !is_complex_mode && *mass > 0.0 && mass.is_finite());
        Ok(Some(NodalMode { number, frequency_hz, damping_ratio, modal_mass: stated, values }))
    }
}
