//! See `belfry_tests::fuzz::npy_matrix`.

#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| belfry_tests::fuzz::npy_matrix(bytes));
