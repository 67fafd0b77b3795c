//! What a typed line means: a word, keys, a marker, or nothing we know.

use crate::autopilot::door::{Key, Step};
use arrayvec::ArrayVec;

/// Most keys of one line.
pub(super) const MAX_KEYS: usize = 64;

const ESC: u8 = 0x1B;
const BACKSPACE: u8 = 0x08;
const DELETE: u8 = 0x7F;

/// A key and the letter it was typed as.
pub(super) type Typed = (char, Key);

/// A line between two ENTERs.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Line {
    /// One of the words of [`HELP`].
    Word(Word),
    /// Letters of the key table only, `m` included; or a lone ESC; or nothing but ENTER.
    Keys(Vec<Typed>),
    /// A known word with wrong arguments: how to write it.
    Usage(&'static str),
    /// Neither; the first letter that is no key.
    Unknown(char),
}

/// A command of the console.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Word {
    Help,
    Status,
    Arm,
    Disarm,
    /// Height in m, if given.
    Takeoff(Option<f64>),
    Land,
    Hold,
    Return,
    ParamGet(String),
    ParamSet(String, String),
}

/// Shown by `help`; every word and key is in it (a test reads it).
pub(super) const HELP: &str = "\
arm, disarm, takeoff [height], land, hold, return, status
param get NAME, param set NAME VALUE
m        manual mode on/off (flying, mode Hold); then letters, ENTER:
j g      roll right, left       0.045 rad
y h      nose down, up          0.045 rad
q w      turn left, right       0.045 rad
e d      up, down               0.2 m
8 2 6 4  forward, back, right, left 0.2 m
i k 0    mass +, - 0.05 kg, default
ESC      land; on the ground: motors off
ENTER    marker in the log
";

/// The key of a letter (uQuad's table, with the nudges 8 2 4 6), ESC or ENTER.
#[must_use]
pub(in super::super) const fn key(code: u8) -> Option<Key> {
    use Step::{Minus, Plus};
    Some(match code {
        b'm' => Key::ToggleManual,
        b'j' => Key::Roll(Plus),
        b'g' => Key::Roll(Minus),
        b'y' => Key::NoseDown(Plus),
        b'h' => Key::NoseDown(Minus),
        b'q' => Key::YawLeft(Plus),
        b'w' => Key::YawLeft(Minus),
        b'e' => Key::Height(Plus),
        b'd' => Key::Height(Minus),
        b'i' => Key::Mass(Plus),
        b'k' => Key::Mass(Minus),
        b'0' => Key::MassDefault,
        b'8' => Key::NudgeForward(Plus),
        b'2' => Key::NudgeForward(Minus),
        b'6' => Key::NudgeRight(Plus),
        b'4' => Key::NudgeRight(Minus),
        b'\r' | b'\n' => Key::Marker,
        ESC => Key::Escape,
        _ => return None,
    })
}

impl Line {
    /// Reads a line without its ENTER.
    pub(super) fn parse(bytes: &[u8]) -> Self {
        let one = |letter: char, key: Key| Self::Keys(vec![(letter, key)]);
        let plain = without_escapes(bytes);
        // ESC is the key to reach for in trouble: it counts wherever it stands in a line, and nothing else of it does.
        if plain.contains(&ESC) {
            return one('\u{1B}', Key::Escape);
        }
        let text = String::from_utf8_lossy(&plain);
        let text = text.trim();
        if text.is_empty() {
            return one('\r', Key::Marker);
        }
        if let Some(line) = word(text) {
            return line;
        }
        let mut keys = Vec::new();
        for letter in text.chars() {
            match u8::try_from(letter).ok().and_then(key) {
                Some(key) if keys.len() < MAX_KEYS => keys.push((letter, key)),
                _ => return Self::Unknown(letter),
            }
        }
        Self::Keys(keys)
    }
}

fn word(text: &str) -> Option<Line> {
    let words: ArrayVec<&str, 5> = text.split_ascii_whitespace().take(5).collect();
    Some(Line::Word(match words.as_slice() {
        ["help"] => Word::Help,
        ["status"] => Word::Status,
        ["arm"] => Word::Arm,
        ["disarm"] => Word::Disarm,
        ["takeoff"] => Word::Takeoff(None),
        ["takeoff", height] => match height.parse::<f64>() {
            Ok(height) if height.is_finite() && height > 0.0 => Word::Takeoff(Some(height)),
            _ => return Some(Line::Usage("takeoff [height in m]")),
        },
        ["land"] => Word::Land,
        ["hold"] => Word::Hold,
        ["return"] => Word::Return,
        ["param", "get", name] => Word::ParamGet((*name).to_owned()),
        ["param", "set", name, value] => Word::ParamSet((*name).to_owned(), (*value).to_owned()),
        ["param", ..] => return Some(Line::Usage("param get NAME | param set NAME VALUE")),
        ["takeoff", ..] => return Some(Line::Usage("takeoff [height in m]")),
        _ => return None,
    }))
}

/// The bytes without terminal escape sequences (arrow keys: `ESC [ ... letter`, `ESC O letter`), with what backspace
/// takes back taken back. A lone ESC stays.
fn without_escapes(bytes: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(bytes.len());
    let mut rest = bytes;
    while let Some((&byte, after)) = rest.split_first() {
        rest = match (byte, after) {
            (ESC, [b'[', sequence @ ..]) => {
                match sequence.iter().position(|b| (0x40..=0x7E).contains(b)) {
                    Some(last) => &sequence[last + 1..],
                    None => &[],
                }
            }
            (ESC, [b'O', _, after @ ..]) => after,
            (BACKSPACE | DELETE, after) => {
                out.pop();
                after
            }
            (byte, after) => {
                out.push(byte);
                after
            }
        };
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn keys(text: &str) -> Vec<Key> {
        match Line::parse(text.as_bytes()) {
            Line::Keys(keys) => keys.into_iter().map(|(_, key)| key).collect(),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn every_letter_of_the_table_does_what_the_table_says() {
        use Step::{Minus, Plus};
        for (letter, expect) in [
            ("m", Key::ToggleManual),
            ("j", Key::Roll(Plus)),
            ("g", Key::Roll(Minus)),
            ("y", Key::NoseDown(Plus)),
            ("h", Key::NoseDown(Minus)),
            ("q", Key::YawLeft(Plus)),
            ("w", Key::YawLeft(Minus)),
            ("e", Key::Height(Plus)),
            ("d", Key::Height(Minus)),
            ("i", Key::Mass(Plus)),
            ("k", Key::Mass(Minus)),
            ("0", Key::MassDefault),
            ("8", Key::NudgeForward(Plus)),
            ("2", Key::NudgeForward(Minus)),
            ("6", Key::NudgeRight(Plus)),
            ("4", Key::NudgeRight(Minus)),
            ("", Key::Marker),
            ("\u{1B}", Key::Escape),
        ] {
            assert_eq!(keys(letter), [expect], "{letter}");
        }
    }

    #[test]
    fn a_line_of_letters_is_taken_one_by_one_and_one_wrong_letter_refuses_it() {
        assert_eq!(keys("jje").len(), 3);
        assert_eq!(Line::parse(b"jjx"), Line::Unknown('x'));
        assert_eq!(Line::parse(b"jJ"), Line::Unknown('J'));
        assert_eq!(
            Line::parse(&[b'j'; MAX_KEYS + 1]),
            Line::Unknown('j'),
            "too many at once"
        );
    }

    #[test]
    fn a_word_is_the_word_even_where_its_letters_are_keys() {
        assert_eq!(Line::parse(b" help "), Line::Word(Word::Help));
        assert_eq!(
            Line::parse(b"takeoff 1.5"),
            Line::Word(Word::Takeoff(Some(1.5)))
        );
        assert!(matches!(Line::parse(b"takeoff nan"), Line::Usage(_)));
        assert!(matches!(Line::parse(b"takeoff -1"), Line::Usage(_)));
        assert!(matches!(Line::parse(b"param list"), Line::Usage(_)));
        let set = Line::Word(Word::ParamSet("A".to_owned(), "1".to_owned()));
        assert_eq!(Line::parse(b"param set A 1"), set);
        assert_eq!(Line::parse(b"landing"), Line::Unknown('l'));
    }

    #[test]
    fn arrow_keys_are_swallowed_and_a_lone_escape_is_not() {
        assert_eq!(
            keys("\u{1B}[A\u{1B}[1;5Cj\u{1B}OP"),
            [Key::Roll(Step::Plus)]
        );
        assert_eq!(
            keys("jj\u{1B}"),
            [Key::Escape],
            "whatever else the line says"
        );
        assert_eq!(keys("\u{1B}[A"), [Key::Marker]);
    }

    #[test]
    fn backspace_takes_back() {
        assert_eq!(keys("jg\u{8}\u{7F}e"), [Key::Height(Step::Plus)]);
    }

    #[test]
    fn help_names_every_letter_and_word() {
        for code in 0x20..0x7F {
            if key(code).is_some() {
                let letter = char::from(code);
                let starts_a_column = |l: &str| {
                    l.split("  ")
                        .next()
                        .is_some_and(|k| k.split(' ').any(|k| k.contains(letter)))
                };
                assert!(HELP.lines().any(starts_a_column), "{letter}");
            }
        }
        assert!(HELP.is_ascii());
    }

    proptest! {
        #[test]
        fn no_bytes_panic(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
            let _ = Line::parse(&bytes);
        }
    }
}
