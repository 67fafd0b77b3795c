//! Random bytes as edits to something that makes sense.

use bridge::io::clock::monotonic_ns;
use std::path::Path;

/// Longest input that edits may grow to.
const LONGEST: usize = 8 * 1024;
/// Most edits: more leave nothing of what made sense.
const MOST: usize = 12;

/// Bytes at which programs stumble.
const BYTES: [u8; 16] = [
    0, 1, 0x7F, 0x80, 0xFE, 0xFF, b'\n', b'"', b'{', b']', b':', b'-', b'9', b'.', b'e', b' ',
];
/// Little-endian words at which programs stumble: extremes of integers, NaN, infinity, the largest float.
const WORDS: [u32; 10] = [
    0,
    u32::MAX,
    i32::MAX as u32,
    i32::MIN as u32,
    0x7FC0_0000,
    0x7F80_0000,
    0xFF80_0000,
    0x7F7F_FFFF,
    0x0000_FFFF,
    0x8000,
];
/// Numbers as text.
const NUMBERS: [&[u8]; 8] = [
    b"0",
    b"-1",
    b"1e309",
    b"nan",
    b"-inf",
    b"99999999999999999999",
    b"65536",
    b"0.0000001",
];

/// The inputs of a plain test run: from a fixed seed, for at most two seconds.
pub(crate) fn fixed_inputs() -> impl Iterator<Item = Vec<u8>> {
    // SplitMix64 (Steele, Lea and Flood, 2014).
    let mut state = 20_000u64;
    let mut next = move || {
        state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (state ^ (state >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    };
    let start = monotonic_ns();
    (0..10_000)
        .take_while(move |_| monotonic_ns() - start < 2_000_000_000)
        .map(move |_| {
            let length = next() % 512;
            (0..length).map(|_| next() as u8).collect()
        })
}

/// Inputs of a target as they are really met.
pub(crate) struct Seeds(Vec<Vec<u8>>);

impl Seeds {
    /// The files of a target, in order of their names.
    pub(crate) fn of(name: &str) -> Self {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("fuzz/seeds")
            .join(name);
        let mut files: Vec<_> = std::fs::read_dir(&folder)
            .unwrap_or_else(|e| panic!("{}: {e}", folder.display()))
            .map(|entry| entry.unwrap().path())
            .collect();
        files.sort();
        assert!(!files.is_empty(), "{} holds no seeds", folder.display());
        Self(files.iter().map(|f| std::fs::read(f).unwrap()).collect())
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = &[u8]> {
        self.0.iter().map(Vec::as_slice)
    }

    /// A seed with the edits that `script` describes.
    pub(crate) fn edited(&self, script: &[u8]) -> Vec<u8> {
        let mut script = Script(script);
        let mut data = self.0[script.below(self.0.len())].clone();
        let mut left = 1 + script.below(MOST);
        while left > 0 && !script.0.is_empty() && !data.is_empty() {
            left -= 1;
            self.edit(&mut data, &mut script);
            data.truncate(LONGEST);
        }
        data
    }

    fn edit(&self, data: &mut Vec<u8>, script: &mut Script<'_>) {
        let at = script.below(data.len());
        match script.next() % 10 {
            0 => data[at] ^= 1 << (script.next() % 8),
            1 => data[at] = BYTES[script.below(BYTES.len())],
            2 => data[at] = script.next(),
            3 => data.insert(at, script.next()),
            4 => {
                let end = (at + 1 + script.below(32)).min(data.len());
                data.drain(at..end);
            }
            5 => {
                let end = (at + 1 + script.below(64)).min(data.len());
                let again = data[at..end].to_vec();
                let to = script.below(data.len());
                data.splice(to..to, again);
            }
            6 => data.truncate(at),
            7 => {
                let other = &self.0[script.below(self.0.len())];
                let from = script.below(other.len());
                data.splice(at..at, other[from..].iter().copied());
            }
            8 => {
                let word = WORDS[script.below(WORDS.len())].to_le_bytes();
                let end = (at + 4).min(data.len());
                data[at..end].copy_from_slice(&word[..end - at]);
            }
            _ => {
                // The number that stands there, as text.
                let digit = |b: &u8| b.is_ascii_digit() || matches!(b, b'.' | b'-');
                let Some(start) = data[at..].iter().position(digit).map(|i| at + i) else {
                    return;
                };
                let len = data[start..].iter().take_while(|b| digit(b)).count();
                let number = NUMBERS[script.below(NUMBERS.len())];
                data.splice(start..start + len, number.iter().copied());
            }
        }
    }
}

/// Bytes read one after the other; zeros at the end.
struct Script<'a>(&'a [u8]);

impl Script<'_> {
    fn next(&mut self) -> u8 {
        match self.0.split_first() {
            Some((first, rest)) => {
                self.0 = rest;
                *first
            }
            None => 0,
        }
    }

    fn below(&mut self, n: usize) -> usize {
        let word = u16::from_le_bytes([self.next(), self.next()]);
        usize::from(word) % n.max(1)
    }
}
