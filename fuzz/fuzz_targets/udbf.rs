//! See `belfry_tests::fuzz::udbf`.

#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| belfry_tests::fuzz::udbf(bytes));
