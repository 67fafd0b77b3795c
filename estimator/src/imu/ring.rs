//! The last frames. The newest is used; older unread ones are never taken for the newest, but they do enter the filter.

use super::frame::RawFrame;

/// Length of uQuad's ring, and the most that one may have.
pub const RING_LEN: usize = 32;

/// Ring of the last frames: [`RING_LEN`], or fewer as configured.
#[derive(Clone, Debug)]
pub struct FrameRing {
    frames: [RawFrame; RING_LEN],
    capacity: usize,
    /// Where the next frame goes.
    next: usize,
    len: usize,
    unread: u32,
    unread_us: u64,
}

impl Default for FrameRing {
    fn default() -> Self {
        Self::of(RING_LEN)
    }
}

impl FrameRing {
    /// A ring of so many frames, 1 to [`RING_LEN`]; what is beyond is that.
    #[must_use]
    pub fn of(capacity: usize) -> Self {
        Self {
            frames: [RawFrame::default(); RING_LEN],
            capacity: capacity.clamp(1, RING_LEN),
            next: 0,
            len: 0,
            unread: 0,
            unread_us: 0,
        }
    }
}

/// What was unread when the newest frame was taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Taken {
    /// The newest frame.
    pub newest: RawFrame,
    /// Time since the frame taken before, us: the sum over all frames in between.
    pub elapsed_us: u64,
    /// Frames in between that were never the newest when somebody looked.
    pub passed_over: u32,
}

impl FrameRing {
    /// Puts a frame in; the oldest one makes room.
    pub fn push(&mut self, frame: RawFrame) {
        self.frames[self.next] = frame;
        self.next = (self.next + 1) % self.capacity;
        self.len = (self.len + 1).min(self.capacity);
        self.unread = self.unread.saturating_add(1);
        self.unread_us += u64::from(frame.since_previous_us);
    }

    /// Frames held.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.len
    }

    /// True before the first frame.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Frames since the last [`FrameRing::take_newest`].
    #[must_use]
    pub const fn unread(&self) -> u32 {
        self.unread
    }

    /// The newest frame if it is unread; everything counts as read afterwards.
    pub fn take_newest(&mut self) -> Option<Taken> {
        let passed_over = self.unread.checked_sub(1)?;
        let newest = *self.newest_first().next()?;
        let elapsed_us = self.unread_us;
        self.unread = 0;
        self.unread_us = 0;
        Some(Taken {
            newest,
            elapsed_us,
            passed_over,
        })
    }

    /// All frames, the newest first.
    pub fn newest_first(&self) -> impl Iterator<Item = &RawFrame> {
        (1..=self.len).map(|back| &self.frames[(self.next + self.capacity - back) % self.capacity])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbered(k: i16) -> RawFrame {
        RawFrame {
            since_previous_us: 10_000,
            accel: [k, 0, 0],
            ..RawFrame::default()
        }
    }

    #[test]
    fn after_a_stall_the_newest_is_used_once_and_the_time_is_whole() {
        let mut ring = FrameRing::default();
        (0..20).for_each(|k| ring.push(numbered(k)));
        let taken = ring.take_newest().unwrap();
        assert_eq!(taken.newest.accel[0], 19);
        assert_eq!(taken.passed_over, 19);
        assert_eq!(taken.elapsed_us, 200_000);
        assert_eq!(ring.take_newest(), None, "nothing is used twice");
    }

    #[test]
    fn the_ring_wraps_at_32() {
        let mut ring = FrameRing::default();
        (0..33).for_each(|k| ring.push(numbered(k)));
        assert_eq!(ring.len(), RING_LEN);
        let held: Vec<i16> = ring.newest_first().map(|f| f.accel[0]).collect();
        let expected: Vec<i16> = (1..33).rev().collect();
        assert_eq!(held, expected);
    }

    #[test]
    fn a_shorter_ring_wraps_earlier_and_still_counts_what_it_passed_over() {
        let mut ring = FrameRing::of(8);
        (0..20).for_each(|k| ring.push(numbered(k)));
        assert_eq!(ring.len(), 8);
        let held: Vec<i16> = ring.newest_first().map(|f| f.accel[0]).collect();
        let expected: Vec<i16> = (12..20).rev().collect();
        assert_eq!(held, expected);
        assert_eq!(ring.take_newest().unwrap().passed_over, 19);
    }
}
