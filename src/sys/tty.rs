//! A serial port (or any other tty) as a non-blocking descriptor.
//!
//! `serialport` opens it and sets rate and format; what it has no call for is here. Facts from
//! termios(3), ioctl_tty(2) and `linux/serial.h`, `linux/tty_flags.h`.

use std::fs::File;
use std::io;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, FromRawFd, IntoRawFd, OwnedFd, RawFd};

use nix::fcntl::{FcntlArg, OFlag, fcntl};
use nix::sys::termios::{self, ControlFlags, FlushArg, InputFlags, SetArg, Termios};
use serialport::{SerialPort, SerialPortBuilder, TTYPort};

/// What a driver counted since it was loaded (TIOCGICOUNT). The counters wrap.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// The UART's own buffer ran over: at least one byte was lost each time.
    pub overrun: u32,
    /// The kernel's buffer for this tty ran over: bytes lost.
    pub buffer_overrun: u32,
}

/// `struct serial_icounter_struct` of `linux/serial.h`.
#[repr(C)]
#[derive(Default)]
struct RawCounts {
    lines: [libc::c_int; 4],
    rx: libc::c_int,
    tx: libc::c_int,
    frame: libc::c_int,
    overrun: libc::c_int,
    parity: libc::c_int,
    brk: libc::c_int,
    buf_overrun: libc::c_int,
    reserved: [libc::c_int; 9],
}

/// `struct serial_struct` of `linux/serial.h`.
#[repr(C)]
struct RawSerial {
    kind: libc::c_int,
    line: libc::c_int,
    port: libc::c_uint,
    irq: libc::c_int,
    flags: libc::c_int,
    xmit_fifo_size: libc::c_int,
    custom_divisor: libc::c_int,
    baud_base: libc::c_int,
    close_delay: libc::c_ushort,
    io_type: libc::c_char,
    reserved: libc::c_char,
    hub6: libc::c_int,
    closing_wait: libc::c_ushort,
    closing_wait2: libc::c_ushort,
    iomem_base: *mut libc::c_uchar,
    iomem_reg_shift: libc::c_ushort,
    port_high: libc::c_uint,
    iomap_base: libc::c_ulong,
}

/// ASYNC_LOW_LATENCY of `linux/tty_flags.h`: hand received bytes over at once. USB bridges with a
/// latency timer (FTDI: 16 ms) set it to its least, 1 ms.
const ASYNC_LOW_LATENCY: libc::c_int = 1 << 13;

/// The system calls of tty_ioctl(4) that nix has no safe form of.
mod ioctl {
    #![allow(missing_docs, reason = "the macros take no comments; see tty_ioctl(4)")]

    use super::{RawCounts, RawSerial};

    nix::ioctl_read_bad!(tiocgicount, libc::TIOCGICOUNT, RawCounts);
    nix::ioctl_read_bad!(tiocgserial, libc::TIOCGSERIAL, RawSerial);
    nix::ioctl_write_ptr_bad!(tiocsserial, libc::TIOCSSERIAL, RawSerial);
    nix::ioctl_read_bad!(tiocoutq, libc::TIOCOUTQ, libc::c_int);
    nix::ioctl_none_bad!(tiocnxcl, libc::TIOCNXCL);
}
use ioctl::{tiocgicount, tiocgserial, tiocnxcl, tiocoutq, tiocsserial};

/// An open tty: raw, non-blocking, exclusive. Closed (without waiting for unsent bytes) on drop.
#[derive(Debug)]
pub struct Tty {
    fd: OwnedFd,
    /// The rate the driver says it really runs at, bit/s.
    pub actual_baud: Option<u32>,
}

impl Tty {
    /// Opens the port that `builder` describes.
    ///
    /// The kernel raises DTR and RTS of a real port when it is opened; no program can prevent that.
    /// Nothing here changes them afterwards.
    pub fn open(builder: &SerialPortBuilder) -> serialport::Result<Self> {
        let port = TTYPort::open(builder)?;
        let actual_baud = port.baud_rate().ok();
        // SAFETY: `into_raw_fd` gives up an open descriptor that nothing else owns or closes.
        let fd = unsafe { OwnedFd::from_raw_fd(port.into_raw_fd()) };
        set_nonblocking(&fd)?;
        Ok(Self { fd, actual_baud })
    }

    /// Reads what has arrived. `Ok(0)` means that the device is gone: a hung-up tty answers so for
    /// ever. `WouldBlock` means that nothing has arrived.
    pub fn read(&self, buffer: &mut [u8]) -> io::Result<usize> {
        Ok(nix::unistd::read(&self.fd, buffer)?)
    }

    /// Writes as much of `bytes` as the kernel takes now; `WouldBlock` if it takes nothing.
    pub fn write(&self, bytes: &[u8]) -> io::Result<usize> {
        Ok(nix::unistd::write(&self.fd, bytes)?)
    }

    /// Makes the kernel mark every byte with a parity or framing error and every break in the
    /// stream (PARMRK): FF 00 x is a bad byte x, FF 00 00 a break, FF FF a good byte FF.
    pub fn mark_errors(&self) -> io::Result<()> {
        self.change(|t| {
            let ignore =
                InputFlags::IGNBRK | InputFlags::BRKINT | InputFlags::IGNPAR | InputFlags::ISTRIP;
            t.input_flags.remove(ignore);
            // Without INPCK drivers report neither parity nor framing errors.
            t.input_flags.insert(InputFlags::INPCK | InputFlags::PARMRK);
        })
    }

    /// Sends and expects a parity bit that is always 1 (mark) or always 0 (space).
    pub fn set_sticky_parity(&self, mark: bool) -> io::Result<()> {
        let sticky = ControlFlags::PARENB | ControlFlags::CMSPAR;
        self.change(|t| {
            t.control_flags.insert(sticky);
            t.control_flags.set(ControlFlags::PARODD, mark);
        })?;
        let now = termios::tcgetattr(&self.fd)?.control_flags;
        if now.contains(sticky) { Ok(()) } else { Err(io::ErrorKind::Unsupported.into()) }
    }

    /// Whether closing the port drops DTR and RTS (HUPCL).
    pub fn hang_up_on_close(&self, hang_up: bool) -> io::Result<()> {
        self.change(|t| t.control_flags.set(ControlFlags::HUPCL, hang_up))
    }

    /// Data bits, parity and stop bits as the driver has them now: bits of `c_cflag`.
    pub fn format_flags(&self) -> io::Result<ControlFlags> {
        let format = ControlFlags::CSIZE
            | ControlFlags::PARENB
            | ControlFlags::PARODD
            | ControlFlags::CMSPAR
            | ControlFlags::CSTOPB;
        Ok(termios::tcgetattr(&self.fd)?.control_flags & format)
    }

    /// The driver's loss counters; `None` where the driver has none (pseudo-terminals, some USB).
    pub fn counts(&self) -> Option<Counts> {
        let mut raw = RawCounts::default();
        // SAFETY: the descriptor is open, and the kernel fills a `serial_icounter_struct`, whose
        // layout `RawCounts` repeats.
        unsafe { tiocgicount(self.fd.as_raw_fd(), &raw mut raw) }.ok()?;
        let (overrun, buffer_overrun) =
            (raw.overrun.cast_unsigned(), raw.buf_overrun.cast_unsigned());
        Some(Counts { overrun, buffer_overrun })
    }

    /// Asks the driver to hand received bytes over at once instead of collecting them.
    ///
    /// The setting stays with the device until it is unplugged. Errors where the driver has no
    /// such setting.
    pub fn set_low_latency(&self) -> io::Result<()> {
        // SAFETY: all fields are integers or a pointer that is never followed; zero is valid.
        let mut raw: RawSerial = unsafe { std::mem::zeroed() };
        // SAFETY: the descriptor is open, and the kernel fills a `serial_struct`, whose layout
        // `RawSerial` repeats.
        unsafe { tiocgserial(self.fd.as_raw_fd(), &raw mut raw) }?;
        raw.flags |= ASYNC_LOW_LATENCY;
        // SAFETY: as above; the kernel reads what it has just filled itself, one flag changed.
        unsafe { tiocsserial(self.fd.as_raw_fd(), &raw const raw) }?;
        Ok(())
    }

    /// Throws away what has arrived but was not read.
    pub fn discard_input(&self) -> io::Result<()> {
        Ok(termios::tcflush(&self.fd, FlushArg::TCIFLUSH)?)
    }

    /// Bytes written but not sent yet.
    pub fn unsent(&self) -> usize {
        let mut count = 0;
        // SAFETY: the descriptor is open, and the kernel writes one int.
        let answer = unsafe { tiocoutq(self.fd.as_raw_fd(), &raw mut count) };
        answer.map_or(0, |_| usize::try_from(count).unwrap_or(0))
    }

    /// True for the user's side of a pseudo-terminal: no baud rate, no parity, no line errors.
    pub fn is_pseudo(&self) -> bool {
        // Unix98 slaves have the majors 136 to 143 (devices.txt of the kernel).
        nix::sys::stat::fstat(&self.fd)
            .is_ok_and(|s| (136..=143).contains(&nix::sys::stat::major(s.st_rdev)))
    }

    fn change(&self, change: impl FnOnce(&mut Termios)) -> io::Result<()> {
        let mut termios = termios::tcgetattr(&self.fd)?;
        change(&mut termios);
        Ok(termios::tcsetattr(&self.fd, SetArg::TCSANOW, &termios)?)
    }
}

impl Drop for Tty {
    fn drop(&mut self) {
        // With unsent bytes on a line that is held by flow control, close(2) would wait for up to
        // 30 s, and every other bus with it. A pseudo-terminal never waits, and its bytes are sent:
        // only its reader has not read them yet.
        if !self.is_pseudo() {
            let _ = termios::tcflush(&self.fd, FlushArg::TCOFLUSH);
        }
        // The exclusive mark belongs to the tty, not to the descriptor: it would outlive us.
        // SAFETY: the descriptor is open; the call takes no argument.
        let _ = unsafe { tiocnxcl(self.fd.as_raw_fd()) };
    }
}

impl AsRawFd for Tty {
    fn as_raw_fd(&self) -> RawFd {
        self.fd.as_raw_fd()
    }
}

impl AsFd for Tty {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.fd.as_fd()
    }
}

pub(super) fn set_nonblocking(fd: &impl AsFd) -> io::Result<()> {
    let flags = OFlag::from_bits_truncate(fcntl(fd, FcntlArg::F_GETFL)?);
    fcntl(fd, FcntlArg::F_SETFL(flags | OFlag::O_NONBLOCK))?;
    Ok(())
}

/// Makes the tty behind `file` raw: bytes pass as they are, no echo, no signals.
pub(super) fn make_raw(file: &File) -> io::Result<()> {
    let mut termios = termios::tcgetattr(file)?;
    termios::cfmakeraw(&mut termios);
    Ok(termios::tcsetattr(file, SetArg::TCSANOW, &termios)?)
}
