//! The node's program on an emulated board: the same ELF that is flashed, in QEMU, at the other end of a socket.
//!
//! These tests build that program and need `qemu-system-arm`; `./test` installs what is missing.

mod emulator;
mod faults;
mod figures;
mod keys;
mod refusals;
mod replay;
mod timing;
