//! The `belfry` command: parses arguments and prints.

fn main() {}
