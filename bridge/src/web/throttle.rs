//! How often passwords may be tried: five a minute from an address, and a limit for all together.

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::time::Duration;
use vehicle::Timestamp;

/// Tries of one address.
const PER_ADDRESS: u32 = 5;
/// Tries of all addresses.
const TOGETHER: u32 = 30;
/// In this time.
const WINDOW: Duration = Duration::from_secs(60);
/// Addresses remembered; beyond that everybody waits.
const ADDRESSES: usize = 1024;

/// Counts tries in a window that starts with the first one.
#[derive(Clone, Copy, Debug)]
struct Tries {
    since: Timestamp,
    count: u32,
}

impl Tries {
    fn add(&mut self, now: Timestamp, most: u32) -> bool {
        if now.since(self.since) >= WINDOW {
            *self = Self {
                since: now,
                count: 0,
            };
        }
        self.count += 1;
        self.count <= most
    }
}

/// Tries so far.
#[derive(Debug, Default)]
pub struct Throttle {
    by_address: BTreeMap<IpAddr, Tries>,
    all: Option<Tries>,
}

impl Throttle {
    /// True if an address may try a password now; the try counts either way.
    pub fn admits(&mut self, now: Timestamp, from: IpAddr) -> bool {
        self.by_address.retain(|_, t| now.since(t.since) < WINDOW);
        let fresh = Tries {
            since: now,
            count: 0,
        };
        let all = self.all.get_or_insert(fresh).add(now, TOGETHER);
        if self.by_address.len() >= ADDRESSES && !self.by_address.contains_key(&from) {
            return false;
        }
        let own = self
            .by_address
            .entry(from)
            .or_insert(fresh)
            .add(now, PER_ADDRESS);
        own && all
    }

    /// A right password: the address starts anew.
    pub fn forgive(&mut self, from: IpAddr) {
        self.by_address.remove(&from);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn address(n: u8) -> IpAddr {
        IpAddr::from([10, 0, 0, n])
    }

    #[test]
    fn the_sixth_try_in_a_minute_is_refused_and_the_next_minute_is_new() {
        let mut throttle = Throttle::default();
        let tries: Vec<bool> = (0..6)
            .map(|s| throttle.admits(Timestamp::from_ms(s * 1000), address(1)))
            .collect();
        assert_eq!(tries, [true, true, true, true, true, false]);
        assert!(throttle.admits(Timestamp::from_ms(6_000), address(2)));
        assert!(throttle.admits(Timestamp::from_ms(60_000), address(1)));
    }

    #[test]
    fn many_addresses_together_are_refused_too_and_memory_is_bounded() {
        let mut throttle = Throttle::default();
        let admitted = (0..60_000u32)
            .filter(|n| throttle.admits(Timestamp::ZERO, IpAddr::from((n + 1).to_be_bytes())))
            .count();
        assert_eq!(admitted, TOGETHER as usize);
        assert!(throttle.by_address.len() <= ADDRESSES);
    }

    #[test]
    fn a_right_password_forgives() {
        let mut throttle = Throttle::default();
        for _ in 0..5 {
            throttle.admits(Timestamp::ZERO, address(1));
        }
        throttle.forgive(address(1));
        assert!(throttle.admits(Timestamp::ZERO, address(1)));
    }
}
