//! What services want from the disk, as values: they name a file of one of our two folders, the shell does it and answers.
//!
//! A name is one plain component ([`is_plain_name`]): no service can even say a path that climbs out of its folder. The
//! shell adds the rest (`io/folder.rs`): no links are followed, nothing but regular files is opened.

use core::time::Duration;

/// A disk that does not answer in this time is broken.
pub const TIMEOUT: Duration = Duration::from_secs(2);
/// Time between two bursts of packets that are cut from a file.
pub const PUMP_PERIOD: Duration = Duration::from_millis(5);

/// A piece of a file that came from the disk, of which packets are cut.
#[derive(Clone, Debug, Default)]
pub struct Block {
    at: u64,
    bytes: Vec<u8>,
}

impl Block {
    /// Bytes that begin at an offset of the file.
    #[must_use]
    pub const fn new(at: u64, bytes: Vec<u8>) -> Self {
        Self { at, bytes }
    }

    /// At most so many bytes from an offset of the file on; none if they must come from the disk first.
    #[must_use]
    pub fn get(&self, at: u64, most: usize) -> Option<&[u8]> {
        cut(&self.bytes, at.checked_sub(self.at)?, most)
    }

    /// True if nothing is in it.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }
}

/// At most so many bytes from a place on; none at the end.
#[must_use]
pub fn cut(bytes: &[u8], at: u64, most: usize) -> Option<&[u8]> {
    let rest = bytes.get(usize::try_from(at).ok()?..)?;
    (!rest.is_empty()).then(|| &rest[..most.min(rest.len())])
}

/// A job on its way; its answer carries the same number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ticket(pub u32);

/// A folder beside the stored documents.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Folder {
    /// Flight logs; written by the shell, read and erased from the ground.
    Logs,
    /// What ground stations leave here.
    Upload,
}

impl Folder {
    /// Name of the folder, on disk and in FTP paths.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Logs => "logs",
            Self::Upload => "upload",
        }
    }
}

/// One thing to do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum DiskJob {
    /// What is in a folder, sorted by name.
    List(Folder),
    /// Bytes of a file; fewer at its end.
    Read {
        /// Where.
        folder: Folder,
        /// Which file.
        name: String,
        /// First byte.
        offset: u64,
        /// Most bytes.
        len: u32,
    },
    /// A file made empty, whether it was there or not; only in [`Folder::Upload`].
    Create(String),
    /// Bytes written into an uploaded file that is there.
    Write {
        /// Which file.
        name: String,
        /// First byte.
        offset: u64,
        /// What.
        bytes: Vec<u8>,
    },
    /// An uploaded file removed.
    Remove(String),
    /// All flight logs removed but the one being written.
    EraseLogs,
}

/// One file of a folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FileEntry {
    /// Name, one plain component.
    pub name: String,
    /// Bytes.
    pub len: u64,
    /// Last change, UTC seconds; 0 unknown.
    pub utc_s: u32,
}

/// How a job ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum DiskReply {
    /// Files of a folder.
    Files(Vec<FileEntry>),
    /// Bytes read.
    Bytes(Vec<u8>),
    /// It is done.
    Done,
    /// There is no such file, or no folder to keep files in.
    NotFound,
    /// The disk says no.
    Failed,
}

/// Longest name of a file.
pub const MAX_NAME_LEN: usize = 64;

/// True for a name that is one component on every file system: letters, digits, `-`, `_` and `.`, not starting with a dot.
#[must_use]
pub fn is_plain_name(name: &str) -> bool {
    (1..=MAX_NAME_LEN).contains(&name.len())
        && !name.starts_with('.')
        && name
            .bytes()
            .all(|b| b.is_ascii_alphanumeric() || matches!(b, b'-' | b'_' | b'.'))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_one_plain_component_is_a_name() {
        for good in ["0001.mcap", "plan-2_b.pgm", "A"] {
            assert!(is_plain_name(good), "{good}");
        }
        let long = "x".repeat(4096);
        for bad in [
            "",
            ".",
            "..",
            ".hidden",
            "a/b",
            "/a",
            "a\\b",
            "a\0",
            "a b",
            "\u{e4}",
            "~",
            long.as_str(),
        ] {
            assert!(!is_plain_name(bad), "{bad:?}");
        }
    }
}
