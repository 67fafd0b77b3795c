//! Documents on disk (parameters, plans), written so that a power cut leaves the old or the new one, never a torn one.

use crate::gcs::Document;
use crate::gcs::disk::{DiskJob, DiskReply, Folder};
use std::fs::{self, File};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

/// A folder of documents, or nowhere.
#[derive(Clone, Debug)]
pub struct Keep {
    folder: Option<PathBuf>,
    /// Number of the run whose logs are being written.
    run: Option<String>,
}

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
            run: None,
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
        super::folder::carry_out(self.folder.as_deref(), self.run.as_deref(), job)
    }

    /// Folder and number of a fresh run's flight logs, numbered on from the last one. None without a folder.
    ///
    /// # Errors
    /// The disk says no.
    pub fn fresh_run(&mut self) -> io::Result<Option<(PathBuf, String)>> {
        let Some(folder) = &self.folder else {
            return Ok(None);
        };
        let folder = folder.join(Folder::Logs.name());
        fs::create_dir_all(&folder)?;
        let run = super::logger::fresh_stem(&folder)?;
        self.run = Some(run.clone());
        Ok(Some((folder, run)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_are_numbered_on_and_what_they_write_is_not_erased() {
        let folder = std::env::temp_dir().join(format!("kestrel-logs-{}", std::process::id()));
        let mut keep = Keep::in_folder(Some(&folder)).unwrap();
        for i in 1..=3 {
            let (logs, run) = keep.fresh_run().unwrap().unwrap();
            assert_eq!(run, format!("{i:04}"));
            fs::write(logs.join(format!("{run}.mcap")), "x").unwrap();
            fs::write(logs.join(format!("{run}-2.tlog")), "x").unwrap();
        }
        assert_eq!(keep.carry_out(&DiskJob::EraseLogs), DiskReply::Done);
        let DiskReply::Files(files) = keep.carry_out(&DiskJob::List(Folder::Logs)) else {
            panic!("no list")
        };
        let names: Vec<_> = files.iter().map(|f| f.name.as_str()).collect();
        assert_eq!(names, ["0003-2.tlog", "0003.mcap"]);
        fs::remove_dir_all(&folder).unwrap();
        assert_eq!(Keep::in_folder(None).unwrap().fresh_run().unwrap(), None);
    }

    /// What a power cut may leave of a write: a torn new file, a whole one, or the rename done. The order on the disk is that of
    /// [`Keep::write`], because the new file is synced before the rename.
    #[test]
    fn power_cuts_at_200_instants_leave_the_old_or_the_new_document() {
        let folder = std::env::temp_dir().join(format!("kestrel-cut-{}", std::process::id()));
        let keep = Keep::in_folder(Some(&folder)).unwrap();
        let text = |i: usize| {
            format!(
                "[autopilot]\ntakeoff_height_m = {}\n",
                1.0 + i as f64 * 0.01
            )
        };
        let document = |name, i| Document {
            name,
            bytes: text(i).into_bytes(),
        };
        for name in ["parameters.toml", "mission.json"] {
            keep.write(&document(name, 0)).unwrap();
            let mut now = 0;
            for i in 1..=100 {
                let next = text(i);
                let fresh = folder.join(format!("{name}.new"));
                match i * 37 % (next.len() + 2) {
                    n if n < next.len() => fs::write(&fresh, &next[..n]).unwrap(),
                    n if n == next.len() => fs::write(&fresh, &next).unwrap(),
                    _ => {
                        keep.write(&document(name, i)).unwrap();
                        now = i;
                    }
                }
                // The next start reads what is there, whole.
                let again = Keep::in_folder(Some(&folder)).unwrap();
                assert_eq!(again.read(name).unwrap().unwrap(), text(now).into_bytes());
                // A torn leftover is in nobody's way.
                if i % 10 == 0 {
                    again.write(&document(name, i)).unwrap();
                    now = i;
                    assert_eq!(again.read(name).unwrap().unwrap(), text(i).into_bytes());
                }
            }
        }
        fs::remove_dir_all(&folder).unwrap();
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
