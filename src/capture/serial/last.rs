//! The last reads of a recording: what came before the stop is in it.

/// Most bytes read after the stop: more than the kernel holds for a terminal, which is 640 KiB
/// (`TTYB_DEFAULT_MEM_LIMIT` in its `drivers/tty/tty_buffer.c`) and a line buffer of 4 KiB. A bound
/// in time instead would cost bytes on a busy machine; without one, a line that never pauses would
/// have no end.
const MOST: usize = 1 << 20;

/// Counts the last reads. Go on while [`LastReads::more`] and the read finds something; that it
/// finds nothing is reliable: a terminal's read says `WouldBlock` only after the kernel has moved
/// everything that arrived into its line buffer (`n_tty_read`).
pub(crate) struct LastReads {
    left: usize,
}

impl LastReads {
    /// At the stop.
    pub fn new() -> Self {
        Self { left: MOST }
    }

    /// False once everything read now has come after the stop.
    pub fn more(&self) -> bool {
        self.left > 0
    }

    /// A read found `length` bytes.
    pub fn took(&mut self, length: usize) {
        self.left = self.left.saturating_sub(length);
    }
}
