//! FTP paths: a small tree of our own, never a path of the machine.
//!
//! | Path | Is |
//! | --- | --- |
//! | `/` | the root: the metadata files, `logs`, `upload` |
//! | `/general.json`, `/parameters.json`, each also `.xz` | metadata, in memory |
//! | `/logs/NAME` | a flight log, to read |
//! | `/upload/NAME` | what stations left, to read, write and remove |

use crate::gcs::disk::{Folder, is_plain_name};
use crate::gcs::metadata::{FILES, MetadataFile};

/// What a path names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Path {
    /// The root folder.
    Root,
    /// A folder on disk.
    Folder(Folder),
    /// A metadata file.
    Metadata(&'static MetadataFile),
    /// A file that may be on disk.
    File(Folder, String),
}

/// The path of a request's data; none for one that names nothing of ours. NULs may only end it.
pub(super) fn parse(data: &[u8]) -> Option<Path> {
    let len = data
        .iter()
        .rposition(|b| *b != 0)
        .map_or(0, |last| last + 1);
    let text = core::str::from_utf8(&data[..len]).ok()?;
    let text = text.strip_prefix('/').unwrap_or(text);
    let text = text.strip_suffix('/').unwrap_or(text);
    if text.is_empty() {
        // "", "/", but also "//": a folder written oddly, and no more than the root.
        return Some(Path::Root);
    }
    let folder = |name: &str| {
        [Folder::Logs, Folder::Upload]
            .into_iter()
            .find(|f| f.name() == name)
    };
    match text.split_once('/') {
        None => folder(text)
            .map(Path::Folder)
            .or_else(|| FILES.iter().find(|f| f.name == text).map(Path::Metadata)),
        Some((parent, name)) if is_plain_name(name) => {
            folder(parent).map(|f| Path::File(f, name.to_owned()))
        }
        Some(_) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tree_is_what_the_table_says() {
        assert_eq!(parse(b"/"), Some(Path::Root));
        assert_eq!(parse(b"\0\0"), Some(Path::Root));
        assert_eq!(parse(b"/logs"), Some(Path::Folder(Folder::Logs)));
        assert_eq!(parse(b"upload/"), Some(Path::Folder(Folder::Upload)));
        assert_eq!(
            parse(b"/logs/0001.mcap\0\0"),
            Some(Path::File(Folder::Logs, "0001.mcap".to_owned()))
        );
        assert!(
            matches!(parse(b"general.json.xz"), Some(Path::Metadata(f)) if f.name == "general.json.xz")
        );
        assert_eq!(parse(b"@PARAM/param.pck"), None);
    }

    #[test]
    fn paths_that_climb_are_absolute_or_odd_name_nothing() {
        let long = [b'a'; 4096];
        let mut long_upload = b"/upload/".to_vec();
        long_upload.extend(long);
        let corpus: [&[u8]; 22] = [
            b"..",
            b"/..",
            b"/../etc/passwd",
            b"/upload/..",
            b"/upload/../mission.json",
            b"/upload/../../etc/passwd",
            b"/upload/./a",
            b"/upload/.ssh",
            b"/upload//etc/passwd",
            b"//etc/passwd",
            b"/etc/passwd",
            b"/logs/a/b",
            b"/logs\\..\\x",
            b"/upload/a\0b",
            b"/up\0load/a",
            b"/upload/%2e%2e/x",
            b"/upload/\xC0\xAE\xC0\xAE/x",
            b"C:/x",
            b"~/x",
            b"/LOGS/x",
            &long,
            &long_upload,
        ];
        for path in corpus {
            assert_eq!(parse(path), None, "{:?}", String::from_utf8_lossy(path));
        }
    }
}
