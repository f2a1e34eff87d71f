//! Bytes on their way from one side of a bridge to the other.

use std::io;

use super::port::or_nothing;

/// Most bytes that wait for a side that does not take them. Then the other side is not read any
/// more, its own buffers fill, and flow control does the rest.
const LIMIT: usize = 64 << 10;

/// A bounded buffer for one direction. Empty nearly always: bytes are written when they come.
#[derive(Debug, Default)]
pub(crate) struct Relay {
    waiting: Vec<u8>,
    /// Bytes at the start of `waiting` that are already gone.
    taken: usize,
}

impl Relay {
    /// How many more bytes may be passed on.
    pub fn room(&self) -> usize {
        LIMIT.saturating_sub(self.front().len())
    }

    /// The bytes that wait.
    pub fn front(&self) -> &[u8] {
        &self.waiting[self.taken..]
    }

    /// True if nothing waits.
    pub fn is_empty(&self) -> bool {
        self.front().is_empty()
    }

    /// Hands `bytes` to `write` at once if nothing waits, and keeps what it does not take. Ask
    /// for [`Relay::room`] before, except for the last bytes of all. `write` says how many bytes it
    /// took.
    pub fn pass(
        &mut self,
        bytes: &[u8],
        write: impl FnOnce(&[u8]) -> io::Result<usize>,
    ) -> io::Result<()> {
        let written = if self.is_empty() { or_nothing(write(bytes))? } else { 0 };
        self.waiting.extend_from_slice(&bytes[written..]);
        Ok(())
    }

    /// The first `count` waiting bytes were written.
    pub fn advance(&mut self, count: usize) {
        self.taken += count;
        if self.taken == self.waiting.len() {
            self.clear();
        } else if self.taken >= LIMIT / 2 {
            self.waiting.drain(..self.taken);
            self.taken = 0;
        }
    }

    /// Forgets what waits and says how much it was.
    pub fn clear(&mut self) -> usize {
        let lost = self.front().len();
        self.waiting.clear();
        self.taken = 0;
        lost
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn bytes_come_out_in_order_whatever_the_writer_takes(
            steps in prop::collection::vec((0_usize..40_000, 0_usize..40_000), 1..60),
        ) {
            let (mut relay, mut sent, mut got) = (Relay::default(), Vec::new(), Vec::new());
            for (offered, accepted) in steps {
                let offered: Vec<u8> =
                    (sent.len()..).take(offered.min(relay.room())).map(|i| (i % 251) as u8).collect();
                sent.extend_from_slice(&offered);
                relay.pass(&offered, |bytes| {
                    let taken = bytes.len().min(accepted);
                    got.extend_from_slice(&bytes[..taken]);
                    if taken == 0 { Err(io::ErrorKind::WouldBlock.into()) } else { Ok(taken) }
                }).unwrap();
                let taken = relay.front().len().min(accepted / 3);
                got.extend_from_slice(&relay.front()[..taken]);
                relay.advance(taken);
                prop_assert_eq!(sent.len(), got.len() + relay.front().len());
                prop_assert!(relay.front().len() <= LIMIT);
            }
            got.extend_from_slice(relay.front());
            prop_assert_eq!(sent, got);
        }
    }
}
