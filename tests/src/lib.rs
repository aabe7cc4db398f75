//! End-to-end tests of Belfry live in `tests/tests`, one file per story a user would tell.
