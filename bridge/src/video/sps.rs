//! What a sequence parameter set says of a stream: size and frame rate (ITU-T H.264 7.3.2.1.1 and E.1.1).

/// Facts of a stream.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StreamFacts {
    /// Profile, constraints and level: `profile-level-id` of SDP.
    pub profile_level: [u8; 3],
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Pictures a second, if the stream says.
    pub fps: Option<f64>,
}

/// Reads the parameter set of a stream; none if it is broken or beyond what cameras send.
#[must_use]
pub fn read(sps: &[u8]) -> Option<StreamFacts> {
    let raw = without_emulation(sps.get(1..)?);
    let profile_level = [*raw.first()?, *raw.get(1)?, *raw.get(2)?];
    let mut b = Bits {
        bytes: &raw,
        at: 24,
    };
    b.ue()?;
    let mut chroma = 1;
    if matches!(
        profile_level[0],
        100 | 110 | 122 | 244 | 44 | 83 | 86 | 118 | 128
    ) {
        chroma = b.ue()?;
        if chroma == 3 {
            b.take(1)?;
        }
        b.ue()?;
        b.ue()?;
        b.take(1)?;
        if b.take(1)? == 1 {
            for list in 0..if chroma == 3 { 12 } else { 8 } {
                if b.take(1)? == 1 {
                    b.skip_scaling_list(if list < 6 { 16 } else { 64 })?;
                }
            }
        }
    }
    b.ue()?;
    match b.ue()? {
        0 => {
            b.ue()?;
        }
        1 => {
            b.take(1)?;
            b.ue()?;
            b.ue()?;
            for _ in 0..b.ue()?.min(255) {
                b.ue()?;
            }
        }
        _ => {}
    }
    b.ue()?;
    b.take(1)?;
    let columns = b.ue()?.checked_add(1)?;
    let rows = b.ue()?.checked_add(1)?;
    let frames_only = b.take(1)?;
    if frames_only == 0 {
        b.take(1)?;
    }
    b.take(1)?;
    let [mut left, mut right, mut top, mut bottom] = [0; 4];
    if b.take(1)? == 1 {
        left = b.ue()?;
        right = b.ue()?;
        top = b.ue()?;
        bottom = b.ue()?;
    }
    let (unit_x, unit_y) = match chroma {
        1 => (2, 2),
        2 => (2, 1),
        _ => (1, 1),
    };
    let fields = 2 - frames_only;
    let cut = |a: u32, b: u32, unit: u32| a.checked_add(b)?.checked_mul(unit);
    let width = columns
        .checked_mul(16)?
        .checked_sub(cut(left, right, unit_x)?)?;
    let height = rows.checked_mul(16)?.checked_mul(fields)?.checked_sub(cut(
        top,
        bottom,
        unit_y * fields,
    )?)?;
    if !(16..=8192).contains(&width) || !(16..=8192).contains(&height) {
        return None;
    }
    let fps = if b.take(1) == Some(1) { b.fps() } else { None };
    Some(StreamFacts {
        profile_level,
        width,
        height,
        fps,
    })
}

/// Without the 03 that keeps start codes out of the data.
fn without_emulation(bytes: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(bytes.len());
    let mut zeros = 0;
    for b in bytes {
        if zeros >= 2 && *b == 3 {
            zeros = 0;
            continue;
        }
        zeros = if *b == 0 { zeros + 1 } else { 0 };
        out.push(*b);
    }
    out
}

struct Bits<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Bits<'_> {
    fn take(&mut self, n: u32) -> Option<u32> {
        let mut out = 0;
        for _ in 0..n {
            let byte = self.bytes.get(self.at / 8)?;
            out = out << 1 | u32::from(byte >> (7 - self.at % 8) & 1);
            self.at += 1;
        }
        Some(out)
    }

    /// Exp-Golomb, unsigned.
    fn ue(&mut self) -> Option<u32> {
        let mut zeros = 0;
        while self.take(1)? == 0 {
            zeros += 1;
            if zeros > 31 {
                return None;
            }
        }
        let rest = self.take(zeros)?;
        Some((1_u32 << zeros) - 1 + rest)
    }

    /// Exp-Golomb, signed.
    fn se(&mut self) -> Option<i32> {
        let v = i64::from(self.ue()?);
        let magnitude = (v + 1) / 2;
        i32::try_from(if v % 2 == 1 { magnitude } else { -magnitude }).ok()
    }

    fn skip_scaling_list(&mut self, size: u32) -> Option<()> {
        let (mut last, mut next) = (8_i32, 8_i32);
        for _ in 0..size {
            if next != 0 {
                next = last.wrapping_add(self.se()?).rem_euclid(256);
            }
            if next != 0 {
                last = next;
            }
        }
        Some(())
    }

    /// Timing of the VUI.
    fn fps(&mut self) -> Option<f64> {
        if self.take(1)? == 1 && self.take(8)? == 255 {
            self.take(32)?;
        }
        if self.take(1)? == 1 {
            self.take(1)?;
        }
        if self.take(1)? == 1 {
            self.take(4)?;
            if self.take(1)? == 1 {
                self.take(24)?;
            }
        }
        if self.take(1)? == 1 {
            self.ue()?;
            self.ue()?;
        }
        if self.take(1)? == 0 {
            return None;
        }
        let (tick, scale) = (self.take(32)?, self.take(32)?);
        let fps = f64::from(scale) / (2.0 * f64::from(tick));
        (fps.is_finite() && (0.5..=240.0).contains(&fps)).then_some(fps)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_set_of_a_baseline_encoder_is_640_by_480() {
        // Baseline 3.0; order count type 2, one reference, 40 x 30 macroblocks, frames only, no cropping, no VUI.
        let sps = [0x67, 66, 0xC0, 30, 0xDA, 0x02, 0x80, 0xF6, 0x40];
        let facts = read(&sps).unwrap();
        assert_eq!((facts.width, facts.height, facts.fps), (640, 480, None));
        assert_eq!(facts.profile_level, [66, 0xC0, 30]);
        assert_eq!(read(&sps[..6]), None, "cut short");
    }

    proptest! {
        #[test]
        fn any_bytes_are_survived(bytes in prop::collection::vec(any::<u8>(), 0..60)) {
            let _ = read(&bytes);
        }
    }
}
