//! Folders as ListDirectory tells them.

use super::super::disk::{FileEntry, Folder};
use super::super::metadata::FILES;
use super::payload::{DATA_LEN, Refusal};

/// Entries of the root.
pub(super) fn root() -> Vec<String> {
    let folders = [Folder::Logs, Folder::Upload].map(|f| format!("D{}", f.name()));
    let files = FILES
        .iter()
        .map(|f| format!("F{}\t{}", f.name, f.bytes.len()));
    folders.into_iter().chain(files).collect()
}

pub(super) fn line(file: &FileEntry) -> String {
    format!("F{}\t{}", file.name, file.len)
}

/// As many entries from `first` on as fit, each ended by NUL.
pub(super) fn listing(entries: &[String], first: u32) -> Result<Vec<u8>, Refusal> {
    let first = usize::try_from(first).map_err(|_| Refusal::EndOfFile)?;
    let mut data = Vec::with_capacity(DATA_LEN);
    for entry in entries.iter().skip(first) {
        if data.len() + entry.len() + 1 > DATA_LEN {
            break;
        }
        data.extend(entry.bytes());
        data.push(0);
    }
    if data.is_empty() {
        return Err(Refusal::EndOfFile);
    }
    Ok(data)
}
