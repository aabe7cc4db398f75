//! The summary of many cases: rates, errors, times and the table of confusions, printed.

use std::collections::BTreeMap;

use super::cases::Category;
use super::honesty::Honesty;
use super::score::{CaseRecord, named_set};
use super::structures::NAMES;
use crate::statistics::{quantile, wilson_percent};

/// Bounds of the shifts by which detection is told, as shares of a frequency.
const SHIFTS: [f64; 6] = [0.0, 0.01, 0.02, 0.03, 0.06, f64::INFINITY];
/// Bounds of the deviations by which effects stand out.
const VISIBILITIES: [f64; 6] = [0.0, 4.0, 6.0, 8.0, 12.0, f64::INFINITY];
/// Bounds of the probabilities by which verdicts are held against the truth.
const PROBABILITIES: [f64; 7] = [0.0, 0.5, 0.8, 0.9, 0.99, 0.999, f64::INFINITY];

fn row(what: &str, figure: &str) {
    println!("{what:56} {figure}");
}

/// `n of m, p % (95 %: low to high)` of what can be judged.
fn rate(judged: impl Iterator<Item = Option<bool>>) -> String {
    let judged: Vec<bool> = judged.flatten().collect();
    let yes = judged.iter().filter(|yes| **yes).count();
    if judged.is_empty() {
        return "no case".to_owned();
    }
    let [low, high] = wilson_percent(yes, judged.len());
    let share = 100.0 * yes as f64 / judged.len() as f64;
    format!("{yes} of {}, {share:.1} % (95 %: {low:.0} to {high:.0})", judged.len())
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Prints the score of all cases.
pub fn print_summary(records: &[CaseRecord]) {
    let all = || records.iter();
    println!("\n{} cases", records.len());
    for structure in NAMES {
        let mut sum = Honesty::default();
        let of_it: Vec<_> = all().filter(|record| record.structure == structure).collect();
        of_it.iter().for_each(|record| sum.absorb(&record.honesty));
        if !of_it.is_empty() {
            let generation: Vec<f64> = of_it.iter().map(|record| record.generation_s).collect();
            let identify: Vec<f64> = of_it.iter().map(|record| record.identify_s).collect();
            println!(
                "{structure:14} {:3} cases | made in {:.2} s, identified in {:.2} s | {}",
                of_it.len(),
                mean(&generation),
                mean(&identify),
                sum.line()
            );
        }
    }
    if all().all(|record| record.diagnosis.is_none()) {
        return;
    }
    row("truth named first", &rate(all().map(CaseRecord::first_right)));
    let sizes: Vec<f64> = all()
        .filter(|record| record.first_right().is_some())
        .filter_map(|record| record.diagnosis.as_ref())
        .map(|diagnosis| named_set(diagnosis).len() as f64)
        .filter(|size| *size > 0.0)
        .collect();
    let size = format!(", mean size of sets {:.2}", mean(&sizes));
    row("truth inside the named set", &(rate(all().map(CaseRecord::in_set)) + &size));
    row("false alarms on sound structures", &rate(all().map(CaseRecord::false_alarm)));
    row("outside the catalogue: unknown", &rate(all().map(CaseRecord::known_unknown)));
    row("right effect removed: unknown", &rate(all().map(CaseRecord::unknown_without)));
    row("pairs, both recovered", &rate(all().map(CaseRecord::both_found)));
    let located: Vec<(f64, f64)> =
        all().filter_map(|record| record.location_error_m().map(|error| (error, error / record.height_m))).collect();
    let (mut metres, mut shares): (Vec<f64>, Vec<f64>) = located.into_iter().unzip();
    row(
        "location error, median and 90 %",
        &format!(
            "{:.1} m and {:.1} m; {:.1} % and {:.1} % of the height ({} cases)",
            quantile(&mut metres, 0.5),
            quantile(&mut metres, 0.9),
            100.0 * quantile(&mut shares, 0.5),
            100.0 * quantile(&mut shares, 0.9),
            metres.len()
        ),
    );
    let z: Vec<f64> = all().flat_map(CaseRecord::parameter_z).collect();
    row("parameters within 2 stated deviations", &rate(z.iter().map(|z| Some(z.abs() <= 2.0))));
    let added = || all().filter(|record| record.error_after.is_some());
    let before: Vec<f64> = added().map(|record| record.error_before).collect();
    let after: Vec<f64> = added().filter_map(|record| record.error_after).collect();
    let floor: Vec<f64> = added().map(|record| record.floor).collect();
    row(
        "mean frequency error before, after adding, of scatter",
        &format!("{:.2} %, {:.2} %, {:.2} %", mean(&before), mean(&after), mean(&floor)),
    );
    row("it fell tenfold or to 1.3 times the scatter's", &rate(all().map(CaseRecord::error_fell)));
    let seconds: Vec<f64> = all().filter(|record| record.diagnosis.is_some()).map(|record| record.diagnose_s).collect();
    let slowest = seconds.iter().copied().fold(0.0, f64::max);
    row("a diagnosis takes, mean and most", &format!("{:.2} s, {slowest:.2} s", mean(&seconds)));
    let failures = all().map(|record| record.failures.len()).sum::<usize>();
    row("commands that failed", &failures.to_string());
    print_detection(records);
    print_visibility(records);
    print_reliability(records);
    print_worlds(records);
    print_confusions(records);
}

/// Which of the intervals between bounds holds a value.
fn interval(bounds: &[f64], value: f64) -> Option<usize> {
    bounds.windows(2).position(|ends| (ends[0]..ends[1]).contains(&value))
}

/// The records whose value lies between bounds, one pair of bounds after the other, each with these bounds: the last has no end.
fn between<'a>(
    bounds: &'a [f64],
    records: &'a [CaseRecord],
    value: impl Fn(&CaseRecord) -> Option<f64>,
) -> impl Iterator<Item = (f64, Option<f64>, Vec<&'a CaseRecord>)> {
    bounds.windows(2).enumerate().map(move |(at, ends)| {
        let is_here = |record: &&CaseRecord| value(record).and_then(|value| interval(bounds, value)) == Some(at);
        (ends[0], Some(ends[1]).filter(|end| end.is_finite()), records.iter().filter(is_here).collect())
    })
}

/// How often an effect is named, by how far it moves the frequency that it moves most.
fn print_detection(records: &[CaseRecord]) {
    println!("\neffects named first, by how far they move a frequency");
    for (from, to, of_it) in between(&SHIFTS, records, |record| record.shift) {
        let what = match to {
            Some(to) => format!("{:.0} to {:.0} %", 100.0 * from, 100.0 * to),
            None => format!("above {:.0} %", 100.0 * from),
        };
        row(&what, &rate(of_it.iter().map(|record| record.first_right())));
    }
}

/// The same by how far they stand out of what nobody can know, and pairs by the one of them that stands out less.
fn print_visibility(records: &[CaseRecord]) {
    println!("\nby deviations that they stand out by: effects in the named set; pairs, both recovered");
    for (from, to, of_it) in between(&VISIBILITIES, records, |record| record.visibility) {
        let what = to.map_or_else(|| format!("above {from}"), |to| format!("{from} to {to}"));
        let [in_set, both]: [fn(&CaseRecord) -> Option<bool>; 2] = [CaseRecord::in_set, CaseRecord::both_found];
        let [in_set, both] = [in_set, both].map(|judge| rate(of_it.iter().map(|record| judge(record))));
        println!("{what:24} {in_set:40} {both}");
    }
}

/// Verdicts by the probability that they state, and how many of them are true.
fn print_reliability(records: &[CaseRecord]) {
    println!("\nverdicts that are true, by the probability that they state");
    let stated = |record: &CaseRecord| record.diagnosis.as_ref().map(|diagnosis| diagnosis.probability);
    for (from, to, of_it) in between(&PROBABILITIES, records, stated) {
        if of_it.is_empty() {
            continue;
        }
        let probabilities: Vec<f64> = of_it.iter().filter_map(|record| stated(record)).collect();
        let what = match to {
            Some(to) => format!("{from} to {to}, on average {:.3}", mean(&probabilities)),
            None => format!("above {from}, on average {:.4}", mean(&probabilities)),
        };
        row(&what, &rate(of_it.iter().map(|record| record.is_true())));
    }
}

/// What the worlds make of it, one part of them after the other.
fn print_worlds(records: &[CaseRecord]) {
    type Name = fn(&CaseRecord) -> String;
    let parts: [(&str, Name); 4] = [
        ("scatter over what the study states", |record| record.world.scatter.to_string()),
        ("kernel of the scatter", |record| record.world.kernel.name().to_owned()),
        ("bending, shear, torsion scatter", |record| if record.world.apart { "apart" } else { "together" }.to_owned()),
        ("loads", |record| record.world.loads.name().to_owned()),
    ];
    for (part, name) in parts {
        let mut of_part: BTreeMap<String, Vec<&CaseRecord>> = BTreeMap::new();
        records.iter().for_each(|record| of_part.entry(name(record)).or_default().push(record));
        if of_part.len() < 2 {
            continue;
        }
        println!("\n{part}: sound ones called defective; effects above {:.0} % named first", 100.0 * SHIFTS[3]);
        for (name, of_it) in of_part {
            let alarms = rate(of_it.iter().map(|record| record.false_alarm()));
            let is_large = |record: &&&CaseRecord| {
                record.category == Category::Single && record.shift.is_some_and(|shift| shift >= SHIFTS[3])
            };
            let named = rate(of_it.iter().filter(is_large).map(|record| record.first_right()));
            println!("{name:24} {alarms:40} {named}");
        }
    }
}

/// Truth by truth, what was said and how often.
fn print_confusions(records: &[CaseRecord]) {
    let mut table: BTreeMap<String, BTreeMap<String, usize>> = BTreeMap::new();
    for (truth, named) in records.iter().filter_map(CaseRecord::confusion) {
        *table.entry(truth).or_default().entry(named).or_default() += 1;
    }
    println!("\ntruth: named (times)");
    for (truth, said) in table {
        let mut said: Vec<_> = said.into_iter().collect();
        said.sort_by_key(|(_, times)| std::cmp::Reverse(*times));
        let said: Vec<String> = said.into_iter().map(|(named, times)| format!("{named} {times}")).collect();
        println!("{truth:28} {}", said.join(", "));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_leave_out_what_cannot_be_judged() {
        assert_eq!(rate([Some(true), None, Some(false), Some(true)].into_iter()), "2 of 3, 66.7 % (95 %: 21 to 94)");
        assert_eq!(rate(std::iter::empty()), "no case");
    }

    #[test]
    fn values_stand_between_bounds() {
        assert_eq!(interval(&SHIFTS, 0.0), Some(0));
        assert_eq!(interval(&SHIFTS, 0.03), Some(3));
        assert_eq!(interval(&SHIFTS, 0.5), Some(4));
        assert_eq!(interval(&PROBABILITIES, 1.0), Some(5));
        assert_eq!(interval(&PROBABILITIES, f64::NAN), None);
    }
}
