//! CRC-16/MCRF4XX, the checksum of MAVLink, eight table look-ups for eight bytes (slicing-by-8) in place of a chain of
//! dependent steps per byte.

/// Initial value.
pub const INIT: u16 = 0xFFFF;

const TABLES: [[u16; 256]; 8] = {
    let mut t = [[0u16; 256]; 8];
    let mut i = 0;
    while i < 256 {
        let mut c = i as u16;
        let mut bit = 0;
        while bit < 8 {
            c = if c & 1 == 1 {
                (c >> 1) ^ 0x8408
            } else {
                c >> 1
            };
            bit += 1;
        }
        t[0][i] = c;
        i += 1;
    }
    let mut k = 1;
    while k < 8 {
        let mut i = 0;
        while i < 256 {
            let prev = t[k - 1][i];
            t[k][i] = (prev >> 8) ^ t[0][(prev & 255) as usize];
            i += 1;
        }
        k += 1;
    }
    t
};

/// Continues a checksum over more bytes.
#[must_use]
pub fn update(mut crc: u16, bytes: &[u8]) -> u16 {
    let (blocks, rest) = bytes.as_chunks::<8>();
    for b in blocks {
        let a = crc ^ u16::from_le_bytes([b[0], b[1]]);
        crc = TABLES[7][usize::from(a & 255)]
            ^ TABLES[6][usize::from(a >> 8)]
            ^ TABLES[5][usize::from(b[2])]
            ^ TABLES[4][usize::from(b[3])]
            ^ TABLES[3][usize::from(b[4])]
            ^ TABLES[2][usize::from(b[5])]
            ^ TABLES[1][usize::from(b[6])]
            ^ TABLES[0][usize::from(b[7])];
    }
    for byte in rest {
        crc = (crc >> 8) ^ TABLES[0][usize::from((crc ^ u16::from(*byte)) & 255)];
    }
    crc
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn check_value_of_the_catalogue() {
        assert_eq!(update(INIT, b"123456789"), 0x6F91);
    }

    proptest! {
        #[test]
        fn any_split_gives_the_same_sum(bytes in proptest::collection::vec(any::<u8>(), 0..64), cut in 0usize..64) {
            let cut = cut.min(bytes.len());
            prop_assert_eq!(update(update(INIT, &bytes[..cut]), &bytes[cut..]), update(INIT, &bytes));
        }
    }
}
