//! How many requests are kept outstanding.
//!
//! One is enough when a reply reaches us and the next request the controller before its serial task runs
//! again; then RC waits for one request at most. Where the line takes longer than a slot, one leaves slots
//! empty. Which it is cannot be known, only tried: from time to time one more, or one fewer, for a number
//! of replies. More is kept when it is clearly faster, fewer when it is not clearly slower.

/// Replies of one trial. The mean of so many slots is good to 1/32 slot.
const TRIAL: u32 = 32;
/// One more must shorten the time per reply to this part.
const FASTER: f64 = 0.93;
/// One fewer may lengthen it to this part.
const AS_FAST: f64 = 1.03;
/// Time between trials, doubled after each one that failed.
const PAUSE_US: [u64; 2] = [5_000_000, 80_000_000];

/// Finds the least depth at which no slot stays empty.
#[derive(Clone, Copy, Debug)]
pub(super) struct Depth {
    depth: usize,
    /// What is tried now.
    trial: Option<usize>,
    /// Time per reply at `depth`, 0 = not known yet.
    settled_us: f64,
    sum_us: f64,
    count: u32,
    /// Replies to requests sent before the last change.
    unsettled: u32,
    next_trial_us: u64,
    pause_us: u64,
    /// The next trial is with one fewer.
    downwards: bool,
}

impl Default for Depth {
    fn default() -> Self {
        Self {
            depth: 1,
            trial: None,
            settled_us: 0.0,
            sum_us: 0.0,
            count: 0,
            unsettled: 0,
            next_trial_us: 0,
            pause_us: PAUSE_US[0],
            downwards: false,
        }
    }
}

impl Depth {
    /// Requests to keep outstanding now.
    pub(super) fn now(&self) -> usize {
        self.trial.unwrap_or(self.depth)
    }

    /// A busy controller took `per_reply_us` from one reply to the next.
    pub(super) fn on_reply(&mut self, now_us: u64, per_reply_us: u64, max: usize) {
        if self.unsettled > 0 {
            self.unsettled -= 1;
            return;
        }
        self.sum_us += per_reply_us as f64;
        self.count += 1;
        if self.count < TRIAL {
            return;
        }
        let mean_us = self.sum_us / f64::from(self.count);
        self.forget();
        let Some(tried) = self.trial.take() else {
            self.settled_us = mean_us;
            if now_us >= self.next_trial_us {
                self.begin(now_us, max);
            }
            return;
        };
        let is_kept = if tried > self.depth {
            mean_us < FASTER * self.settled_us
        } else {
            mean_us < AS_FAST * self.settled_us
        };
        self.unsettled = u32::try_from(tried.max(self.depth)).unwrap_or(0) + 1;
        if is_kept {
            self.depth = tried;
            self.settled_us = mean_us;
            self.pause_us = PAUSE_US[0];
            // Perhaps one further step does more.
            self.next_trial_us = now_us;
        } else {
            self.downwards = !self.downwards;
            self.pause_us = (2 * self.pause_us).min(PAUSE_US[1]);
            self.next_trial_us = now_us + self.pause_us;
        }
    }

    /// The controller had nothing to do, or did not answer: the next interval says nothing.
    pub(super) fn forget(&mut self) {
        (self.sum_us, self.count) = (0.0, 0);
    }

    fn begin(&mut self, now_us: u64, max: usize) {
        let tried = if self.downwards {
            self.depth - 1
        } else {
            self.depth + 1
        };
        if (1..=max).contains(&tried) {
            self.trial = Some(tried);
            self.unsettled = u32::try_from(tried.max(self.depth)).unwrap_or(0) + 1;
        } else {
            self.downwards = !self.downwards;
            self.next_trial_us = now_us;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Serves `replies` at a time per reply that depends on the depth; where it ends up, and how many
    /// replies were served at another depth.
    fn settle(per_reply_us: impl Fn(usize) -> u64, replies: u32) -> (usize, u32) {
        let (mut depth, mut now_us) = (Depth::default(), 0);
        let mut at = [0; 8];
        for _ in 0..replies {
            let took_us = per_reply_us(depth.now());
            now_us += took_us;
            at[depth.now()] += 1;
            depth.on_reply(now_us, took_us, 4);
        }
        (depth.depth, replies - at[depth.depth])
    }

    #[test]
    fn one_stays_one_when_more_is_no_faster() {
        let (depth, elsewhere) = settle(|_| 10_000, 60_000);
        assert_eq!(depth, 1);
        assert!(elsewhere < 600, "{elsewhere} of 60000 replies");
    }

    #[test]
    fn a_line_slower_than_the_slots_gets_as_many_as_it_needs_and_no_more() {
        // 0.5 ms slots, 1.2 ms of line: one request in 1.5 ms, two in 0.75, three in 0.5.
        let (depth, elsewhere) = settle(|depth| [0, 1500, 750, 500, 500][depth], 120_000);
        assert_eq!(depth, 3);
        assert!(elsewhere < 2_400, "{elsewhere} of 120000 replies");
    }

    #[test]
    fn it_never_leaves_the_limits() {
        assert_eq!(settle(|depth| 10_000 / depth as u64, 10_000).0, 4);
    }
}
