//! A raw CAN socket that sends. Capture has none: it is a type of its own, so that whoever holds a
//! [`CanSocket`](super::CanSocket) cannot transmit.
//!
//! Sources: `linux/can.h`, `linux/can/raw.h`, `Documentation/networking/can.rst`, sendmmsg(2).

use std::io;
use std::mem::size_of_val;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, FromRawFd, OwnedFd};
use std::ptr;

use libc::{c_int, c_uint, iovec, mmsghdr};

use super::can_batch::{BATCH, CanBatch};

/// Most frames one call hands to the kernel.
pub const SEND_BATCH: usize = 128;

/// A frame as the kernel takes it: a `struct can_frame` or a `struct canfd_frame`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C, align(8))]
pub struct WireFrame {
    bytes: [u8; libc::CANFD_MTU],
    length: usize,
}

impl WireFrame {
    /// A `struct can_frame`.
    pub fn classic(bytes: [u8; libc::CAN_MTU]) -> Self {
        let mut all = [0; libc::CANFD_MTU];
        all[..libc::CAN_MTU].copy_from_slice(&bytes);
        Self { bytes: all, length: libc::CAN_MTU }
    }

    /// A `struct canfd_frame`.
    pub fn fd(bytes: [u8; libc::CANFD_MTU]) -> Self {
        Self { bytes, length: libc::CANFD_MTU }
    }

    /// The struct's bytes: 16 or 72.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes[..self.length]
    }
}

/// A raw CAN socket that sends to one interface. Non-blocking, closed on exec. It receives nothing
/// unless [`CanSender::listen`] is called.
#[derive(Debug)]
pub struct CanSender(OwnedFd);

impl CanSender {
    /// A socket that sends to the interface with this index, CAN FD frames too if `fd`.
    ///
    /// # Errors
    /// `EAFNOSUPPORT` or `EPROTONOSUPPORT` where the kernel has no raw CAN, `EPERM` or `EACCES`
    /// where a sandbox forbids it, `ENODEV` where the interface is gone or is not CAN.
    pub fn open(index: u32, fd: bool) -> io::Result<Self> {
        let kind = libc::SOCK_RAW | libc::SOCK_NONBLOCK | libc::SOCK_CLOEXEC;
        // SAFETY: socket() takes no pointers.
        let descriptor = checked(unsafe { libc::socket(libc::PF_CAN, kind, libc::CAN_RAW) })?;
        // SAFETY: the kernel has just returned this descriptor, so nobody else owns it.
        let sender = Self(unsafe { OwnedFd::from_raw_fd(descriptor) });
        // No filter at all means that nothing is received.
        sender.set(libc::CAN_RAW_FILTER, &[0u8; 0])?;
        if fd {
            sender.set(libc::CAN_RAW_FD_FRAMES, &[1 as c_int])?;
        }
        sender.bind(index)?;
        Ok(sender)
    }

    /// Also receives from now on: every frame that others send, also others on this host, but not
    /// what this socket sends itself.
    ///
    /// # Errors
    /// None on kernels since 2.6.25.
    pub fn listen(&self) -> io::Result<()> {
        self.set(libc::CAN_RAW_FILTER, &[libc::can_filter { can_id: 0, can_mask: 0 }])
    }

    /// Takes what the kernel holds, at most 128 messages, into `batch`. Never waits.
    ///
    /// # Errors
    /// `EAGAIN` when there is nothing; `ENETDOWN` or `ENODEV` when the interface went.
    pub fn receive(&self, batch: &mut CanBatch) -> io::Result<usize> {
        let headers = batch.headers();
        let (count, flags) = (BATCH as _, libc::MSG_DONTWAIT as _);
        // SAFETY: `headers` points to BATCH headers, whose pointers and lengths describe the
        // buffers of the same `batch`; all of them outlive the call, and since we hold
        // `&mut batch` nobody else looks at them meanwhile.
        let taken =
            unsafe { libc::recvmmsg(self.0.as_raw_fd(), headers, count, flags, ptr::null_mut()) };
        let filled = usize::try_from(checked(taken)?).unwrap_or(0);
        batch.fill(filled);
        Ok(filled)
    }

    /// Hands the first of `frames`, at most [`SEND_BATCH`], to the kernel in one call and says how
    /// many it took, in their order. Never waits.
    ///
    /// # Errors
    /// When it took none: `ENOBUFS` while the interface's transmit queue is full (waiting for the
    /// socket to become writable does not help), `EAGAIN` while the socket's own buffer is,
    /// `ENETDOWN`, `ENXIO` or `ENODEV` when the interface is down or gone, `EINVAL` for a CAN FD
    /// frame where there is no CAN FD.
    pub fn send(&self, frames: &[WireFrame]) -> io::Result<usize> {
        match frames {
            [] => return Ok(0),
            [frame] => return self.send_one(frame),
            _ => {}
        }
        let mut vectors = [EMPTY_VECTOR; SEND_BATCH];
        for (vector, frame) in vectors.iter_mut().zip(frames) {
            vector.iov_base = ptr::from_ref(&frame.bytes).cast_mut().cast();
            vector.iov_len = frame.length;
        }
        // SAFETY: mmsghdr is plain data for which all zeroes are a valid value.
        let mut headers: [mmsghdr; SEND_BATCH] = unsafe { std::mem::zeroed() };
        for (header, vector) in headers.iter_mut().zip(&mut vectors).take(frames.len()) {
            header.msg_hdr.msg_iov = ptr::from_mut(vector);
            header.msg_hdr.msg_iovlen = 1;
        }
        let count = frames.len().min(SEND_BATCH) as c_uint;
        // SAFETY: the first `count` headers point to one vector each, and these to the bytes of
        // `frames`, which are only read; all of them outlive the call.
        let sent = unsafe {
            libc::sendmmsg(self.0.as_raw_fd(), headers.as_mut_ptr(), count, libc::MSG_DONTWAIT as _)
        };
        Ok(usize::try_from(checked(sent)?).unwrap_or(0))
    }

    /// Hands over one frame, which costs less without a list.
    fn send_one(&self, frame: &WireFrame) -> io::Result<usize> {
        let (bytes, flags) = (frame.bytes.as_ptr().cast(), libc::MSG_DONTWAIT);
        // SAFETY: the pointer and length describe the bytes of `frame`, which are only read, within
        // their array, and outlive the call.
        let sent = unsafe {
            libc::send(self.0.as_raw_fd(), bytes, frame.length.min(frame.bytes.len()), flags)
        };
        if sent < 0 { Err(io::Error::last_os_error()) } else { Ok(1) }
    }

    fn bind(&self, index: u32) -> io::Result<()> {
        // SAFETY: sockaddr_can is plain data for which all zeroes are a valid value.
        let mut address: libc::sockaddr_can = unsafe { std::mem::zeroed() };
        address.can_family = libc::AF_CAN as libc::sa_family_t;
        // Index 0 would mean every interface there is.
        let index = c_int::try_from(index).ok().filter(|index| *index > 0);
        address.can_ifindex = index.ok_or_else(|| io::Error::from_raw_os_error(libc::ENODEV))?;
        let length = size_of_val(&address) as libc::socklen_t;
        // SAFETY: the pointer and length describe `address`, which outlives the call.
        checked(unsafe { libc::bind(self.0.as_raw_fd(), ptr::from_ref(&address).cast(), length) })?;
        Ok(())
    }

    fn set<T>(&self, name: c_int, value: &[T]) -> io::Result<()> {
        let length = size_of_val(value) as libc::socklen_t;
        let level = libc::SOL_CAN_RAW;
        // SAFETY: the pointer and length describe `value`, which outlives the call.
        checked(unsafe {
            libc::setsockopt(self.0.as_raw_fd(), level, name, value.as_ptr().cast(), length)
        })?;
        Ok(())
    }
}

const EMPTY_VECTOR: iovec = iovec { iov_base: ptr::null_mut(), iov_len: 0 };

impl AsFd for CanSender {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.0.as_fd()
    }
}

fn checked(result: c_int) -> io::Result<c_int> {
    if result < 0 { Err(io::Error::last_os_error()) } else { Ok(result) }
}
