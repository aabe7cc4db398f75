//! The compiled half of the Python package `belfry`: a study's folder or a recording flows in, the report that the command of that name
//! prints with `--json` flows out as Python objects.
//!
//! The package's Python half makes dataclasses and arrays of it. Work runs without Python's lock. Python's signals are looked at
//! whenever the work tells of its progress, so that Ctrl-C ends it as an exception.

mod caller;
mod steps;

use pyo3::prelude::*;

/// The module; `belfry/_belfry.pyi` says its types.
#[pymodule]
mod _belfry {
    #[pymodule_export]
    use super::steps::{add, compare, diagnose, identify, identify_recording, modes, study, update, version};
}
