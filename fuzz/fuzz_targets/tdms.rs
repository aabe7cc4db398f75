//! See `belfry_tests::fuzz::tdms`.

#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| belfry_tests::fuzz::tdms(bytes));
