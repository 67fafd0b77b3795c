//! Documents on disk (parameters, plans), written so that a power cut leaves the old or the new one, never a torn one.

use crate::gcs::Document;
use crate::gcs::disk::{DiskJob, DiskReply, Folder, is_plain_name};
use std::fs::{self, File};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

/// A folder of documents, or nowhere.
#[derive(Clone, Debug)]
pub struct Keep {
    folder: Option<PathBuf>,
    /// The flight log that is being written.
    log: Option<String>,
}

/// Flight logs kept; older ones make room.
const MAX_LOGS: usize = 20;
/// Ending of flight logs.
const LOG_ENDING: &str = ".kfl";

impl Keep {
    /// Documents are kept in a folder (made if it is not there), or forgotten.
    ///
    /// # Errors
    /// The folder cannot be made.
    pub fn in_folder(folder: Option<&Path>) -> io::Result<Self> {
        if let Some(folder) = folder {
            fs::create_dir_all(folder)?;
        }
        Ok(Self {
            folder: folder.map(Path::to_owned),
            log: None,
        })
    }

    /// Writes a document: a new file, flushed, then renamed over the old one.
    ///
    /// # Errors
    /// The disk says no; the old document is still there.
    pub fn write(&self, document: &Document) -> io::Result<()> {
        let Some(folder) = &self.folder else {
            return Ok(());
        };
        let path = folder.join(document.name);
        let fresh = folder.join(format!("{}.new", document.name));
        let mut file = File::create(&fresh)?;
        file.write_all(&document.bytes)?;
        file.sync_all()?;
        fs::rename(&fresh, &path)?;
        // The rename itself must reach the disk too.
        File::open(folder)?.sync_all()
    }

    /// Reads a document, if there is one.
    ///
    /// # Errors
    /// It is there and cannot be read.
    pub fn read(&self, name: &str) -> io::Result<Option<Vec<u8>>> {
        let Some(folder) = &self.folder else {
            return Ok(None);
        };
        match fs::read(folder.join(name)) {
            Ok(bytes) => Ok(Some(bytes)),
            Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(e) => Err(e),
        }
    }
}

impl Keep {
    /// Does a job for the ground side ([`super::folder`]).
    #[must_use]
    pub fn carry_out(&self, job: &DiskJob) -> DiskReply {
        super::folder::carry_out(self.folder.as_deref(), self.log.as_deref(), job)
    }

    /// Path of a fresh flight log, numbered on from the last one; the oldest make room. None without a folder.
    ///
    /// # Errors
    /// The disk says no.
    pub fn fresh_log(&mut self) -> io::Result<Option<PathBuf>> {
        let Some(folder) = &self.folder else {
            return Ok(None);
        };
        let folder = folder.join(Folder::Logs.name());
        fs::create_dir_all(&folder)?;
        let mut numbers = Vec::new();
        for entry in fs::read_dir(&folder)? {
            let name = entry?.file_name();
            let number = name
                .to_str()
                .filter(|n| is_plain_name(n))
                .and_then(|n| n.strip_suffix(LOG_ENDING))
                .and_then(|n| n.parse::<u32>().ok());
            numbers.extend(number);
        }
        numbers.sort_unstable();
        let name = |number: u32| format!("{number:04}{LOG_ENDING}");
        for old in numbers.iter().rev().skip(MAX_LOGS - 1) {
            fs::remove_file(folder.join(name(*old)))?;
        }
        let fresh = name(numbers.last().map_or(1, |last| last.saturating_add(1)));
        let path = folder.join(&fresh);
        self.log = Some(fresh);
        Ok(Some(path))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn logs_are_numbered_on_and_the_oldest_make_room() {
        let folder = std::env::temp_dir().join(format!("kestrel-logs-{}", std::process::id()));
        let mut keep = Keep::in_folder(Some(&folder)).unwrap();
        for i in 1..=25 {
            let path = keep.fresh_log().unwrap().unwrap();
            assert!(path.ends_with(format!("logs/{i:04}.kfl")), "{path:?}");
            fs::write(path, "x").unwrap();
        }
        let DiskReply::Files(files) = keep.carry_out(&DiskJob::List(Folder::Logs)) else {
            panic!("no list")
        };
        let names: Vec<_> = files.iter().map(|f| f.name.as_str()).collect();
        assert_eq!(
            (names.len(), names[0], names[19]),
            (20, "0006.kfl", "0025.kfl")
        );
        fs::remove_dir_all(&folder).unwrap();
        assert_eq!(Keep::in_folder(None).unwrap().fresh_log().unwrap(), None);
    }

    #[test]
    fn a_document_is_replaced_whole() {
        let folder = std::env::temp_dir().join(format!("kestrel-keep-{}", std::process::id()));
        let keep = Keep::in_folder(Some(&folder)).unwrap();
        assert_eq!(keep.read("a.toml").unwrap(), None);
        for text in ["first", "second, longer"] {
            keep.write(&Document {
                name: "a.toml",
                bytes: text.as_bytes().to_vec(),
            })
            .unwrap();
            assert_eq!(keep.read("a.toml").unwrap().unwrap(), text.as_bytes());
        }
        fs::remove_dir_all(&folder).unwrap();
        let nowhere = Keep::in_folder(None).unwrap();
        nowhere
            .write(&Document {
                name: "a.toml",
                bytes: vec![1],
            })
            .unwrap();
        assert_eq!(nowhere.read("a.toml").unwrap(), None);
    }
}
