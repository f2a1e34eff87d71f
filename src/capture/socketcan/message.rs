//! From the kernel's bytes to a CAN frame, its stamps and the drop counter.
//!
//! Sources: `linux/can.h` (struct can_frame, struct canfd_frame), `linux/can/error.h`, cmsg(3),
//! `Documentation/networking/can.rst`, `Documentation/networking/timestamping.rst`.

use std::mem::size_of;

use crate::frame::{CanFlags, CanFrame};
use crate::sys::RawMessage;

/// Sizes that tell the two kinds of frames apart. The flag `CANFD_FDF` does not: the kernel sets
/// it on received CAN FD frames, but older kernels and senders leave it out.
const CLASSIC: usize = libc::CAN_MTU;
const FD: usize = libc::CANFD_MTU;

/// A `struct cmsghdr` of the kernel: length (size_t), level and type (int).
const CONTROL_HEADER: usize = size_of::<usize>() + 2 * size_of::<i32>();

/// What one message says.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Message {
    pub frame: CanFrame,
    pub stamps: Stamps,
}

/// What came with a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Stamps {
    /// When the kernel received the frame: nanoseconds of the wall clock.
    pub kernel: Option<u64>,
    /// When the controller received it: nanoseconds of a clock of its own.
    pub hardware: Option<u64>,
    /// How many frames the socket had dropped when this one was queued; `None` for 0.
    pub drops: Option<u32>,
}

/// The frame of one message, or `None` if it is neither a classic nor a CAN FD frame.
pub(super) fn decode(message: RawMessage<'_>) -> Option<Message> {
    let mut frame = match message.payload.len() {
        CLASSIC => classic(message.payload),
        FD => fd(message.payload),
        _ => None,
    }?;
    // So the kernel marks frames that a socket of this host has sent (can.rst, RAW sockets).
    if message.flags & libc::MSG_DONTROUTE != 0 {
        frame.flags |= CanFlags::TX;
    }
    Some(Message { frame, stamps: stamps(message.control) })
}

/// The frame of one message, without what came with it.
pub fn decode_frame(message: RawMessage<'_>) -> Option<CanFrame> {
    decode(message).map(|message| message.frame)
}

/// The frame of one message, and the wall clock time at which the kernel received it.
pub fn decode_stamped(message: RawMessage<'_>) -> Option<(CanFrame, Option<u64>)> {
    decode(message).map(|message| (message.frame, message.stamps.kernel))
}

/// struct can_frame: id (u32), length, 2 reserved, raw DLC, data (8).
fn classic(bytes: &[u8]) -> Option<CanFrame> {
    let id = u32::from_ne_bytes(*bytes.first_chunk()?);
    let length = bytes.get(4).copied()?.min(8);
    let raw = bytes.get(7).copied()?;
    let data = bytes.get(8..8 + usize::from(length))?;
    // Only with 8 bytes has a larger raw DLC a meaning; else the byte is not ours to interpret.
    let raw = if length == 8 && (9..=15).contains(&raw) { raw } else { 0 };
    let flags = id_flags(id);
    if flags.has(CanFlags::REMOTE) {
        // Carries no data: what the struct holds in their place never was on the bus.
        return Some(CanFrame::new(number(id), flags, &[]).with_dlc(raw.max(length)));
    }
    Some(CanFrame::new(number(id), flags, data).with_dlc(raw))
}

/// struct canfd_frame: id (u32), length, flags, 2 reserved, data (64).
fn fd(bytes: &[u8]) -> Option<CanFrame> {
    let id = u32::from_ne_bytes(*bytes.first_chunk()?);
    let length = bytes.get(4).copied()?.min(64);
    let bits = bytes.get(5).copied()?;
    let data = bytes.get(8..8 + usize::from(length))?;
    let mut flags = CanFlags::FD;
    if id & libc::CAN_EFF_FLAG != 0 {
        flags |= CanFlags::EXTENDED;
    }
    if i32::from(bits) & libc::CANFD_BRS != 0 {
        flags |= CanFlags::BRS;
    }
    if i32::from(bits) & libc::CANFD_ESI != 0 {
        flags |= CanFlags::ESI;
    }
    Some(CanFrame::new(number(id), flags, data))
}

fn id_flags(id: u32) -> CanFlags {
    if id & libc::CAN_ERR_FLAG != 0 {
        CanFlags::ERROR
    } else {
        let extended = if id & libc::CAN_EFF_FLAG != 0 { CanFlags::EXTENDED.0 } else { 0 };
        let remote = if id & libc::CAN_RTR_FLAG != 0 { CanFlags::REMOTE.0 } else { 0 };
        CanFlags(extended | remote)
    }
}

/// The identifier without flags: 29 bits for error classes too, 11 for standard frames.
fn number(id: u32) -> u32 {
    if id & (libc::CAN_EFF_FLAG | libc::CAN_ERR_FLAG) != 0 {
        id & libc::CAN_EFF_MASK
    } else {
        id & libc::CAN_SFF_MASK
    }
}

/// What the control messages say. Ends at the first that is not whole.
fn stamps(mut control: &[u8]) -> Stamps {
    let mut stamps = Stamps::default();
    while let Some((length, level, kind)) = control_header(control) {
        let Some(value) = control.get(CONTROL_HEADER.next_multiple_of(WORD)..length) else { break };
        if level == libc::SOL_SOCKET {
            match kind {
                libc::SO_TIMESTAMPNS_NEW | libc::SO_TIMESTAMPNS => stamps.kernel = time(value),
                // Three times; the last is the hardware's, zero if there is none.
                libc::SO_TIMESTAMPING_NEW | libc::SO_TIMESTAMPING => {
                    let third = value.get(value.len() / 3 * 2..).and_then(time);
                    stamps.hardware = third.filter(|nanos| *nanos != 0);
                }
                libc::SO_RXQ_OVFL => {
                    stamps.drops = value.first_chunk().map(|bytes| u32::from_ne_bytes(*bytes));
                }
                _ => {}
            }
        }
        control = control.get(length.next_multiple_of(WORD)..).unwrap_or_default();
    }
    stamps
}

/// Control messages start on boundaries of this many bytes.
const WORD: usize = size_of::<usize>();

fn control_header(control: &[u8]) -> Option<(usize, i32, i32)> {
    let length = usize::from_ne_bytes(*control.first_chunk()?);
    let level = i32::from_ne_bytes(*control.get(WORD..)?.first_chunk()?);
    let kind = i32::from_ne_bytes(*control.get(WORD + size_of::<i32>()..)?.first_chunk()?);
    (length >= CONTROL_HEADER && length <= control.len()).then_some((length, level, kind))
}

/// Seconds and nanoseconds, both of 64 bits, or of 32 bits from an older kernel on a 32-bit
/// machine.
fn time(value: &[u8]) -> Option<u64> {
    let (seconds, nanos) = if value.len() >= 16 {
        let nanos = value.get(8..)?.first_chunk()?;
        (i64::from_ne_bytes(*value.first_chunk()?), i64::from_ne_bytes(*nanos))
    } else {
        let nanos = i32::from_ne_bytes(*value.get(4..)?.first_chunk()?);
        (i32::from_ne_bytes(*value.first_chunk()?).into(), nanos.into())
    };
    let whole = u64::try_from(seconds).ok()?.checked_mul(1_000_000_000)?;
    whole.checked_add(u64::try_from(nanos).ok()?)
}

#[cfg(test)]
mod tests;
