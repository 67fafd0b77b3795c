//! MULTIPLE_MSP (230): several questions in one frame. The controller's serial task handles one
//! frame per run whatever it contains, so a batch multiplies the sensor rate (Betaflight API 1.43
//! and later; INAV has no such command).
//!
//! Request: one byte per command. Reply: for each command in order `length u8, payload`. A command
//! that the controller does not know makes it refuse the whole batch or end the list early,
//! depending on the version.

use super::messages;
use arrayvec::ArrayVec;

/// Most commands in one batch.
pub const MAX_BATCH: usize = 16;

messages! {
    /// The commands to ask in one go, all below 255.
    MultipleRequest = MULTIPLE_MSP {
        /// Command numbers in order.
        commands: ArrayVec<u8, MAX_BATCH>,
    }
}

/// Takes the reply to a batch apart: pairs of command and payload, in the order of the request.
#[derive(Clone, Debug)]
pub struct Replies<'a> {
    commands: &'a [u8],
    payload: &'a [u8],
}

impl<'a> Replies<'a> {
    /// `commands` is what was asked, `payload` what came.
    #[must_use]
    pub const fn new(commands: &'a [u8], payload: &'a [u8]) -> Self {
        Self { commands, payload }
    }

    /// Commands without an answer so far: all of them must be gone when the iterator has ended, or
    /// the list was cut short.
    #[must_use]
    pub const fn unanswered(&self) -> &'a [u8] {
        self.commands
    }
}

impl<'a> Iterator for Replies<'a> {
    type Item = (u16, &'a [u8]);

    fn next(&mut self) -> Option<Self::Item> {
        let (&command, commands) = self.commands.split_first()?;
        let (&length, rest) = self.payload.split_first()?;
        let (payload, rest) = rest.split_at_checked(length.into())?;
        self.commands = commands;
        self.payload = rest;
        Some((command.into(), payload))
    }
}

/// Appends one answer to the reply of a batch; the answering side calls it once per command. Longer
/// than 255 bytes does not fit and is cut, as firmware does.
pub fn push_reply(payload: &[u8], out: &mut Vec<u8>) {
    let length = u8::try_from(payload.len()).unwrap_or(u8::MAX);
    out.push(length);
    out.extend_from_slice(&payload[..usize::from(length)]);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_batch_comes_back_in_the_order_it_was_asked() {
        let mut payload = Vec::new();
        push_reply(&[1, 2], &mut payload);
        push_reply(&[], &mut payload);
        push_reply(&[3], &mut payload);
        let mut replies = Replies::new(&[108, 102, 109], &payload);
        let got: Vec<_> = replies.by_ref().collect();
        assert_eq!(got, [(108, &[1, 2][..]), (102, &[]), (109, &[3])]);
        assert!(replies.unanswered().is_empty());
    }

    #[test]
    fn a_list_cut_short_yields_its_whole_part_and_names_the_rest() {
        for cut in [&[2, 1, 2][..], &[2, 1, 2, 5, 0], &[2, 1, 2, 1]] {
            let mut replies = Replies::new(&[108, 102], cut);
            assert_eq!(replies.by_ref().count(), 1);
            assert_eq!(replies.unanswered(), [102]);
        }
    }
}
