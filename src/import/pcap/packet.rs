//! What is in a packet, by its link type (tcpdump.org/linktypes).

use super::block::Packet;
use crate::frame::{
    CAN_MAX_DATA, CanFlags, CanFrame, Direction, Frame, LineError, LineErrorKind, SerialBytes,
};

/// LINKTYPE_LINUX_SLL and LINKTYPE_LINUX_SLL2: captured on all interfaces at once.
const SLL: u32 = 113;
const SLL2: u32 = 276;
/// LINKTYPE_CAN_SOCKETCAN.
const SOCKETCAN: u32 = 227;
/// LINKTYPE_RTAC_SERIAL.
pub const RTAC_SERIAL: u32 = 250;
/// `ARPHRD_CAN` of `linux/if_arp.h`.
const ARPHRD_CAN: u16 = 280;
/// Protocols of CAN in those (`linux/if_ether.h`, `ETH_P_CAN`, `_CANFD`, `_CANXL`). CSS Electronics'
/// `mdf2pcap` gives nothing else.
const PROTOCOLS: std::ops::RangeInclusive<u16> = 0x000C..=0x000E;
const CAN_FD: u16 = 0x000D;
/// `PACKET_OUTGOING` of `linux/if_packet.h`.
const OUTGOING: u16 = 4;

const EXTENDED: u32 = 0x8000_0000;
const REMOTE: u32 = 0x4000_0000;
const ERROR: u32 = 0x2000_0000;
const FDF: u8 = 0x04;

const CUT: &str = "not all of it was captured (a snapshot length)";

/// A frame, and the number of its interface where the link type says so.
pub struct Found {
    /// The frame.
    pub frame: Frame,
    /// Index of the interface in the kernel.
    pub interface: Option<u32>,
}

/// The frame of a packet; `None` if it is of another kind of link.
pub fn frames(
    data: &[u8],
    link: u32,
    packet: &Packet,
    big_endian: bool,
) -> Result<Option<Found>, String> {
    let pair = |at: usize| Some(u16::from_be_bytes([*data.get(at)?, *data.get(at + 1)?]));
    let sent = if packet.sent { CanFlags::TX } else { CanFlags::default() };
    let is_can = |kind, protocol| {
        pair(kind) == Some(ARPHRD_CAN) || pair(protocol).is_some_and(|p| PROTOCOLS.contains(&p))
    };
    let (payload, sent, interface, big, fd) = match link {
        SOCKETCAN => (Some(data), sent, None, true, false),
        RTAC_SERIAL => {
            let frame = serial(data, packet.cut)?.map(|frame| Found { frame, interface: None });
            return Ok(frame);
        }
        SLL if is_can(2, 14) => {
            (data.get(16..), out(pair(0)), None, big_endian, pair(14) == Some(CAN_FD))
        }
        SLL2 if is_can(8, 0) => {
            let number =
                data.get(4..8).and_then(|bytes| Some(u32::from_be_bytes(bytes.try_into().ok()?)));
            let kind = data.get(10).map(|kind| u16::from(*kind));
            (data.get(20..), out(kind), number, big_endian, pair(0) == Some(CAN_FD))
        }
        _ => return Ok(None),
    };
    let sent = if fd { sent | CanFlags::FD } else { sent };
    let frame = can(payload.unwrap_or_default(), sent, packet.cut, big)?;
    Ok(Some(Found { frame: Frame::Can(frame), interface }))
}

fn out(kind: Option<u16>) -> CanFlags {
    if kind == Some(OUTGOING) { CanFlags::TX } else { CanFlags::default() }
}

/// `struct can_frame` or `struct canfd_frame` of `linux/can.h`. Its identifier is big endian, but
/// behind a header of LINUX_SLL it is as the capturing machine had it.
fn can(data: &[u8], said: CanFlags, cut: bool, big: bool) -> Result<CanFrame, String> {
    let [a, b, c, d, length, fd_flags, _, raw_dlc, payload @ ..] = data else {
        return Err(format!("its {} bytes are too few for a CAN frame", data.len()));
    };
    let word = [*a, *b, *c, *d];
    let word = if big { u32::from_be_bytes(word) } else { u32::from_le_bytes(word) };
    // `struct canxl_frame` has a priority there, and this bit where the length is.
    if length & 0x80 != 0 {
        return Err("CAN XL frames are not taken".to_owned());
    }
    let length = usize::from(*length);
    // Until Linux 6.1 only the size of the structure told CAN FD frames.
    let fd = said.has(CanFlags::FD)
        || fd_flags & FDF != 0
        || length > 8
        || payload.len() == CAN_MAX_DATA;
    let most = if fd { CAN_MAX_DATA } else { 8 };
    let extended = word & EXTENDED != 0;
    let mut flags = said;
    if word & ERROR != 0 {
        flags |= CanFlags::ERROR;
    } else if extended {
        flags |= CanFlags::EXTENDED;
    }
    let id = word & if extended || word & ERROR != 0 { 0x1FFF_FFFF } else { 0x7FF };
    // CAN FD has no remote frames: what is called both is one without data, or else none.
    if word & REMOTE != 0 && word & ERROR == 0 && (!fd || length == 0) {
        #[allow(clippy::cast_possible_truncation, reason = "at most 8")]
        let dlc = if *raw_dlc > 8 { *raw_dlc & 15 } else { length.min(8) as u8 };
        let flags = CanFlags(flags.0 & !CanFlags::FD.0) | CanFlags::REMOTE;
        return Ok(CanFrame::new(id, flags, &[]).with_dlc(dlc));
    }
    if fd {
        flags |= CanFlags::FD;
        flags |= if fd_flags & 1 != 0 { CanFlags::BRS } else { CanFlags::default() };
        flags |= if fd_flags & 2 != 0 { CanFlags::ESI } else { CanFlags::default() };
    }
    match payload.get(..length) {
        Some(_) if length > most => Err(format!("{length} bytes are too many for a CAN frame")),
        Some(payload) => {
            let raw = if !fd && length == 8 && (9..=15).contains(raw_dlc) { *raw_dlc } else { 0 };
            Ok(CanFrame::new(id, flags, payload).with_dlc(raw))
        }
        None if cut => Err(CUT.to_owned()),
        None => Err(format!("it has {} of its {length} bytes", payload.len())),
    }
}

/// A packet of LINKTYPE_RTAC_SERIAL; `None` for one that is no data.
fn serial(data: &[u8], cut: bool) -> Result<Option<Frame>, String> {
    let [_, _, _, _, _, _, _, _, event, _, _, _, bytes @ ..] = data else {
        return Err(format!("its {} bytes are too few for a serial packet", data.len()));
    };
    let offset = u32::try_from(bytes.len().saturating_sub(1)).unwrap_or(0);
    let (direction, error) = match event {
        1 | 3 => (Direction::Tx, None),
        2 | 4 => (Direction::Rx, None),
        7 => (Direction::Rx, Some(LineErrorKind::Framing)),
        8 => (Direction::Rx, Some(LineErrorKind::Parity)),
        9 => (Direction::Rx, Some(LineErrorKind::Break)),
        10 => (Direction::Rx, Some(LineErrorKind::Overrun)),
        _ => return Ok(None),
    };
    if cut {
        return Err(CUT.to_owned());
    }
    let errors = error.map(|kind| LineError { offset, kind }).into_iter().collect();
    Ok(Some(Frame::Serial(SerialBytes { direction, data: bytes.to_vec(), errors })))
}
