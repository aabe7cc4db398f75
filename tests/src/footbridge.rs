//! The footbridge of `../shared/pedestrian-bridge` as a study: 946 degrees of freedom, 5 modes measured at 58 of them, a group for each part of its
//! stiffness.
//!
//! The data are other people's and stay where they are; a study that reads the matrices there and holds the measured modes
//! as CSV is written on demand.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use belfry_host::record::mat::read_matrix;

/// The matrices whose sum is the bridge's stiffness, as its authors vary them.
pub const FOOTBRIDGE_STIFFNESS: [&str; 17] = [
    "K_Truss", "K_Frame", "K_Conc1", "K_Conc2", "K_Conc3", "K_Conc4", "K_Conc5", "K_Conc6", "K_Conc7", "K_Conc8",
    "K_Conc9", "K_Conc10", "K_Conc11", "K_y1", "K_z1", "K_y2", "K_z2",
];

/// How far each part is trusted: half of what its authors let it change by, which is 10 % of steel, 40 % of concrete (`K_Conc`), and for the springs
/// of the supports (`K_y`, `K_z`) anything from nothing to eleven times.
fn std_of(part: &str) -> f64 {
    match part {
        "K_Truss" | "K_Frame" => 0.05,
        part if part.starts_with("K_Conc") => 0.2,
        _ => 0.5,
    }
}

/// Writes the study into `folder`, which must not hold one; returns the measured modes' file.
///
/// # Errors
/// When the data cannot be read or the study cannot be written.
pub fn write_footbridge_study(data: &Path, folder: &Path) -> Result<PathBuf, Box<dyn std::error::Error>> {
    let measured = data.join("ExpModeInfo_FEM.mat");
    let matrices = data.join("SteelPedestrianBridgeExp.mat");
    let lambda = read_matrix(&measured, "lambdaExp")?;
    let lambda_std = read_matrix(&measured, "std_lambdaExp")?;
    let shapes = read_matrix(&measured, "psiExp_m")?;
    let shape_stds = read_matrix(&measured, "std_psiExp")?;
    let dofs = read_matrix(&matrices, "measDOFs")?;
    let mut study = format!(
        "# A steel footbridge, measured at 58 degrees of freedom; written by `footbridge`.\n[structure]\nname = \"Footbridge\"\n\n\
         [measured]\nmodes = \"modes.csv\"\n\n[model]\nmatrices = {{ file = {:?}, mass = \"M0\", stiffness = {:?} }}\n\n",
        matrices, FOOTBRIDGE_STIFFNESS
    );
    let mut header = String::from("mode,frequency_hz,frequency_std_hz");
    for dof in dofs.iter() {
        write!(study, "[[sensor]]\nchannel = \"dof{dof}\"\ndof = {dof}\n\n")?;
        write!(header, ",dof{dof},dof{dof}_std")?;
    }
    for part in FOOTBRIDGE_STIFFNESS {
        let std = std_of(part);
        write!(study, "[[model.group]]\nname = {part:?}\nfile = {matrices:?}\nstiffness = {part:?}\nstd = {std}\n\n")?;
    }
    let mut modes = header + "\n";
    for mode in 0..lambda.nrows() {
        let frequency_hz = lambda[(mode, 0)].sqrt() / std::f64::consts::TAU;
        // lambda = (2 pi f)², so the relative deviation of f is half that of lambda.
        let std_hz = 0.5 * frequency_hz * lambda_std[(mode, 0)] / lambda[(mode, 0)];
        write!(modes, "{},{frequency_hz},{std_hz}", mode + 1)?;
        for sensor in 0..shapes.nrows() {
            write!(modes, ",{},{}", shapes[(sensor, mode)], shape_stds[(sensor, mode)])?;
        }
        modes.push('\n');
    }
    fs::create_dir_all(folder)?;
    fs::write(folder.join("study.toml"), study)?;
    let file = folder.join("modes.csv");
    fs::write(&file, modes)?;
    Ok(file)
}
