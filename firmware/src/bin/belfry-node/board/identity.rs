//! The node's identity.

use core::mem::MaybeUninit;
use core::ptr::{addr_of, addr_of_mut};

use belfry_firmware::Identity;
use belfry_firmware::adxl355::{CHANNELS, FULL_SCALE_M_S2, HIGHEST_RATE_MHZ};
use belfry_shared::frame::crc32;
use belfry_shared::message::MAX_CHANNELS;
use belfry_shared::seal::{IMAGE_BYTES, ImageError, Key};

/// The node's number, from BELFRY_NODE when it is built. It has a symbol so that it can be changed in the built program.
#[unsafe(no_mangle)]
#[used]
static BELFRY_NODE: u16 = number(option_env!("BELFRY_NODE"));

/// DBGMCU_IDCODE, which is 0 in the emulator.
const DEVICE_ID: *const u32 = 0xE004_2000 as *const u32;
/// The chip's own number.
const CHIP: *const [u32; 3] = 0x1FFF_7A10 as *const [u32; 3];
/// The image of the node's key: the last sector of the flash, which the program leaves alone (memory.x).
const KEY: *const [u8; IMAGE_BYTES] = 0x0806_0000 as *const [u8; IMAGE_BYTES];
/// Number of words that a start does not set. Some 3 % of a RAM's bits are anybody's guess after power-on (Holcomb, Burleson, Fu 2009: 128 of 4096);
/// a boot id of 32 bits needs twice as many words as that, for it is what a sealed frame is sealed for.
const WORDS: usize = 64;

/// What stands here after power-on differs from time to time; the first word counts restarts.
#[unsafe(link_section = ".uninit.SEED")]
static mut SEED: MaybeUninit<[u32; WORDS]> = MaybeUninit::uninit();

const fn number(text: Option<&str>) -> u16 {
    let Some(text) = text else { return 1 };
    let (bytes, mut number, mut index) = (text.as_bytes(), 0_u32, 0);
    while index < bytes.len() {
        assert!(bytes[index].is_ascii_digit(), "BELFRY_NODE is a number from 1 to 65535");
        number = 10 * number + (bytes[index] - b'0') as u32;
        assert!(number <= u16::MAX as u32, "BELFRY_NODE is a number from 1 to 65535");
        index += 1;
    }
    assert!(number > 0, "BELFRY_NODE is a number from 1 to 65535");
    number as u16
}

/// Whether this is the emulator.
pub(super) fn is_emulated() -> bool {
    // SAFETY: the register is there on every chip of the family, and is only read.
    unsafe { DEVICE_ID.read_volatile() == 0 }
}

/// The node's key, where one was written.
pub(super) fn key(node: u16) -> Result<Option<Key>, ImageError> {
    // SAFETY: it lies within the flash, and is only read.
    let image = unsafe { KEY.read_volatile() };
    Key::from_image(&image, node)
}

/// A boot id that is another one at every start, as far as chance goes. To be called once.
pub(super) fn random_boot() -> u32 {
    let chip = if is_emulated() {
        [0; 3]
    } else {
        // SAFETY: the chip's number is there on every chip of the family.
        unsafe { CHIP.read_volatile() }
    };
    // SAFETY: only this function names SEED, and it is called once; any words are words, and reading them volatile keeps
    // the compiler from knowing that nothing has set them.
    let mut seed = unsafe { addr_of!(SEED).cast::<[u32; WORDS]>().read_volatile() };
    seed[0] = seed[0].wrapping_add(1);
    // SAFETY: as above.
    unsafe { addr_of_mut!(SEED).cast::<[u32; WORDS]>().write_volatile(seed) };
    // How long the start took: the only thing that differs in the emulator, whose memory is all zeros.
    let took = [super::ticks::now().0 as u32];
    let mut bytes = [0; 4 * (3 + WORDS + 1)];
    for (place, word) in bytes.chunks_exact_mut(4).zip(chip.iter().chain(&seed).chain(&took)) {
        place.copy_from_slice(&word.to_le_bytes());
    }
    crc32(&bytes)
}

/// The node's identity, with the boot id of this start.
pub(super) fn identity(boot: u32) -> Identity {
    // SAFETY: a constant, but one that may be changed in the built program, so the compiler must not rely on it.
    let node = unsafe { addr_of!(BELFRY_NODE).read_volatile() };
    // In the emulator recordings may have more channels than the sensor.
    let channels = if is_emulated() { MAX_CHANNELS } else { CHANNELS };
    Identity {
        node,
        boot,
        channels: channels as u8,
        full_scale_m_s2: FULL_SCALE_M_S2,
        highest_rate_mhz: HIGHEST_RATE_MHZ,
    }
}
