//! Buffers that the kernel fills with many CAN frames in one call.

use libc::{iovec, mmsghdr};

/// Most messages one call takes from the kernel.
pub(super) const BATCH: usize = 128;

/// Room for the control messages of one frame: 32 bytes for the time of reception, 24 for the drop
/// counter, 64 for the hardware time; the sum is 120 on 64-bit machines.
const CONTROL: usize = 128;

/// Control messages must start on a word boundary.
#[repr(C, align(8))]
#[derive(Clone, Copy)]
struct Control([u8; CONTROL]);

/// Buffers for [`CanSocket::receive`](super::CanSocket::receive), made once and used again and again.
pub struct CanBatch {
    // The headers point to the vectors and to `control`, the vectors to `payload`. These three
    // are never resized nor borrowed mutably after `new`, so the pointers stay valid: moving a
    // Vec does not move its buffer.
    payload: Vec<[u8; libc::CANFD_MTU]>,
    control: Vec<Control>,
    _vectors: Vec<iovec>,
    headers: Vec<mmsghdr>,
    filled: usize,
}

/// One message as the kernel delivered it.
#[derive(Clone, Copy, Debug)]
pub struct RawMessage<'a> {
    /// A `struct can_frame` (16 bytes) or `struct canfd_frame` (72 bytes).
    pub payload: &'a [u8],
    /// Control messages, each a `struct cmsghdr` and its data.
    pub control: &'a [u8],
    /// `MSG_DONTROUTE`: sent by this host; `MSG_TRUNC`: longer than the buffer.
    pub flags: i32,
}

impl CanBatch {
    /// Empty buffers for 128 messages: 36 KiB.
    pub fn new() -> Self {
        let mut payload = vec![[0; libc::CANFD_MTU]; BATCH];
        let mut control = vec![Control([0; CONTROL]); BATCH];
        let payloads = payload.as_mut_ptr();
        let mut vectors: Vec<iovec> = (0..BATCH)
            // SAFETY: i < BATCH, the length of `payload`.
            .map(|i| iovec {
                iov_base: unsafe { payloads.add(i) }.cast(),
                iov_len: libc::CANFD_MTU,
            })
            .collect();
        let (controls, iovecs) = (control.as_mut_ptr(), vectors.as_mut_ptr());
        let header = |i: usize| {
            // SAFETY: mmsghdr is plain data for which all zeroes are a valid value.
            let mut header: mmsghdr = unsafe { std::mem::zeroed() };
            // SAFETY: i < BATCH, the length of `vectors` and of `control`.
            (header.msg_hdr.msg_iov, header.msg_hdr.msg_control) =
                unsafe { (iovecs.add(i), controls.add(i).cast()) };
            header.msg_hdr.msg_iovlen = 1;
            header.msg_hdr.msg_controllen = CONTROL as _;
            header
        };
        let headers = (0..BATCH).map(header).collect();
        Self { payload, control, _vectors: vectors, headers, filled: 0 }
    }

    /// True if the last [`CanSocket::receive`](super::CanSocket::receive) filled every buffer, so
    /// that the kernel may hold more.
    pub fn is_full(&self) -> bool {
        self.filled == BATCH
    }

    /// The messages of the last [`CanSocket::receive`](super::CanSocket::receive), in their order.
    pub fn messages(&self) -> impl Iterator<Item = RawMessage<'_>> {
        (0..self.filled).map(|i| {
            let header = &self.headers[i];
            let length = (header.msg_len as usize).min(libc::CANFD_MTU);
            #[allow(clippy::unnecessary_cast, reason = "its type differs between C libraries")]
            let control = (header.msg_hdr.msg_controllen as usize).min(CONTROL);
            RawMessage {
                payload: &self.payload[i][..length],
                control: &self.control[i].0[..control],
                flags: header.msg_hdr.msg_flags,
            }
        })
    }

    /// The headers, ready for a call that fills at most [`BATCH`] of them. What the kernel wrote
    /// over in the last one is set again: lengths it filled in are those of what it delivered,
    /// and the next message may be longer.
    pub(super) fn headers(&mut self) -> *mut mmsghdr {
        for header in self.headers.iter_mut().take(self.filled) {
            header.msg_hdr.msg_controllen = CONTROL as _;
            header.msg_hdr.msg_flags = 0;
            header.msg_len = 0;
        }
        self.filled = 0;
        self.headers.as_mut_ptr()
    }

    /// The kernel has filled the first `filled` headers and their buffers.
    pub(super) fn fill(&mut self, filled: usize) {
        self.filled = filled.min(BATCH);
    }
}

impl Default for CanBatch {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_beyond_the_buffers_are_cut() {
        let mut batch = CanBatch::new();
        batch.fill(BATCH + 1);
        batch.headers[0].msg_len = u32::MAX;
        batch.headers[0].msg_hdr.msg_controllen = usize::MAX as _;
        let message = batch.messages().next().unwrap();
        assert_eq!((message.payload.len(), message.control.len()), (libc::CANFD_MTU, CONTROL));
        assert_eq!(batch.messages().count(), BATCH);
        batch.headers();
        assert_eq!(batch.messages().count(), 0);
    }
}
