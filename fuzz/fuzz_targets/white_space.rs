//! See `belfry_tests::fuzz::white_space`.

#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| belfry_tests::fuzz::white_space(bytes));
