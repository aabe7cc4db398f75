//! A study of a frame of a laboratory, for `belfry diagnose FOLDER`.

use std::path::PathBuf;

use belfry_tests::{Frame, find_published, write_frame_study};
use clap::{Args, ValueEnum};

/// Write a study of a frame of `../shared/real`: storeys as groups, measured modes
#[derive(Debug, Args)]
pub(super) struct Arguments {
    /// Which frame
    frame: Name,
    /// Where the study is written
    folder: PathBuf,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Name {
    FourStorey,
    EighteenStorey,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Box<dyn std::error::Error>> {
    let data =
        find_published("real").ok_or("../shared/real is not there; it holds the frames and their measured modes")?;
    let frame = match arguments.frame {
        Name::FourStorey => Frame::FourStorey,
        Name::EighteenStorey => Frame::EighteenStorey,
    };
    write_frame_study(frame, &data, &arguments.folder)?;
    println!("study in {}", arguments.folder.display());
    println!("next: belfry diagnose {}", arguments.folder.display());
    Ok(())
}
