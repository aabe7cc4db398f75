//! FNV-1a with 64 bits (Fowler, Noll and Vo): the same for the same bytes on every computer and in every version.

/// What a sum begins with.
pub(crate) const START: u64 = 0xcbf2_9ce4_8422_2325;

/// A sum, and these bytes.
pub(crate) fn fnv1a(sum: u64, bytes: impl Iterator<Item = u8>) -> u64 {
    bytes.fold(sum, |sum, byte| (sum ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As Noll's list of test vectors has them.
    #[test]
    fn sums_are_those_of_the_authors() {
        let sum = |text: &str| fnv1a(START, text.bytes());
        assert_eq!([sum(""), sum("a"), sum("foobar")], [START, 0xaf63_dc4c_8601_ec8c, 0x8594_4171_f739_67e8]);
    }
}
