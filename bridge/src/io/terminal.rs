//! A pseudo terminal with a name of its own: the plug that a simulated device has.

use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use std::fs::File;
use std::io::{self, ErrorKind, Read as _, Write as _};
use std::path::{Path, PathBuf};

/// Our end of a pseudo terminal; the other end is a symbolic link that looks like a serial port. It goes with this.
#[derive(Debug)]
pub struct Terminal {
    ours: File,
    /// Held open, so that a reader that goes does not end the line.
    _theirs: File,
    link: PathBuf,
    /// While a file of this name is there the cable is cut.
    cut: PathBuf,
    /// Bytes that nobody read in time.
    pub dropped: u64,
}

impl Terminal {
    /// Opens one and names it. A link that is there already is replaced; anything else is left alone.
    ///
    /// # Errors
    /// No pseudo terminals are left, or the name cannot be made.
    pub fn open(link: &Path) -> io::Result<Self> {
        let ours = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
        grantpt(&ours)?;
        unlockpt(&ours)?;
        rustix::io::ioctl_fionbio(&ours, true)?;
        let name = ptsname(&ours, Vec::new())?;
        let name = name.to_string_lossy().into_owned();
        let theirs = rustix::fs::open(
            name.as_str(),
            rustix::fs::OFlags::RDWR | rustix::fs::OFlags::NOCTTY | rustix::fs::OFlags::CLOEXEC,
            rustix::fs::Mode::empty(),
        )?;
        let mut settings = rustix::termios::tcgetattr(&theirs)?;
        settings.make_raw();
        rustix::termios::tcsetattr(&theirs, rustix::termios::OptionalActions::Now, &settings)?;
        match std::fs::symlink_metadata(link) {
            Ok(there) if there.file_type().is_symlink() => std::fs::remove_file(link)?,
            Ok(_) => return Err(ErrorKind::AlreadyExists.into()),
            Err(_) => {}
        }
        std::os::unix::fs::symlink(&name, link)?;
        Ok(Self {
            ours: File::from(ours),
            _theirs: File::from(theirs),
            link: link.to_owned(),
            cut: cut_name(link),
            dropped: 0,
        })
    }

    /// Sends; what does not fit is dropped, as on a line that nobody listens to, and everything while the cable is cut.
    pub fn send(&mut self, bytes: &[u8]) {
        if self.cut.exists() {
            return;
        }
        let sent = self.ours.write(bytes).unwrap_or(0);
        self.dropped += (bytes.len() - sent) as u64;
    }

    /// Bytes that came, if any.
    pub fn receive(&mut self, into: &mut [u8]) -> usize {
        self.ours.read(into).unwrap_or(0)
    }
}

/// `/tmp/lidar` is cut by `/tmp/lidar.cut`.
fn cut_name(link: &Path) -> PathBuf {
    let mut name = link.as_os_str().to_owned();
    name.push(".cut");
    PathBuf::from(name)
}

impl Drop for Terminal {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.link);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_goes_in_at_one_end_comes_out_at_the_other_and_the_link_goes_with_it() {
        let link = std::env::temp_dir().join(format!("kestrel-terminal-{}", std::process::id()));
        let mut terminal = Terminal::open(&link).unwrap();
        let mut theirs = crate::io::line::open_serial(link.to_str().unwrap(), 230_400).unwrap();
        terminal.send(&[0x54, 0x0A, 0x0D, 0x03]);
        let mut heard = [0u8; 8];
        assert_eq!(theirs.read(&mut heard).unwrap(), 4);
        assert_eq!(
            heard[..4],
            [0x54, 0x0A, 0x0D, 0x03],
            "raw, no line discipline"
        );
        theirs.write_all(&[0xA5, 0x20]).unwrap();
        assert_eq!(terminal.receive(&mut heard), 2);
        std::fs::write(cut_name(&link), "").unwrap();
        terminal.send(&[1]);
        std::fs::remove_file(cut_name(&link)).unwrap();
        terminal.send(&[2]);
        assert_eq!((theirs.read(&mut heard).unwrap(), heard[0]), (1, 2));
        drop(terminal);
        assert!(!link.exists());
        std::fs::write(&link, "precious").unwrap();
        assert!(Terminal::open(&link).is_err());
        assert_eq!(std::fs::read_to_string(&link).unwrap(), "precious");
        std::fs::remove_file(&link).unwrap();
    }
}
