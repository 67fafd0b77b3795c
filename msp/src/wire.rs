//! Little-endian fields: how one field of a payload is read and written. Everything in
//! [`crate::message`] is made of these.

use arrayvec::ArrayVec;
use std::fmt;

/// Why a payload is not the message its command announces.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ParseError {
    /// The payload ends inside a field that every firmware sends.
    #[error("{name} ({command}) needs at least {needs} bytes, got {got}", name = crate::command::name(*.command))]
    TooShort {
        /// Command number.
        command: u16,
        /// Bytes needed up to the end of the field that is cut.
        needs: usize,
        /// Bytes present.
        got: usize,
    },
    /// The payload has more elements than any firmware known to this crate sends.
    #[error("{name} ({command}) holds at most {holds} elements here, got a payload of {got} bytes", name = crate::command::name(*.command))]
    TooLong {
        /// Command number.
        command: u16,
        /// Elements (or characters) the field can hold.
        holds: usize,
        /// Bytes present.
        got: usize,
    },
}

/// A cursor over one payload.
pub(crate) struct Reader<'a> {
    command: u16,
    payload: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    pub(crate) const fn new(command: u16, payload: &'a [u8]) -> Self {
        Self {
            command,
            payload,
            at: 0,
        }
    }

    pub(crate) const fn remaining(&self) -> usize {
        self.payload.len() - self.at
    }

    pub(crate) fn bytes(&mut self, count: usize) -> Result<&'a [u8], ParseError> {
        let end = self.at + count;
        let Some(bytes) = self.payload.get(self.at..end) else {
            return Err(ParseError::TooShort {
                command: self.command,
                needs: end,
                got: self.payload.len(),
            });
        };
        self.at = end;
        Ok(bytes)
    }

    pub(crate) fn array<const N: usize>(&mut self) -> Result<[u8; N], ParseError> {
        let mut array = [0; N];
        array.copy_from_slice(self.bytes(N)?);
        Ok(array)
    }

    pub(crate) const fn too_long(&self, holds: usize) -> ParseError {
        ParseError::TooLong {
            command: self.command,
            holds,
            got: self.payload.len(),
        }
    }
}

/// A field that knows its bytes.
pub(crate) trait Wire: Sized {
    /// Reads the field and moves the cursor past it.
    fn read(reader: &mut Reader<'_>) -> Result<Self, ParseError>;
    /// Appends the field.
    fn write(&self, out: &mut Vec<u8>);
}

macro_rules! integers {
    ($($int:ty),*) => {$(
        impl Wire for $int {
            fn read(reader: &mut Reader<'_>) -> Result<Self, ParseError> {
                Ok(Self::from_le_bytes(reader.array()?))
            }
            fn write(&self, out: &mut Vec<u8>) {
                out.extend_from_slice(&self.to_le_bytes());
            }
        }
    )*};
}
integers!(u8, u16, i16, u32, i32, u64);

impl<T: Wire + Copy + Default, const N: usize> Wire for [T; N] {
    fn read(reader: &mut Reader<'_>) -> Result<Self, ParseError> {
        let mut array = [T::default(); N];
        for element in &mut array {
            *element = T::read(reader)?;
        }
        Ok(array)
    }
    fn write(&self, out: &mut Vec<u8>) {
        for element in self {
            element.write(out);
        }
    }
}

/// A field that newer firmware appends: absent when the payload has ended, an error when it ends
/// inside the field.
impl<T: Wire> Wire for Option<T> {
    fn read(reader: &mut Reader<'_>) -> Result<Self, ParseError> {
        if reader.remaining() == 0 {
            Ok(None)
        } else {
            T::read(reader).map(Some)
        }
    }
    fn write(&self, out: &mut Vec<u8>) {
        if let Some(field) = self {
            field.write(out);
        }
    }
}

/// A list that fills the rest of the payload.
impl<T: Wire, const N: usize> Wire for ArrayVec<T, N> {
    fn read(reader: &mut Reader<'_>) -> Result<Self, ParseError> {
        let mut list = Self::new();
        while reader.remaining() > 0 {
            let element = T::read(reader)?;
            list.try_push(element).map_err(|_| reader.too_long(N))?;
        }
        Ok(list)
    }
    fn write(&self, out: &mut Vec<u8>) {
        for element in self {
            element.write(out);
        }
    }
}

/// Bytes that are characters, for programs that print them.
pub(crate) fn characters<S: serde::Serializer>(
    bytes: impl AsRef<[u8]>,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(&String::from_utf8_lossy(bytes.as_ref()))
}

/// Bytes that are one long number, for programs that print them.
pub(crate) fn hexadecimal<S: serde::Serializer>(
    bytes: &Option<[u8; 32]>,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    let digits = |bytes: &[u8; 32]| bytes.iter().map(|byte| format!("{byte:02x}")).collect();
    let text: Option<String> = bytes.as_ref().map(digits);
    serde::Serialize::serialize(&text, serializer)
}

/// Characters without a length of their own: they fill the rest of the payload (at most 512, the
/// output buffer of the firmwares).
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LongText(pub ArrayVec<u8, 512>);

/// A string with its length in front (one byte on the wire; at most 64 characters).
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ShortText(pub ArrayVec<u8, 64>);

macro_rules! texts {
    ($($text:ident $capacity:literal),*) => {$(
        impl $text {
            /// Keeps the first characters of `text`, as many as fit.
            #[must_use]
            pub fn new(text: &str) -> Self {
                Self(text.bytes().take($capacity).collect())
            }

            /// The characters, or what precedes the first byte that is not UTF-8.
            #[must_use]
            pub fn as_str(&self) -> &str {
                match std::str::from_utf8(&self.0) {
                    Ok(text) => text,
                    Err(error) => std::str::from_utf8(&self.0[..error.valid_up_to()]).unwrap_or(""),
                }
            }
        }

        impl serde::Serialize for $text {
            fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.serialize_str(&String::from_utf8_lossy(&self.0))
            }
        }

        impl fmt::Display for $text {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(self.as_str())
            }
        }
    )*};
}
texts!(LongText 512, ShortText 64);

impl Wire for LongText {
    fn read(reader: &mut Reader<'_>) -> Result<Self, ParseError> {
        ArrayVec::read(reader).map(Self)
    }
    fn write(&self, out: &mut Vec<u8>) {
        out.extend_from_slice(&self.0);
    }
}

impl Wire for ShortText {
    fn read(reader: &mut Reader<'_>) -> Result<Self, ParseError> {
        let length = u8::read(reader)?;
        let bytes = reader.bytes(length.into())?;
        ArrayVec::try_from(bytes)
            .map(Self)
            .map_err(|_| reader.too_long(64))
    }
    fn write(&self, out: &mut Vec<u8>) {
        out.push(u8::try_from(self.0.len()).unwrap_or(u8::MAX));
        out.extend_from_slice(&self.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn integers_are_little_endian() {
        let mut reader = Reader::new(0, &[0x34, 0x12, 0xff, 0xff]);
        assert_eq!(u16::read(&mut reader), Ok(0x1234));
        assert_eq!(i16::read(&mut reader), Ok(-1));
    }

    #[test]
    fn a_field_cut_in_the_middle_says_how_many_bytes_it_needs() {
        let mut reader = Reader::new(109, &[1, 2, 3]);
        assert_eq!(u16::read(&mut reader), Ok(0x0201));
        let error = i32::read(&mut reader).unwrap_err();
        assert_eq!(
            error,
            ParseError::TooShort {
                command: 109,
                needs: 6,
                got: 3
            }
        );
        assert_eq!(
            error.to_string(),
            "MSP_ALTITUDE (109) needs at least 6 bytes, got 3"
        );
    }

    #[test]
    fn an_appended_field_may_be_absent_but_not_half_there() {
        assert_eq!(Option::<u16>::read(&mut Reader::new(0, &[])), Ok(None));
        assert_eq!(
            Option::<u16>::read(&mut Reader::new(0, &[1, 0])),
            Ok(Some(1))
        );
        assert!(Option::<u16>::read(&mut Reader::new(0, &[1])).is_err());
    }

    #[test]
    fn a_list_longer_than_its_room_is_an_error_not_a_panic() {
        let error = ArrayVec::<u8, 2>::read(&mut Reader::new(7, &[1, 2, 3])).unwrap_err();
        assert_eq!(
            error,
            ParseError::TooLong {
                command: 7,
                holds: 2,
                got: 3
            }
        );
    }

    #[test]
    fn text_stops_at_the_first_byte_that_is_not_text() {
        assert_eq!(ShortText::new("SITL").as_str(), "SITL");
        assert_eq!(
            ShortText(ArrayVec::try_from(&b"ab\xffcd"[..]).unwrap()).as_str(),
            "ab"
        );
    }
}
