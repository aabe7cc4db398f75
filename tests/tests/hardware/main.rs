//! The node's program on an emulated board: the same ELF that is flashed, in QEMU, at the other end of a socket.
//!
//! These tests need the program built for the board and `qemu-system-arm`; `./test` provides both and runs them.

mod emulator;
mod faults;
mod figures;
mod refusals;
mod replay;
mod timing;
