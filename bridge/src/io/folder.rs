//! The folders of [`crate::gcs::disk`]: jobs of the ground side carried out on the real disk.
//!
//! Names are checked again here, and every file is opened below an open folder without following links, so that neither a
//! name nor what somebody put into the folder leads anywhere else.

use crate::gcs::disk::{DiskJob, DiskReply, FileEntry, Folder, is_plain_name};
use rustix::fs::{AtFlags, FileType, Mode, OFlags, openat, statat, unlinkat};
use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt as _;
use std::path::Path;

/// Longest answer to a read.
const MAX_READ: u32 = 1 << 17;

/// Does a job in the folders below `base`. `writing` is the run whose logs are being written and must stay.
#[must_use]
pub fn carry_out(base: Option<&Path>, writing: Option<&str>, job: &DiskJob) -> DiskReply {
    let Some(base) = base else {
        return DiskReply::NotFound;
    };
    match try_to(base, writing, job) {
        Ok(reply) => reply,
        Err(e) if e.kind() == io::ErrorKind::NotFound => DiskReply::NotFound,
        Err(_) => DiskReply::Failed,
    }
}

fn try_to(base: &Path, writing: Option<&str>, job: &DiskJob) -> io::Result<DiskReply> {
    match job {
        DiskJob::List(folder) => list(base, *folder).map(DiskReply::Files),
        DiskJob::Read {
            folder,
            name,
            offset,
            len,
        } => {
            let file = open(base, *folder, name, OFlags::RDONLY)?;
            let mut bytes = vec![0; (*len).min(MAX_READ) as usize];
            let mut filled = 0;
            while filled < bytes.len() {
                match file.read_at(&mut bytes[filled..], offset + filled as u64)? {
                    0 => break,
                    n => filled += n,
                }
            }
            bytes.truncate(filled);
            Ok(DiskReply::Bytes(bytes))
        }
        DiskJob::Create(name) => {
            std::fs::create_dir_all(base.join(Folder::Upload.name()))?;
            let flags = OFlags::WRONLY | OFlags::CREATE | OFlags::TRUNC;
            open(base, Folder::Upload, name, flags).map(|_| DiskReply::Done)
        }
        DiskJob::Write {
            name,
            offset,
            bytes,
        } => {
            let file = open(base, Folder::Upload, name, OFlags::WRONLY)?;
            file.write_all_at(bytes, *offset).map(|()| DiskReply::Done)
        }
        DiskJob::Remove(name) => remove(base, Folder::Upload, name).map(|()| DiskReply::Done),
        DiskJob::EraseLogs => {
            for file in list(base, Folder::Logs)? {
                if Some(super::logger::run_of(&file.name)) != writing {
                    remove(base, Folder::Logs, &file.name)?;
                }
            }
            Ok(DiskReply::Done)
        }
    }
}

/// The folder itself; a link in its place is no folder.
fn folder(base: &Path, folder: Folder) -> io::Result<std::os::fd::OwnedFd> {
    let flags = OFlags::DIRECTORY | OFlags::NOFOLLOW | OFlags::CLOEXEC;
    let base = rustix::fs::open(base, OFlags::DIRECTORY | OFlags::CLOEXEC, Mode::empty())?;
    Ok(openat(base, folder.name(), flags, Mode::empty())?)
}

/// A regular file of a folder.
fn open(base: &Path, in_folder: Folder, name: &str, flags: OFlags) -> io::Result<File> {
    if !is_plain_name(name) {
        return Err(io::ErrorKind::InvalidInput.into());
    }
    // Without NONBLOCK a pipe in the folder would hold up its opener.
    let flags = flags | OFlags::NOFOLLOW | OFlags::CLOEXEC | OFlags::NONBLOCK;
    let file = openat(
        folder(base, in_folder)?,
        name,
        flags,
        Mode::from_raw_mode(0o640),
    )?;
    let file = File::from(file);
    if !file.metadata()?.is_file() {
        return Err(io::ErrorKind::InvalidInput.into());
    }
    Ok(file)
}

fn remove(base: &Path, in_folder: Folder, name: &str) -> io::Result<()> {
    if !is_plain_name(name) {
        return Err(io::ErrorKind::InvalidInput.into());
    }
    Ok(unlinkat(folder(base, in_folder)?, name, AtFlags::empty())?)
}

/// Regular files with plain names, sorted.
fn list(base: &Path, in_folder: Folder) -> io::Result<Vec<FileEntry>> {
    let at = folder(base, in_folder)?;
    let mut files = Vec::new();
    for entry in rustix::fs::Dir::read_from(&at)? {
        let entry = entry?;
        let Ok(name) = entry.file_name().to_str() else {
            continue;
        };
        if !is_plain_name(name) {
            continue;
        }
        let stat = statat(&at, name, AtFlags::SYMLINK_NOFOLLOW)?;
        if FileType::from_raw_mode(stat.st_mode) == FileType::RegularFile {
            files.push(FileEntry {
                name: name.to_owned(),
                len: u64::try_from(stat.st_size).unwrap_or(0),
                utc_s: u32::try_from(stat.st_mtime).unwrap_or(0),
            });
        }
    }
    files.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(files)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn files_are_written_read_listed_and_removed_and_links_lead_nowhere() {
        let base = std::env::temp_dir().join(format!("kestrel-folder-{}", std::process::id()));
        fs::create_dir_all(&base).unwrap();
        let act = |job: DiskJob| carry_out(Some(&base), Some("0002"), &job);
        let read = |folder, name: &str| {
            act(DiskJob::Read {
                folder,
                name: name.to_owned(),
                offset: 1,
                len: 100,
            })
        };
        assert_eq!(act(DiskJob::List(Folder::Upload)), DiskReply::NotFound);
        assert_eq!(act(DiskJob::Create("a".to_owned())), DiskReply::Done);
        let write = DiskJob::Write {
            name: "a".to_owned(),
            offset: 0,
            bytes: b"hello".to_vec(),
        };
        assert_eq!(act(write), DiskReply::Done);
        assert_eq!(
            read(Folder::Upload, "a"),
            DiskReply::Bytes(b"ello".to_vec())
        );

        let secret = base.join("secret");
        fs::write(&secret, "secret").unwrap();
        std::os::unix::fs::symlink(&secret, base.join("upload/link")).unwrap();
        std::os::unix::fs::symlink(&base, base.join("logs")).unwrap();
        assert_eq!(read(Folder::Upload, "link"), DiskReply::Failed);
        assert_eq!(act(DiskJob::Create("link".to_owned())), DiskReply::Failed);
        assert_eq!(read(Folder::Logs, "secret"), DiskReply::Failed);
        for name in ["../secret", "/etc/passwd", "..", "a\0b"] {
            assert_eq!(read(Folder::Upload, name), DiskReply::Failed, "{name:?}");
            assert_eq!(act(DiskJob::Remove(name.to_owned())), DiskReply::Failed);
        }
        let DiskReply::Files(files) = act(DiskJob::List(Folder::Upload)) else {
            panic!("no list")
        };
        assert_eq!(
            files
                .iter()
                .map(|f| (f.name.as_str(), f.len))
                .collect::<Vec<_>>(),
            [("a", 5)]
        );
        assert_eq!(act(DiskJob::Remove("a".to_owned())), DiskReply::Done);
        assert_eq!(read(Folder::Upload, "a"), DiskReply::NotFound);
        assert_eq!(fs::read_to_string(&secret).unwrap(), "secret");

        fs::remove_file(base.join("logs")).unwrap();
        fs::create_dir(base.join("logs")).unwrap();
        for name in ["0001.mcap", "0002.mcap", "0002-2.tlog"] {
            fs::write(base.join("logs").join(name), "x").unwrap();
        }
        assert_eq!(act(DiskJob::EraseLogs), DiskReply::Done);
        assert!(!base.join("logs/0001.mcap").exists());
        assert!(base.join("logs/0002.mcap").exists() && base.join("logs/0002-2.tlog").exists());
        fs::remove_dir_all(&base).unwrap();
        assert_eq!(
            carry_out(None, None, &DiskJob::EraseLogs),
            DiskReply::NotFound
        );
    }
}
