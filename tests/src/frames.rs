//! The two frames of `../shared/real` as models of storeys: matrices with a row for each floor, a group for each storey.
//!
//! The data are other people's and stay where they are; a study with what its files say is written on demand.

use std::error::Error;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

/// How far each storey's stiffness is trusted.
const STD: f64 = 0.2;

/// A frame, and how high its storeys are: not published, and near.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Frame {
    /// A small frame in a laboratory: four storeys, four modes.
    FourStorey,
    /// A steel frame on a shaking table: eighteen storeys, three modes at six floors.
    EighteenStorey,
}

impl Frame {
    /// Its folder in the data.
    pub fn name(self) -> &'static str {
        match self {
            Self::FourStorey => "four-storey",
            Self::EighteenStorey => "eighteen-storey",
        }
    }

    /// Height of a storey in m.
    pub fn storey_m(self) -> f64 {
        match self {
            Self::FourStorey => 0.3,
            Self::EighteenStorey => 1.1,
        }
    }

    /// Stiffness (N/m) and mass (kg) of each storey as its designers have it, the lowest first.
    ///
    /// # Errors
    /// Where the data cannot be read.
    pub fn storeys(self, data: &Path) -> Result<Vec<[f64; 2]>, Box<dyn Error>> {
        let text = fs::read_to_string(data.join(self.name()).join("model.csv"))?;
        let of_row = |row: &str| -> Result<[f64; 2], Box<dyn Error>> {
            let cells: Vec<&str> = row.split(',').collect();
            let cell = |at: usize| cells.get(at).ok_or("a cell is missing").map(|cell| cell.trim().parse::<f64>());
            Ok([cell(1)??, cell(2)??])
        };
        text.lines().skip(1).map(of_row).collect()
    }
}

/// Writes the study of a frame into a folder; `data` is `../shared/real`.
///
/// # Errors
/// When the data cannot be read or the study cannot be written.
pub fn write_frame_study(frame: Frame, data: &Path, folder: &Path) -> Result<(), Box<dyn Error>> {
    fs::create_dir_all(folder)?;
    let storeys = frame.storeys(data)?;
    let count = storeys.len();
    let head = |entries: usize| format!("%%MatrixMarket matrix coordinate real symmetric\n{count} {count} {entries}\n");
    let modes = fs::read_to_string(data.join(frame.name()).join("modes.csv"))?;
    let mut study = format!("[structure]\nname = {:?}\n\n[measured]\nmodes = \"modes.csv\"\n\n", frame.name());
    for channel in modes.lines().next().unwrap_or_default().split(',').filter(|name| name.starts_with("storey ")) {
        let row: usize = channel.trim_start_matches("storey ").parse()?;
        write!(study, "[[sensor]]\nchannel = {channel:?}\ndof = {row}\n\n")?;
    }
    let (mut mass, mut dofs) = (head(count), "row,node,dof,z_m\n,ground,ux,0\n".to_owned());
    let (mut parts, mut groups) = (Vec::new(), String::new());
    for (below, [stiffness, kg]) in storeys.iter().enumerate() {
        let row = below + 1;
        let [bottom_m, top_m] = [below, row].map(|floor| floor as f64 * frame.storey_m());
        let entries = match below {
            0 => format!("{}{row} {row} {stiffness}\n", head(1)),
            _ => {
                format!("{}{row} {row} {stiffness}\n{row} {below} -{stiffness}\n{below} {below} {stiffness}\n", head(3))
            }
        };
        fs::write(folder.join(format!("storey{row}.mtx")), entries)?;
        writeln!(mass, "{row} {row} {kg}")?;
        writeln!(dofs, "{row},storey {row},ux,{top_m:.2}")?;
        parts.push(format!("\"storey{row}.mtx\""));
        write!(
            groups,
            "[[model.group]]\nname = \"storey{row}\"\nstiffness = \"storey{row}.mtx\"\nstd = {STD}\nz_m = [{bottom_m:.2}, {top_m:.2}]\n\n"
        )?;
    }
    let parts = parts.join(", ");
    write!(
        study,
        "[model]\nmatrices = {{ stiffness = [{parts}], mass = \"m.mtx\", dofs = \"dofs.csv\" }}\n\n{groups}"
    )?;
    fs::write(folder.join("m.mtx"), mass)?;
    fs::write(folder.join("dofs.csv"), dofs)?;
    fs::write(folder.join("modes.csv"), modes)?;
    fs::write(folder.join("study.toml"), study)?;
    Ok(())
}
