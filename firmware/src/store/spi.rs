//! Memory chips on SPI: FRAM as the MB85RS4MT (Fujitsu data sheet DS501-00053), and NOR flash as the W25Q series (Winbond data sheet
//! W25Q128JV, revision F). They understand the same commands; which one it is, and its size, follow from its identification.

use embedded_hal::spi::{Operation, SpiDevice};

use super::chip::Chip;

/// Commands.
mod command {
    pub(super) const WRITE: u8 = 0x02;
    pub(super) const READ: u8 = 0x03;
    pub(super) const STATUS: u8 = 0x05;
    pub(super) const WRITE_ENABLE: u8 = 0x06;
    pub(super) const ERASE_SECTOR: u8 = 0x20;
    pub(super) const IDENTIFICATION: u8 = 0x9F;
}

/// In the status: an erase or a write goes on.
const BUSY: u8 = 0x01;
/// Fujitsu, whose number stands on the first page but is followed by the mark for a further page.
const FUJITSU: [u8; 2] = [0x04, 0x7F];
/// The part of Fujitsu's product code that says the size: 2^(code + 10) bytes.
const DENSITY: u8 = 0x1F;
/// Exponents of sizes: addresses of three bytes reach 16 MB.
const EXPONENTS: core::ops::RangeInclusive<u8> = 16..=24;

/// A memory chip behind a chip select of its own.
#[derive(Debug)]
pub struct SpiChip<S> {
    bus: S,
    size_bytes: u32,
    is_fram: bool,
}

impl<S: SpiDevice> SpiChip<S> {
    /// Asks the chip what it is; one that does not answer, or that is not known, has a size of 0.
    pub fn find(mut bus: S) -> Self {
        let mut answer = [0; 4];
        let asked = bus.transaction(&mut [Operation::Write(&[command::IDENTIFICATION]), Operation::Read(&mut answer)]);
        let (size_bytes, is_fram) = asked.map_or((0, false), |()| identify(answer));
        Self { bus, size_bytes, is_fram }
    }

    fn enable_writing(&mut self) -> Result<(), S::Error> {
        self.bus.write(&[command::WRITE_ENABLE])
    }
}

/// Size in bytes, and whether it is FRAM.
fn identify([manufacturer, second, third, _]: [u8; 4]) -> (u32, bool) {
    let size = |exponent: u8| if EXPONENTS.contains(&exponent) { 1 << exponent } else { 0 };
    match [manufacturer, second] {
        FUJITSU => (size((third & DENSITY) + 10), true),
        // A line without a chip.
        [0, 0] | [0xFF, 0xFF] => (0, false),
        // NOR flash says the exponent of its size.
        _ => (size(third), false),
    }
}

fn with_address(command: u8, address: u32) -> [u8; 4] {
    let [_, high, middle, low] = address.to_be_bytes();
    [command, high, middle, low]
}

impl<S: SpiDevice> Chip for SpiChip<S> {
    type Error = S::Error;

    fn size_bytes(&self) -> u32 {
        self.size_bytes
    }

    fn is_overwritable(&self) -> bool {
        self.is_fram
    }

    fn is_busy(&mut self) -> Result<bool, S::Error> {
        if self.is_fram {
            return Ok(false);
        }
        let mut status = [0];
        self.bus.transaction(&mut [Operation::Write(&[command::STATUS]), Operation::Read(&mut status)])?;
        Ok(status[0] & BUSY != 0)
    }

    fn read(&mut self, address: u32, bytes: &mut [u8]) -> Result<(), S::Error> {
        let command = with_address(command::READ, address);
        self.bus.transaction(&mut [Operation::Write(&command), Operation::Read(bytes)])
    }

    fn write(&mut self, address: u32, bytes: &[u8]) -> Result<(), S::Error> {
        self.enable_writing()?;
        let command = with_address(command::WRITE, address);
        self.bus.transaction(&mut [Operation::Write(&command), Operation::Write(bytes)])
    }

    fn erase(&mut self, address: u32) -> Result<(), S::Error> {
        if self.is_fram {
            return Ok(());
        }
        self.enable_writing()?;
        self.bus.write(&with_address(command::ERASE_SECTOR, address))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use embedded_hal_mock::eh1::spi::{Mock, Transaction};
    use std::vec::Vec;

    fn transaction(steps: &[Transaction<u8>]) -> Vec<Transaction<u8>> {
        let mut all = std::vec![Transaction::transaction_start()];
        all.extend_from_slice(steps);
        all.push(Transaction::transaction_end());
        all
    }

    fn identification(answer: [u8; 4]) -> Vec<Transaction<u8>> {
        transaction(&[Transaction::write(0x9F), Transaction::read_vec(answer.to_vec())])
    }

    #[test]
    fn chips_are_known_by_their_identification() {
        let cases = [
            ([0x04, 0x7F, 0x49, 0x03], 512 << 10, true),
            ([0x04, 0x7F, 0x48, 0x03], 256 << 10, true),
            ([0x04, 0x7F, 0x27, 0x03], 128 << 10, true),
            ([0xEF, 0x40, 0x18, 0x00], 16 << 20, false),
            ([0xEF, 0x40, 0x14, 0x00], 1 << 20, false),
            ([0xEF, 0x40, 0x19, 0x00], 0, false),
            ([0x00; 4], 0, false),
            ([0xFF; 4], 0, false),
        ];
        for (answer, size_bytes, is_fram) in cases {
            let mut mock = Mock::new(&identification(answer));
            let chip = SpiChip::find(mock.clone());
            assert_eq!((chip.size_bytes(), chip.is_overwritable()), (size_bytes, is_fram), "{answer:02X?}");
            mock.done();
        }
    }

    #[test]
    fn nor_flash_is_read_written_erased_and_waited_for() {
        let steps = [
            identification([0xEF, 0x40, 0x18, 0x00]),
            transaction(&[
                Transaction::write_vec(std::vec![0x03, 0x12, 0x34, 0x56]),
                Transaction::read_vec(std::vec![7, 8]),
            ]),
            transaction(&[Transaction::write_vec(std::vec![0x06])]),
            transaction(&[Transaction::write_vec(std::vec![0x02, 0, 1, 0]), Transaction::write_vec(std::vec![9])]),
            transaction(&[Transaction::write(0x05), Transaction::read(0x03)]),
            transaction(&[Transaction::write(0x05), Transaction::read(0x00)]),
            transaction(&[Transaction::write_vec(std::vec![0x06])]),
            transaction(&[Transaction::write_vec(std::vec![0x20, 0, 0x10, 0])]),
        ];
        let mut mock = Mock::new(&steps.concat());
        let mut chip = SpiChip::find(mock.clone());
        let mut bytes = [0; 2];
        chip.read(0x12_3456, &mut bytes).unwrap();
        assert_eq!(bytes, [7, 8]);
        chip.write(0x100, &[9]).unwrap();
        assert_eq!((chip.is_busy(), chip.is_busy()), (Ok(true), Ok(false)));
        chip.erase(0x1000).unwrap();
        mock.done();
    }

    #[test]
    fn fram_is_never_busy_and_needs_no_erase() {
        let mut mock = Mock::new(&identification([0x04, 0x7F, 0x49, 0x03]));
        let mut chip = SpiChip::find(mock.clone());
        assert_eq!(chip.is_busy(), Ok(false));
        chip.erase(0).unwrap();
        mock.done();
    }
}
