//! See `belfry_tests::fuzz::parquet`.

#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| belfry_tests::fuzz::parquet(bytes));
