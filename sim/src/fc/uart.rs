//! The wire between companion computer and flight controller: bytes take their time.

use arrayvec::ArrayVec;
use std::collections::VecDeque;
use vehicle::Timestamp;

/// Longest burst handed over at once; longer answers come as several.
pub(crate) const BURST: usize = 512;
/// Bytes that wait in the controller's receive buffer at most; what comes beyond is lost, as on hardware.
const RECEIVE_BUFFER: usize = 2048;
/// Bursts that wait to be sent at most.
const SEND_BUFFER: usize = 32;

/// Both directions of one UART.
#[derive(Clone, Debug)]
pub(crate) struct Uart {
    byte_ns: u64,
    to_controller: VecDeque<(u64, u8)>,
    receive_busy_ns: u64,
    from_controller: VecDeque<Burst>,
    send_busy_ns: u64,
}

/// Bytes of the controller that arrive together.
#[derive(Clone, Debug)]
pub(crate) struct Burst {
    /// When the last byte is complete.
    pub(crate) at: Timestamp,
    pub(crate) bytes: ArrayVec<u8, BURST>,
}

impl Uart {
    /// 8N1: ten bits a byte.
    pub(crate) fn new(baud: u32) -> Self {
        Self {
            byte_ns: 10_000_000_000 / u64::from(baud.max(1)),
            to_controller: VecDeque::with_capacity(RECEIVE_BUFFER),
            receive_busy_ns: 0,
            from_controller: VecDeque::with_capacity(SEND_BUFFER),
            send_busy_ns: 0,
        }
    }

    /// The companion computer writes.
    pub(crate) fn write(&mut self, now: Timestamp, bytes: &[u8]) {
        self.receive_busy_ns = self.receive_busy_ns.max(now.us() * 1000);
        for byte in bytes {
            self.receive_busy_ns += self.byte_ns;
            if self.to_controller.len() < RECEIVE_BUFFER {
                self.to_controller.push_back((self.receive_busy_ns, *byte));
            }
        }
    }

    /// Bytes that have reached the controller.
    pub(crate) fn receive(&mut self, now: Timestamp) -> Option<u8> {
        let (complete_ns, byte) = *self.to_controller.front()?;
        if complete_ns > now.us() * 1000 {
            return None;
        }
        self.to_controller.pop_front();
        Some(byte)
    }

    /// The controller writes.
    pub(crate) fn send(&mut self, now: Timestamp, bytes: &[u8]) {
        self.send_busy_ns = self.send_busy_ns.max(now.us() * 1000);
        for chunk in bytes.chunks(BURST) {
            if self.from_controller.len() == SEND_BUFFER {
                return;
            }
            self.send_busy_ns += self.byte_ns * chunk.len() as u64;
            self.from_controller.push_back(Burst {
                at: Timestamp::from_us(self.send_busy_ns.div_ceil(1000)),
                bytes: chunk.iter().copied().collect(),
            });
        }
    }

    /// Bytes that have reached the companion computer.
    pub(crate) fn deliver(&mut self, now: Timestamp) -> Option<Burst> {
        if self.from_controller.front()?.at > now {
            return None;
        }
        self.from_controller.pop_front()
    }

    pub(crate) fn clear(&mut self) {
        self.to_controller.clear();
        self.from_controller.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ten_bytes_at_115200_baud_take_868_microseconds() {
        let mut uart = Uart::new(115_200);
        uart.send(Timestamp::from_ms(1), &[0; 10]);
        assert!(uart.deliver(Timestamp::from_us(1867)).is_none());
        let burst = uart.deliver(Timestamp::from_us(1869)).unwrap();
        assert_eq!((burst.at.us(), burst.bytes.len()), (1869, 10));
    }

    #[test]
    fn the_controller_sees_bytes_one_after_the_other() {
        let mut uart = Uart::new(115_200);
        uart.write(Timestamp::ZERO, &[1, 2, 3]);
        let mut seen = |us| uart.receive(Timestamp::from_us(us));
        assert_eq!(seen(86), None);
        assert_eq!(seen(87), Some(1));
        assert_eq!(seen(87), None);
        assert_eq!(
            (seen(1000), seen(1000), seen(1000)),
            (Some(2), Some(3), None)
        );
    }
}
