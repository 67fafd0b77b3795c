//! What a computer needs to fly, looked at: devices and who may open them, real time, clock, disk, heat, camera.
//!
//! Everything is read below a root folder, so that a test can make a computer that lacks something. Nothing is changed but one small
//! file in the state folder, written and removed again.

use super::clock::{VIRTUAL_BOOT_UTC_US, monotonic_ns};
use super::host::{hottest_c, is_throttled};
use super::realtime::Realtime;
use rustix::fs::{Access, access, statvfs};
use std::fs::{self, File};
use std::io::Write as _;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};

/// Free space below which logging soon stops, bytes.
const ROOM: u64 = 500 << 20;
/// One write of the flight log, bytes, and how long it may take, ms: the log asks twice a second.
const PROBE: (usize, f64) = (40 << 10, 250.0);
/// Warmer than this on the ground will be too hot in flight, degrees Celsius.
const WARM_C: f64 = 75.0;
/// Programs that open serial ports they are not asked to.
const MEDDLERS: [&str; 3] = ["ModemManager", "brltty", "agetty"];

/// How a finding is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    /// As it should be.
    Good,
    /// Flies, less well.
    Poor,
    /// Does not fly.
    Missing,
}

/// What was looked at, how it is, what to do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// What was looked at.
    pub what: &'static str,
    /// How it is.
    pub verdict: Verdict,
    /// What is there.
    pub found: String,
    /// What to do; empty if there is nothing to do.
    pub advice: String,
}

fn good(what: &'static str, found: impl Into<String>) -> Finding {
    Finding {
        what,
        verdict: Verdict::Good,
        found: found.into(),
        advice: String::new(),
    }
}

fn poor(what: &'static str, found: impl Into<String>, advice: impl Into<String>) -> Finding {
    Finding {
        verdict: Verdict::Poor,
        advice: advice.into(),
        ..good(what, found)
    }
}

fn missing(what: &'static str, found: impl Into<String>, advice: impl Into<String>) -> Finding {
    Finding {
        verdict: Verdict::Missing,
        ..poor(what, found, advice)
    }
}

/// A computer, by its file system.
#[derive(Clone, Debug)]
pub struct Computer {
    root: PathBuf,
}

impl Default for Computer {
    fn default() -> Self {
        Self::at(Path::new("/"))
    }
}

impl Computer {
    /// One whose file system is below a folder.
    #[must_use]
    pub fn at(root: &Path) -> Self {
        Self {
            root: root.to_owned(),
        }
    }

    fn path(&self, absolute: &str) -> PathBuf {
        self.root.join(absolute.trim_start_matches('/'))
    }

    fn text(&self, absolute: &str) -> Option<String> {
        let text = fs::read_to_string(self.path(absolute)).ok()?;
        Some(text.trim().to_owned())
    }

    /// Device files whose names begin so, in order.
    fn devices(&self, names: &[&str]) -> Vec<String> {
        let entries = fs::read_dir(self.path("/dev")).into_iter().flatten();
        let mut found: Vec<String> = entries
            .flatten()
            .map(|e| e.file_name().to_string_lossy().into_owned())
            .filter(|name| names.iter().any(|n| name.starts_with(n)))
            .map(|name| format!("/dev/{name}"))
            .collect();
        found.sort();
        found
    }

    /// A device that will be opened: there, ours to open, and nobody else's.
    #[must_use]
    pub fn device(&self, what: &'static str, device: &str) -> Finding {
        let path = self.path(device);
        let Ok(meta) = fs::metadata(&path) else {
            let others =
                self.devices(&["flight-controller", "ttyACM", "ttyUSB", "ttyAMA", "serial"]);
            let seen = if others.is_empty() {
                "no serial port at all".to_owned()
            } else {
                format!("there are {}", others.join(", "))
            };
            return missing(
                what,
                format!("{device} is not there ({seen})"),
                "is the cable in, does it carry data, is the UART enabled (Raspberry Pi: raspi-config, Interface, Serial Port)?",
            );
        };
        if access(&path, Access::READ_OK | Access::WRITE_OK).is_err() {
            let group = self.group(meta.gid());
            return missing(
                what,
                format!("{device} is group {group}'s, and you are not in it"),
                format!("sudo usermod -aG {group} $USER, then log in again"),
            );
        }
        let name = device.rsplit('/').next().unwrap_or(device);
        let console = format!("console={name},");
        if self
            .text("/proc/cmdline")
            .is_some_and(|c| c.contains(&console))
        {
            return missing(
                what,
                format!("{device} is the kernel's console, which talks into it"),
                "take console=... out of the boot command line (Raspberry Pi: raspi-config, Serial Port, login shell: no)",
            );
        }
        good(what, format!("{device} can be opened"))
    }

    fn group(&self, gid: u32) -> String {
        let groups = self.text("/etc/group").unwrap_or_default();
        let of = |line: &str| {
            let mut fields = line.split(':');
            let name = fields.next()?.to_owned();
            (fields.nth(1)? == gid.to_string()).then_some(name)
        };
        groups
            .lines()
            .find_map(of)
            .unwrap_or_else(|| gid.to_string())
    }

    /// A port that a flight controller is usually on.
    #[must_use]
    pub fn likely_port(&self) -> Option<String> {
        self.devices(&["flight-controller", "ttyACM", "ttyAMA", "ttyUSB"])
            .into_iter()
            .next()
    }

    /// Programs that talk into serial ports.
    #[must_use]
    pub fn meddlers(&self) -> Finding {
        let what = "other programs";
        let running = |name: &&str| {
            let processes = fs::read_dir(self.path("/proc")).into_iter().flatten();
            processes.flatten().any(|p| {
                let comm = fs::read_to_string(p.path().join("comm")).unwrap_or_default();
                // On a screen's terminal a login is welcome.
                let on_serial = || {
                    let line = fs::read(p.path().join("cmdline")).unwrap_or_default();
                    let line = String::from_utf8_lossy(&line).into_owned();
                    ["ttyAMA", "ttyS", "ttyACM", "ttyUSB", "serial"]
                        .iter()
                        .any(|port| line.contains(port))
                };
                comm.trim() == *name && (*name != "agetty" || on_serial())
            })
        };
        let found: Vec<&str> = MEDDLERS.iter().filter(|n| running(n)).copied().collect();
        if found.is_empty() {
            return good(what, "none that open serial ports by themselves");
        }
        poor(
            what,
            format!(
                "running: {}; they open serial ports by themselves",
                found.join(", ")
            ),
            "sudo systemctl disable --now ModemManager brltty serial-getty@ttyAMA0 (those that run), or the package's udev rules, which tell ModemManager to leave",
        )
    }

    /// The governor of the processor.
    #[must_use]
    pub fn processor(&self) -> Finding {
        let what = "processor";
        match self.text("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor") {
            Some(g) if g == "powersave" => poor(
                what,
                "governor powersave: slow when it counts",
                "echo performance | sudo tee /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor",
            ),
            Some(g) => good(what, format!("governor {g}")),
            None => good(what, "fixed frequency"),
        }
    }

    /// Temperature and what it does.
    #[must_use]
    pub fn heat(&self) -> Finding {
        let what = "heat";
        let hottest = hottest_c(&self.path("/sys/class/thermal"));
        if is_throttled(&self.root) {
            return poor(
                what,
                "held back now, by heat or low voltage",
                "a fan or a heat sink; a supply of 5 V that holds 3 A",
            );
        }
        match hottest {
            Some(c) if c > WARM_C => poor(
                what,
                format!("{c:.0} degrees on the ground (lands at KST_TEMP_MAX)"),
                "a fan or a heat sink",
            ),
            Some(c) => good(what, format!("{c:.0} degrees")),
            None => good(what, "this computer does not tell"),
        }
    }

    /// Who sets the clock.
    #[must_use]
    pub fn clock(&self, utc_us: u64) -> Finding {
        let what = "wall clock";
        // No clock that was ever set says less.
        if utc_us < VIRTUAL_BOOT_UTC_US {
            return poor(
                what,
                "not set",
                "names of logs and signed links need the date: network time, or a clock chip",
            );
        }
        let keepers = [
            "/run/systemd/timesync/synchronized",
            "/run/chrony",
            "/run/ntpd.pid",
        ];
        if keepers.iter().any(|k| self.path(k).exists()) {
            return good(what, "set by network time");
        }
        good(
            what,
            "set; nobody is seen to keep it, which flying does not need",
        )
    }

    /// Cameras.
    #[must_use]
    pub fn camera(&self) -> Finding {
        let what = "camera";
        let found = self.devices(&["video"]);
        let Some(first) = found.first() else {
            return good(what, "none; flying needs none");
        };
        if access(self.path(first), Access::READ_OK).is_err() {
            let meta = fs::metadata(self.path(first));
            let group = meta.map_or_else(|_| "video".to_owned(), |m| self.group(m.gid()));
            return poor(
                what,
                format!("{first} may not be opened"),
                format!("sudo usermod -aG {group} $USER, then log in again (only for --video)"),
            );
        }
        good(what, found.join(", "))
    }
}

/// What the system grants the flight thread.
#[must_use]
pub fn realtime() -> Finding {
    let what = "real time";
    // On a thread of its own: what it is granted ends with it.
    let granted = std::thread::spawn(Realtime::enter)
        .join()
        .unwrap_or_default();
    let lack = match (granted.is_fifo, granted.is_locked) {
        (true, true) => return good(what, "SCHED_FIFO and locked memory"),
        (false, true) => "no SCHED_FIFO",
        (true, false) => "no locked memory",
        (false, false) => "neither SCHED_FIFO nor locked memory",
    };
    poor(
        what,
        format!("{lack}: the flight thread may be late under load"),
        "sudo setcap cap_sys_nice,cap_ipc_lock+ep $(which kestrel), or the package's service, which grants both",
    )
}

/// The state folder: written, with room, fast enough for the log.
#[must_use]
pub fn disk(folder: &Path) -> Finding {
    let what = "disk";
    let shown = folder.display();
    let advice = "another folder with --state-dir, or another owner: sudo chown $USER";
    if let Err(e) = fs::create_dir_all(folder) {
        return missing(what, format!("cannot make {shown}: {e}"), advice);
    }
    let probe = folder.join(format!(".doctor-{}", std::process::id()));
    let began = monotonic_ns();
    let written = File::create(&probe).and_then(|mut file| {
        file.write_all(&vec![0x5A; PROBE.0])?;
        file.sync_data()
    });
    let took_ms = (monotonic_ns() - began) as f64 * 1e-6;
    let _ = fs::remove_file(&probe);
    if let Err(e) = written {
        return missing(what, format!("{shown} cannot be written: {e}"), advice);
    }
    let free = statvfs(folder).map_or(u64::MAX, |s| s.f_bavail * s.f_frsize);
    if free < ROOM {
        return poor(
            what,
            format!("{shown} has {} MB left", free >> 20),
            "flights will soon not be logged: remove something, LOG_TOTAL_MB, or another disk",
        );
    }
    let text = format!(
        "{shown}: {} MB free, {} kB safe in {took_ms:.0} ms",
        free >> 20,
        PROBE.0 >> 10
    );
    if took_ms > PROBE.1 {
        return poor(
            what,
            text,
            "slow: parts of the log will be lost and counted; flying does not wait for it",
        );
    }
    good(what, text)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A computer of files, removed at the end.
    struct Made(PathBuf);

    impl Made {
        fn new(name: &str, files: &[(&str, &str)]) -> Self {
            let root =
                std::env::temp_dir().join(format!("kestrel-doctor-{name}-{}", std::process::id()));
            for (file, text) in files {
                let path = root.join(file);
                fs::create_dir_all(path.parent().unwrap()).unwrap();
                fs::write(path, text).unwrap();
            }
            Self(root)
        }
    }

    impl Drop for Made {
        fn drop(&mut self) {
            let _ = fs::remove_dir_all(&self.0);
        }
    }

    #[test]
    fn a_port_that_is_not_there_is_told_with_those_that_are() {
        let made = Made::new("ports", &[("dev/ttyACM0", ""), ("dev/null", "")]);
        let computer = Computer::at(&made.0);
        let absent = computer.device("flight controller", "/dev/ttyAMA0");
        assert_eq!(absent.verdict, Verdict::Missing);
        assert!(
            absent.found.contains("there are /dev/ttyACM0"),
            "{absent:?}"
        );
        assert!(absent.advice.contains("UART"));
        let there = computer.device("flight controller", "/dev/ttyACM0");
        assert_eq!(there.verdict, Verdict::Good);
        assert_eq!(computer.likely_port().as_deref(), Some("/dev/ttyACM0"));
    }

    #[test]
    fn the_kernels_console_is_no_port_for_a_controller() {
        let made = Made::new(
            "console",
            &[
                ("dev/ttyAMA0", ""),
                (
                    "proc/cmdline",
                    "root=/dev/mmcblk0p2 console=ttyAMA0,115200 quiet\n",
                ),
            ],
        );
        let finding = Computer::at(&made.0).device("flight controller", "/dev/ttyAMA0");
        assert_eq!(finding.verdict, Verdict::Missing);
        assert!(finding.advice.contains("raspi-config"), "{finding:?}");
    }

    #[test]
    fn groups_are_told_by_name() {
        let made = Made::new("groups", &[("etc/group", "root:x:0:\ndialout:x:20:pi\n")]);
        let computer = Computer::at(&made.0);
        assert_eq!(computer.group(20), "dialout");
        assert_eq!(computer.group(77), "77");
    }

    #[test]
    fn programs_that_open_ports_are_named_and_a_login_on_the_screen_is_none() {
        let made = Made::new(
            "meddlers",
            &[
                ("proc/12/comm", "ModemManager\n"),
                ("proc/13/comm", "agetty\n"),
                ("proc/13/cmdline", "agetty\0tty1\0"),
            ],
        );
        let finding = Computer::at(&made.0).meddlers();
        assert_eq!(finding.verdict, Verdict::Poor);
        assert!(
            finding.found.contains("running: ModemManager;"),
            "{finding:?}"
        );
        let alone = Made::new("alone", &[("proc/13/comm", "sh\n")]);
        assert_eq!(Computer::at(&alone.0).meddlers().verdict, Verdict::Good);
    }

    #[test]
    fn a_slow_governor_and_heat_are_poor_and_a_clock_never_set_too() {
        let made = Made::new(
            "slow",
            &[
                (
                    "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor",
                    "powersave\n",
                ),
                ("sys/class/thermal/thermal_zone0/temp", "81000\n"),
            ],
        );
        let computer = Computer::at(&made.0);
        assert!(computer.processor().advice.contains("performance"));
        assert!(computer.heat().found.starts_with("81 degrees"));
        assert_eq!(computer.clock(0).verdict, Verdict::Poor);
        assert_eq!(computer.clock(u64::MAX).verdict, Verdict::Good);
        assert_eq!(computer.camera().verdict, Verdict::Good);
    }

    #[test]
    fn a_folder_that_cannot_be_made_is_missing_and_one_that_can_is_left_empty() {
        let made = Made::new("disk", &[("file", "")]);
        assert_eq!(disk(&made.0.join("file/below")).verdict, Verdict::Missing);
        let folder = made.0.join("state");
        assert_ne!(disk(&folder).verdict, Verdict::Missing);
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 0);
    }
}
