//! Open files.

use super::super::Peer;
use super::super::disk::{Block, DiskJob, Folder, cut};
use super::payload::{DATA_LEN, Payload};
use vehicle::Timestamp;

/// Bytes read from the disk at once: packets of a burst are cut from it.
pub(super) const BLOCK_LEN: u32 = (DATA_LEN * 64) as u32;

/// Where the bytes of an open file are.
#[derive(Clone, Debug)]
pub(super) enum Source {
    /// Metadata.
    Memory(&'static [u8]),
    /// On disk.
    Disk(Folder, String),
}

/// An open file.
#[derive(Debug)]
pub(super) struct Session {
    pub(super) number: u8,
    pub(super) peer: Peer,
    pub(super) source: Source,
    pub(super) len: u64,
    pub(super) is_for_writing: bool,
    pub(super) heard_at: Timestamp,
    /// What of it came from the disk last.
    pub(super) block: Block,
    /// A burst under way: the request, the next byte, the next seq.
    pub(super) burst: Option<(Payload, u64, u16)>,
}

impl Session {
    /// Bytes from an offset on, at most so many; none if they must come from the disk first.
    pub(super) fn bytes(&self, at: u64, most: usize) -> Option<&[u8]> {
        match &self.source {
            Source::Memory(bytes) => cut(bytes, at, most),
            Source::Disk(..) => self.block.get(at, most),
        }
    }

    /// What to ask the disk for.
    pub(super) fn job(&self, at: u64) -> Option<DiskJob> {
        match &self.source {
            Source::Memory(_) => None,
            Source::Disk(folder, name) => Some(DiskJob::Read {
                folder: *folder,
                name: name.clone(),
                offset: at,
                len: BLOCK_LEN,
            }),
        }
    }
}
