//! Benchmarks of the host, in a package of their own: what they need, nothing else has to compile.
