//! A raw CAN socket that only listens: there is no call in this file that could send.
//!
//! Sources: `linux/can.h`, `linux/can/raw.h`, `Documentation/networking/can.rst`,
//! `Documentation/networking/timestamping.rst`, socket(7).

use std::io;
use std::mem::{size_of, size_of_val};
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, FromRawFd, OwnedFd, RawFd};
use std::ptr;

use libc::{c_int, can_filter};

use super::can_batch::{BATCH, CanBatch};

/// A raw CAN socket. Non-blocking, closed on exec.
#[derive(Debug)]
pub struct CanSocket(OwnedFd);

impl CanSocket {
    /// A socket that is bound to nothing and receives nothing yet.
    ///
    /// # Errors
    /// `EAFNOSUPPORT` where the kernel has no CAN, `EPROTONOSUPPORT` where it has no raw CAN
    /// sockets, `EPERM` or `EACCES` where a sandbox forbids them.
    pub fn new() -> io::Result<Self> {
        let kind = libc::SOCK_RAW | libc::SOCK_NONBLOCK | libc::SOCK_CLOEXEC;
        // SAFETY: socket() takes no pointers.
        let fd = checked(unsafe { libc::socket(libc::PF_CAN, kind, libc::CAN_RAW) })?;
        // SAFETY: the kernel has just returned this descriptor, so nobody else owns it.
        Ok(Self(unsafe { OwnedFd::from_raw_fd(fd) }))
    }

    /// Starts to receive from the interface with this index. Options must be set before.
    ///
    /// # Errors
    /// `ENODEV` where the interface is gone or is not a CAN interface.
    pub fn bind(&self, index: u32) -> io::Result<()> {
        // SAFETY: sockaddr_can is plain data for which all zeroes are a valid value.
        let mut address: libc::sockaddr_can = unsafe { std::mem::zeroed() };
        address.can_family = libc::AF_CAN as libc::sa_family_t;
        address.can_ifindex =
            c_int::try_from(index).map_err(|_| io::Error::from_raw_os_error(libc::ENODEV))?;
        let length = size_of_val(&address) as libc::socklen_t;
        // SAFETY: the pointer and length describe `address`, which outlives the call.
        checked(unsafe { libc::bind(self.fd(), ptr::from_ref(&address).cast(), length) })?;
        Ok(())
    }

    /// Receives CAN FD frames too.
    ///
    /// # Errors
    /// `ENOPROTOOPT` on kernels before 3.6.
    pub fn receive_fd_frames(&self) -> io::Result<()> {
        self.set(libc::SOL_CAN_RAW, libc::CAN_RAW_FD_FRAMES, &1)
    }

    /// Receives error frames of the classes in `mask` (`linux/can/error.h`); 0 for none.
    ///
    /// # Errors
    /// None that a caller could do something about.
    pub fn receive_errors(&self, mask: u32) -> io::Result<()> {
        self.set(libc::SOL_CAN_RAW, libc::CAN_RAW_ERR_FILTER, &mask.cast_signed())
    }

    /// Lets only frames through that match one of `filters`, or with `join` all of them.
    ///
    /// # Errors
    /// `EINVAL` for more than 512 filters.
    pub fn filter(&self, filters: &[can_filter], join: bool) -> io::Result<()> {
        let length = size_of_val(filters) as libc::socklen_t;
        let (level, name) = (libc::SOL_CAN_RAW, libc::CAN_RAW_FILTER);
        // SAFETY: the pointer and length describe `filters`, which outlives the call.
        let set =
            unsafe { libc::setsockopt(self.fd(), level, name, filters.as_ptr().cast(), length) };
        checked(set)?;
        if join { self.set(level, libc::CAN_RAW_JOIN_FILTERS, &1) } else { Ok(()) }
    }

    /// Lets each frame carry the kernel's count of dropped frames, if that is not 0.
    ///
    /// # Errors
    /// None on kernels since 2.6.33.
    pub fn count_drops(&self) -> io::Result<()> {
        self.set(libc::SOL_SOCKET, libc::SO_RXQ_OVFL, &1)
    }

    /// Lets each frame carry the wall clock time at which the kernel received it.
    ///
    /// # Errors
    /// None on kernels since 2.6.22.
    pub fn stamp(&self) -> io::Result<()> {
        // The newer option has 64-bit seconds on 32-bit machines too; kernels before 5.1 lack it.
        self.set(libc::SOL_SOCKET, libc::SO_TIMESTAMPNS_NEW, &1)
            .or_else(|_| self.set(libc::SOL_SOCKET, libc::SO_TIMESTAMPNS, &1))
    }

    /// Lets each frame carry the controller's own time too, if its driver supplies one.
    ///
    /// # Errors
    /// None on kernels since 2.6.30.
    pub fn stamp_by_hardware(&self) -> io::Result<()> {
        let flags = libc::SOF_TIMESTAMPING_RX_HARDWARE | libc::SOF_TIMESTAMPING_RAW_HARDWARE;
        self.set(libc::SOL_SOCKET, libc::SO_TIMESTAMPING_NEW, &flags.cast_signed())
            .or_else(|_| self.set(libc::SOL_SOCKET, libc::SO_TIMESTAMPING, &flags.cast_signed()))
    }

    /// Asks for a receive buffer of `bytes` and returns what was granted, counted as
    /// `net.core.rmem_max` counts it (the kernel sets aside twice that, for its bookkeeping).
    /// Without `CAP_NET_ADMIN` the kernel grants at most `net.core.rmem_max`.
    ///
    /// # Errors
    /// None that a caller could do something about.
    pub fn set_receive_buffer(&self, bytes: usize) -> io::Result<usize> {
        // The kernel doubles the number in a signed int.
        let wanted = c_int::try_from(bytes).unwrap_or(c_int::MAX).min(c_int::MAX / 2);
        self.set(libc::SOL_SOCKET, libc::SO_RCVBUFFORCE, &wanted)
            .or_else(|_| self.set(libc::SOL_SOCKET, libc::SO_RCVBUF, &wanted))?;
        let mut granted = [0u32];
        self.get(libc::SO_RCVBUF, &mut granted)?;
        Ok(granted[0] as usize / 2)
    }

    /// How many frames the kernel has dropped since the socket was made, because the receive
    /// buffer was full. Wraps at 2^32.
    ///
    /// # Errors
    /// `ENOPROTOOPT` on kernels before 4.12.
    pub fn drops(&self) -> io::Result<u32> {
        let mut info = [0u32; libc::SK_MEMINFO_DROPS as usize + 1];
        self.get(libc::SO_MEMINFO, &mut info)?;
        Ok(info[libc::SK_MEMINFO_DROPS as usize])
    }

    /// Takes what the kernel holds, at most 128 messages, into `batch`, replacing what was there.
    /// Never waits. Fewer than 128 mean that the kernel holds no more.
    ///
    /// # Errors
    /// `EAGAIN` when there is nothing; `ENETDOWN` once when the interface went down and `ENODEV`
    /// once when it was removed (messages received before that can still be read afterwards).
    pub fn receive(&self, batch: &mut CanBatch) -> io::Result<usize> {
        let headers = batch.headers();
        // The types of the flags and of the count differ between C libraries.
        let (count, flags) = (BATCH as _, libc::MSG_DONTWAIT as _);
        // SAFETY: `headers` points to BATCH headers, whose pointers and lengths describe the
        // buffers of the same `batch`; all of them outlive the call, and since we hold
        // `&mut batch` nobody else looks at them meanwhile.
        let taken = unsafe { libc::recvmmsg(self.fd(), headers, count, flags, ptr::null_mut()) };
        let filled = usize::try_from(checked(taken)?).unwrap_or(0);
        batch.fill(filled);
        Ok(filled)
    }

    fn fd(&self) -> RawFd {
        self.0.as_raw_fd()
    }

    fn set(&self, level: c_int, name: c_int, value: &c_int) -> io::Result<()> {
        let length = size_of::<c_int>() as libc::socklen_t;
        // SAFETY: the pointer and length describe `value`, which outlives the call.
        checked(unsafe {
            libc::setsockopt(self.fd(), level, name, ptr::from_ref(value).cast(), length)
        })?;
        Ok(())
    }

    fn get(&self, name: c_int, into: &mut [u32]) -> io::Result<()> {
        let mut length = size_of_val(into) as libc::socklen_t;
        // SAFETY: the pointer and length describe `into`, which outlives the call; the kernel
        // writes at most `length` bytes, and any bytes make valid u32s.
        checked(unsafe {
            let into = into.as_mut_ptr().cast();
            libc::getsockopt(self.fd(), libc::SOL_SOCKET, name, into, &raw mut length)
        })?;
        Ok(())
    }
}

impl AsRawFd for CanSocket {
    fn as_raw_fd(&self) -> RawFd {
        self.fd()
    }
}

impl AsFd for CanSocket {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.0.as_fd()
    }
}

fn checked(result: c_int) -> io::Result<c_int> {
    if result < 0 { Err(io::Error::last_os_error()) } else { Ok(result) }
}
