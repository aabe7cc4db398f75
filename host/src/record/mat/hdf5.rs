//! Variables of a MATLAB v7.3 file, which is one of HDF5: arrays with their dimensions in MATLAB's order, and sparse matrices.
//!
//! MATLAB counts rows first and HDF5 last, so dimensions are turned round. A sparse matrix is a group with the attribute `MATLAB_sparse`, its
//! number of rows, and the datasets `data`, `ir` (rows) and `jc` (where columns start).

use super::element::{Class, Numbers, Storage, Variable, sparse_columns};
use crate::record::error::MatError;
use crate::record::hdf5::{COMPOUND, Dataset, Hdf5File, Kind, Object};

/// What MATLAB calls the class of its variable.
const CLASS: &str = "MATLAB_class";
/// The rows of a sparse matrix.
const SPARSE: &str = "MATLAB_sparse";

/// Where the numbers of a variable are.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Place {
    Full(Object),
    Sparse(Box<Sparse>),
    /// Neither.
    Other,
}

/// The datasets of a sparse matrix: rows and values are not there where it has no entries.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Sparse {
    rows: Option<Object>,
    starts: Object,
    values: Option<Object>,
}

/// The variables that MATLAB shows, in the file's order.
pub(super) fn variables(file: &Hdf5File) -> Result<Vec<Variable>, MatError> {
    let objects = file.objects()?;
    let member = |group: &str, name: &str| {
        let path = format!("{group}/{name}");
        objects.iter().find(|object| object.path == path && object.dataset.is_some()).cloned()
    };
    // What stands behind # is MATLAB's own.
    let is_shown =
        |object: &&Object| !object.path.is_empty() && !object.path.contains('/') && !object.path.starts_with('#');
    Ok(objects.iter().filter(is_shown).map(|object| variable(object, &member)).collect())
}

fn variable(object: &Object, member: &impl Fn(&str, &str) -> Option<Object>) -> Variable {
    let name = object.path.clone();
    let other = |class, dimensions| {
        let storage = Storage::Hdf5(Box::new(Place::Other));
        Variable { name: name.clone(), class: Class::Other(class), dimensions, complex: false, storage }
    };
    let Some(dataset) = &object.dataset else {
        let starts = member(&name, "jc");
        let columns = starts.as_ref().and_then(|starts| starts.dataset.as_ref()?.count()?.checked_sub(1));
        let (Some(rows), Some(columns), Some(starts)) = (object.number(SPARSE), columns, starts) else {
            return other("struct", vec![1, 1]);
        };
        let values = member(&name, "data");
        let complex = values.as_ref().and_then(|values| values.dataset.as_ref()).is_some_and(is_complex);
        let place = Place::Sparse(Box::new(Sparse { rows: member(&name, "ir"), starts, values }));
        let (dimensions, storage) = (vec![rows as u64, columns], Storage::Hdf5(Box::new(place)));
        return Variable { name, class: Class::Sparse, dimensions, complex, storage };
    };
    let mut dimensions: Vec<u64> = dataset.lengths.iter().rev().copied().collect();
    dimensions.resize(dimensions.len().max(2), 1);
    if object.number("MATLAB_empty").is_some_and(|is_empty| is_empty != 0.0) {
        // Its numbers are dimensions.
        dimensions = vec![0, 0];
    }
    let of_class = |class: &str| object.text(CLASS) == Some(class);
    let is_number = matches!(dataset.kind, Kind::Number { .. });
    let complex = is_complex(dataset);
    for class in ["char", "cell", "struct", "logical", "function_handle"] {
        if of_class(class) {
            return other(class, dimensions);
        }
    }
    if !is_number && !(complex && (of_class("double") || of_class("single"))) {
        let what = match dataset.kind {
            Kind::Other(what) => what,
            _ => "text",
        };
        return other(what, dimensions);
    }
    let storage = Storage::Hdf5(Box::new(Place::Full(object.clone())));
    Variable { name, class: Class::Numeric, dimensions, complex, storage }
}

/// Whether a dataset's numbers have real and imaginary parts, which MATLAB keeps in a compound.
fn is_complex(dataset: &Dataset) -> bool {
    matches!(dataset.kind, Kind::Other(COMPOUND))
}

/// Where the numbers of a full variable are.
pub(super) fn numbers(file: &Hdf5File, place: &Place) -> Result<Numbers, MatError> {
    let Place::Full(object) = place else { return Ok(Numbers::none()) };
    let found = file.numbers(object)?;
    Ok(Numbers {
        sample: found.sample,
        big_endian: found.big_endian,
        offset: found.offset,
        inflated: Some(found.source),
    })
}

/// All numbers of a full variable, `most` at most.
pub(super) fn full(file: &Hdf5File, place: &Place, most: u64) -> Result<Vec<f64>, MatError> {
    match place {
        Place::Full(object) => Ok(file.all_numbers(object, most)?),
        _ => Ok(Vec::new()),
    }
}

/// Hands out the entries of a sparse variable, as for version 5.
pub(super) fn sparse(
    file: &Hdf5File,
    place: &Place,
    [rows, columns]: [u64; 2],
    on_entry: &mut dyn FnMut(usize, usize, f64) -> Result<(), MatError>,
    damaged: impl Fn(String) -> MatError,
) -> Result<(), MatError> {
    let Place::Sparse(parts) = place else { return Ok(()) };
    let Sparse { rows: row_numbers, starts, values } = parts.as_ref();
    let most = rows.saturating_mul(columns).max(1);
    let all = |object: &Option<Object>| match object {
        Some(object) => file.all_numbers(object, most),
        None => Ok(Vec::new()),
    };
    let row_numbers = all(row_numbers)?;
    let starts = file.all_numbers(starts, columns.saturating_add(1))?;
    let values = all(values)?;
    sparse_columns(&row_numbers, &starts, &values, on_entry, damaged)
}
