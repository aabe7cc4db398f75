//! The study of a case: its recordings, setup by setup, and its `study.toml`.

use std::fmt::Write as _;
use std::path::Path;
use std::{fs, io};

use rand::Rng;

use super::cases::Case;
use super::fault::Sign;
use super::record::record;
use super::structure::{Structure, channel_name};
use crate::npy::write_npy;

/// Share of each channel's root mean square that is sensor noise.
const NOISE: f64 = 0.03;

/// Makes a case's recordings and writes its study into a folder; what warnings have to say of its fault flows out.
pub(super) fn write_study(
    case: &Case,
    structure: &Structure,
    folder: &Path,
    random: &mut impl Rng,
) -> io::Result<Vec<Sign>> {
    let channels = structure.places.len();
    let mut signs = Vec::new();
    fs::create_dir_all(folder)?;
    for (setup, kept) in setups(case, channels).iter().enumerate() {
        let mut samples = record(structure, case.load, case.rate_hz, case.seconds, NOISE, random);
        if let Some(fault) = case.fault {
            signs.extend(fault.damage(&mut samples, structure, case.rate_hz, random));
        }
        let rows = samples.chunks(channels);
        let samples: Vec<f32> = rows.flat_map(|row| kept.iter().map(|&channel| row[channel])).collect();
        write_npy(&folder.join(format!("{}.npy", name(setup))), &samples, kept.len())?;
    }
    fs::write(folder.join("study.toml"), study_toml(case, structure))?;
    Ok(signs)
}

/// The channels of each setup, the references first.
fn setups(case: &Case, channels: usize) -> Vec<Vec<usize>> {
    let Some(roving) = case.roving else { return vec![(0..channels).collect()] };
    let others: Vec<usize> = (0..channels).filter(|channel| !roving.references.contains(channel)).collect();
    let each = others.len().div_ceil(roving.setups);
    others.chunks(each).map(|others| [&roving.references[..], others].concat()).collect()
}

fn name(setup: usize) -> String {
    format!("setup-{}", setup + 1)
}

fn study_toml(case: &Case, structure: &Structure) -> String {
    let mut text = format!("[structure]\nname = {:?}\n", case.name);
    for (setup, kept) in setups(case, structure.places.len()).iter().enumerate() {
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "\n[[setup]]\nname = {0:?}\nfiles = [\"{0}.npy\"]\nsampling_rate_hz = {1:?}\nunit = \"m/s2\"",
            name(setup),
            case.rate_hz
        );
        for (column, &channel) in kept.iter().enumerate() {
            let (z_m, azimuth_deg) = structure.places[channel];
            let reference = case.roving.is_some_and(|roving| roving.references.contains(&channel));
            // A column is a channel, whose point says where it is on the structure.
            let _ = writeln!(
                text,
                "\n[[setup.sensor]]\nchannel = \"{}\"\npoint = \"{}\"\nnode = {}\nelevation_m = {z_m:?}\nazimuth_deg = {azimuth_deg:?}\nreference = {reference}",
                channel_name(column),
                channel + 1,
                column / 4 + 1
            );
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::super::cases::CASES;

    #[test]
    fn a_faulty_record_has_one_setup_whose_columns_are_the_structures_channels() {
        assert!(CASES.iter().all(|case| case.fault.is_none() || case.roving.is_none()));
    }
}
