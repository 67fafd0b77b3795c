//! The clock in the picture: digits for people, and a row of black and white blocks from which a program reads when the picture was
//! taken, however it was coded on the way.

use super::Picture;

/// Blocks of the row: 32 of milliseconds since 1970 (most significant first, modulo 2^32), 8 of a check.
pub const BLOCKS: usize = 40;
/// Height of the row, pixels.
const ROW: usize = 8;
/// Lines of a digit, pixels a dot.
const DOT: usize = 2;
const BLACK: u8 = 16;
const WHITE: u8 = 235;

/// Rows of 5 dots of the characters in the clock.
const GLYPHS: [(char, [u8; 7]); 13] = [
    ('0', [0x0E, 0x11, 0x13, 0x15, 0x19, 0x11, 0x0E]),
    ('1', [0x04, 0x0C, 0x04, 0x04, 0x04, 0x04, 0x0E]),
    ('2', [0x0E, 0x11, 0x01, 0x02, 0x04, 0x08, 0x1F]),
    ('3', [0x1F, 0x02, 0x04, 0x02, 0x01, 0x11, 0x0E]),
    ('4', [0x02, 0x06, 0x0A, 0x12, 0x1F, 0x02, 0x02]),
    ('5', [0x1F, 0x10, 0x1E, 0x01, 0x01, 0x11, 0x0E]),
    ('6', [0x06, 0x08, 0x10, 0x1E, 0x11, 0x11, 0x0E]),
    ('7', [0x1F, 0x01, 0x02, 0x04, 0x08, 0x08, 0x08]),
    ('8', [0x0E, 0x11, 0x11, 0x0E, 0x11, 0x11, 0x0E]),
    ('9', [0x0E, 0x11, 0x11, 0x0F, 0x01, 0x02, 0x0C]),
    (':', [0x00, 0x0C, 0x0C, 0x00, 0x0C, 0x0C, 0x00]),
    ('.', [0x00, 0x00, 0x00, 0x00, 0x00, 0x0C, 0x0C]),
    (' ', [0; 7]),
];

/// Guards the 32 bits against a picture without the row.
const fn check(bits: u32) -> u8 {
    let b = bits.to_be_bytes();
    b[0] ^ b[1].rotate_left(1) ^ b[2].rotate_left(2) ^ b[3].rotate_left(3) ^ 0xA5
}

/// Writes the time into a picture: the row of blocks at its top, UTC at its lower left. `utc_ms`: milliseconds since 1970.
pub fn stamp(picture: &mut Picture, utc_ms: u64) {
    let bits = utc_ms as u32;
    let word = u64::from(bits) << 8 | u64::from(check(bits));
    let width = picture.width / BLOCKS;
    for block in 0..BLOCKS {
        let is_one = word >> (BLOCKS - 1 - block) & 1 == 1;
        let y = if is_one { WHITE } else { BLACK };
        picture.fill(block * width, 0, [width, ROW], y);
    }
    let (s, ms) = (utc_ms / 1000, utc_ms % 1000);
    let (hours, minutes, seconds) = (s / 3600 % 24, s / 60 % 60, s % 60);
    write(
        picture,
        &format!("{hours:02}:{minutes:02}:{seconds:02}.{ms:03}"),
    );
}

fn write(picture: &mut Picture, text: &str) {
    let advance = 6 * DOT;
    let (left, height) = (8, 7 * DOT);
    let top = picture.height.saturating_sub(height + 10);
    let width = text.len() * advance;
    picture.fill(left - 4, top - 4, [width + 8, height + 8], BLACK);
    for (i, c) in text.chars().enumerate() {
        let Some((_, rows)) = GLYPHS.iter().find(|(g, _)| *g == c) else {
            continue;
        };
        for (row, dots) in rows.iter().enumerate() {
            for dot in (0..5).filter(|dot| dots >> (4 - dot) & 1 == 1) {
                let x = left + i * advance + dot * DOT;
                picture.fill(x, top + row * DOT, [DOT, DOT], WHITE);
            }
        }
    }
}

/// The time in the row of blocks, milliseconds since 1970 modulo 2^32; none if there is no such row.
#[must_use]
pub fn read_stamp(width: usize, y: &[u8]) -> Option<u32> {
    let block = width / BLOCKS;
    let mut word = 0_u64;
    for i in 0..BLOCKS {
        let at = ROW / 2 * width + i * block + block / 2;
        word = word << 1 | u64::from(*y.get(at)? > 126);
    }
    let bits = (word >> 8) as u32;
    (word as u8 == check(bits)).then_some(bits)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_time_is_read_back_even_from_a_washed_out_picture(ms in any::<u64>(), fade in 0.3..1.0f64) {
            let mut p = Picture::new(640, 480);
            stamp(&mut p, ms);
            for y in &mut p.y {
                *y = (126.0 + fade * (f64::from(*y) - 126.0)) as u8;
            }
            prop_assert_eq!(read_stamp(640, &p.y), Some(ms as u32));
        }
    }

    #[test]
    fn a_picture_without_the_row_has_no_time() {
        let p = Picture::new(640, 480);
        assert_eq!(read_stamp(640, &p.y), None);
        assert_eq!(read_stamp(640, &[200; 640 * 480]), None);
        assert_eq!(read_stamp(640, &[]), None);
    }

    #[test]
    fn people_read_hours_minutes_and_seconds() {
        let mut a = Picture::new(640, 480);
        let mut b = a.clone();
        stamp(&mut a, 1_000);
        stamp(&mut b, 1_000 + 86_400_000);
        // The same time of the day: the same digits.
        assert_eq!(a.y[640 * 100..], b.y[640 * 100..]);
        stamp(&mut b, 2_000);
        assert_ne!(a.y[640 * 100..], b.y[640 * 100..]);
    }
}
