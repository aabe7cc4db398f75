//! Whether a killed collector loses anything.

use belfry_tests::live;
use clap::Args;

/// How soon windows are to come again.
const RECOVERY_S: f64 = 1.0;

/// `belfry collect`, killed at random instants: are windows lost or doubled, and how soon do they come again?
#[derive(Debug, Args)]
pub(super) struct Arguments {
    /// How often it is killed
    #[arg(long, default_value_t = 500)]
    kills: usize,
    /// Draws the instants [default: drawn, and printed]
    #[arg(long)]
    seed: Option<u64>,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Box<dyn std::error::Error>> {
    let seed = arguments.seed.unwrap_or_else(|| u64::from(rand::random::<u32>()));
    println!("seed {seed}");
    let report = live::kills(arguments.kills, seed)?;
    println!("{report}");
    if report.lost + report.doubled > 0 || !report.is_sound {
        return Err("windows are lost, doubled or damaged".into());
    }
    match report.recoveries.last() {
        Some(longest) if longest.as_secs_f64() > RECOVERY_S => {
            Err(format!("windows are to come again within {RECOVERY_S} s").into())
        }
        _ => Ok(()),
    }
}
