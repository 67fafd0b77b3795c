//! CRC-16/MCRF4XX, the checksum of MAVLink, by sixteen tables (slicing-by-16) in place of a chain of dependent steps per byte.
//!
//! A sum of 16 bits meets only the first two bytes of a block; what the other fourteen add is looked up beside it. So a block costs
//! about as long a chain as a single byte does, and what is left of a message goes in blocks of 8, 4, 2 and 1.

/// Initial value.
pub const INIT: u16 = 0xFFFF;

/// Bytes of the longest block.
const BLOCK: usize = 16;

/// `TABLES[k][b]`: what byte `b` adds to the sum when `k` more bytes of its block follow it. 8 KiB.
static TABLES: [[u16; 256]; BLOCK] = {
    let mut t = [[0u16; 256]; BLOCK];
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
    while k < BLOCK {
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

/// One block of 2 to 16 bytes.
#[inline(always)]
fn block<const N: usize>(crc: u16, bytes: &[u8; N]) -> u16 {
    // What waits for the block before comes last.
    let mut rest = 0;
    for i in 2..N {
        rest ^= TABLES[N - 1 - i][usize::from(bytes[i])];
    }
    let [low, high] = crc.to_le_bytes();
    let first = TABLES[N - 1][usize::from(bytes[0] ^ low)];
    let second = TABLES[N - 2][usize::from(bytes[1] ^ high)];
    rest ^ (first ^ second)
}

#[inline(always)]
fn byte(crc: u16, byte: u8) -> u16 {
    (crc >> 8) ^ TABLES[0][usize::from((crc ^ u16::from(byte)) & 255)]
}

/// Continues a checksum over more bytes.
#[inline]
#[must_use]
pub fn update(mut crc: u16, bytes: &[u8]) -> u16 {
    let (blocks, rest) = bytes.as_chunks::<BLOCK>();
    for b in blocks {
        crc = block(crc, b);
    }
    let mut rest = rest;
    if let Some((b, more)) = rest.split_first_chunk::<8>() {
        (crc, rest) = (block(crc, b), more);
    }
    if let Some((b, more)) = rest.split_first_chunk::<4>() {
        (crc, rest) = (block(crc, b), more);
    }
    if let Some((b, more)) = rest.split_first_chunk::<2>() {
        (crc, rest) = (block(crc, b), more);
    }
    match rest {
        [last] => byte(crc, *last),
        _ => crc,
    }
}

/// The checksum of a frame: over its bytes from the length on, then CRC_EXTRA of its id.
#[inline]
#[must_use]
pub fn of_frame(bytes: &[u8], crc_extra: u8) -> u16 {
    byte(update(INIT, bytes), crc_extra)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn check_value_of_the_catalogue() {
        assert_eq!(update(INIT, b"123456789"), 0x6F91);
    }

    /// By the polynomial, a bit at a time.
    fn plain(mut crc: u16, bytes: &[u8]) -> u16 {
        for b in bytes {
            crc ^= u16::from(*b);
            for _ in 0..8 {
                crc = (crc >> 1) ^ if crc & 1 == 1 { 0x8408 } else { 0 };
            }
        }
        crc
    }

    proptest! {
        #[test]
        fn every_length_gives_the_sum_of_the_polynomial(crc: u16, extra: u8, bytes in proptest::collection::vec(any::<u8>(), 0..70)) {
            prop_assert_eq!(update(crc, &bytes), plain(crc, &bytes));
            prop_assert_eq!(of_frame(&bytes, extra), plain(plain(INIT, &bytes), &[extra]));
        }

        #[test]
        fn any_split_gives_the_same_sum(bytes in proptest::collection::vec(any::<u8>(), 0..64), cut in 0usize..64) {
            let cut = cut.min(bytes.len());
            prop_assert_eq!(update(update(INIT, &bytes[..cut]), &bytes[cut..]), update(INIT, &bytes));
        }
    }
}
