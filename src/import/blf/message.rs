//! Objects as frames.

use super::error_code;
use super::object::{
    CAN_ERROR, CAN_ERROR_EXT, CAN_FD_ERROR_64, CAN_FD_MESSAGE, CAN_FD_MESSAGE_64, CAN_MESSAGE,
    CAN_MESSAGE2, OVERRUN_ERROR, Object,
};
use crate::frame::{CAN_MAX_DATA, CanFlags, CanFrame};
use crate::import::little_endian::{u16_at, u32_at};

/// What an object tells.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Told {
    /// A frame on this channel (1 is the first), and the DLC as the object says it: a recorder may
    /// have written one that no frame can have.
    Frame(u16, CanFrame, u8),
    /// Nobody knows how many frames are missing on this channel.
    Overrun(u16),
    /// Something else.
    Nothing,
}

/// Bit 31 of an identifier: it has 29 bits.
const EXTENDED: u32 = 0x8000_0000;
/// Kind of bus in [`OVERRUN_ERROR`]: CAN.
const BUS_CAN: u32 = 1;

/// Reads what an object tells. The error says what is wrong with it.
pub(super) fn read(object: Object) -> Result<Told, String> {
    let cut = || format!("it has only {} bytes behind its header", object.body.len());
    match object.kind {
        CAN_MESSAGE | CAN_MESSAGE2 => classic(object.body).ok_or_else(cut),
        CAN_FD_MESSAGE => fd(object.body).ok_or_else(cut)?,
        CAN_FD_MESSAGE_64 => fd_64(object).ok_or_else(cut)?,
        CAN_ERROR => error(object.body).ok_or_else(cut),
        CAN_ERROR_EXT => error_ext(object.body).ok_or_else(cut),
        CAN_FD_ERROR_64 => fd_error_64(object.body).ok_or_else(cut),
        OVERRUN_ERROR => overrun(object.body).ok_or_else(cut),
        _ => Ok(Told::Nothing),
    }
}

/// Identifier and what its bit 31 says. Recorders that forget the bit are helped: no identifier
/// above 7FF has 11 bits.
fn identifier(id: u32) -> (u32, CanFlags) {
    let bits = id & 0x1FFF_FFFF;
    let extended = id & EXTENDED != 0 || bits > 0x7FF;
    (bits, if extended { CanFlags::EXTENDED } else { CanFlags::default() })
}

/// Lower four bits of the flags: 0 received, 1 sent, 2 asked to be sent. Bit 7: remote.
fn direction(flags: u8) -> CanFlags {
    if flags.is_multiple_of(16) { CanFlags::default() } else { CanFlags::TX }
}

/// A classic frame: the data are as long as the DLC says, at most 8 bytes. A DLC above 15 is none
/// of four bits; the data are then all that are there.
fn classic_frame(id: u32, flags: CanFlags, dlc: u8, data: &[u8]) -> CanFrame {
    if flags.has(CanFlags::REMOTE) {
        return CanFrame::new(id, flags, &[]).with_dlc(dlc.min(15));
    }
    let frame = CanFrame::new(id, flags, &data[..data.len().min(dlc.min(8).into())]);
    if (9..=15).contains(&dlc) && frame.data().len() == 8 { frame.with_dlc(dlc) } else { frame }
}

/// CAN_MESSAGE and CAN_MESSAGE2: channel, flags, DLC, identifier, 8 bytes.
fn classic(body: &[u8]) -> Option<Told> {
    let (channel, raw, dlc) = (u16_at(body, 0)?, *body.get(2)?, *body.get(3)?);
    let (id, mut flags) = identifier(u32_at(body, 4)?);
    flags |= direction(raw);
    if raw & 0x80 != 0 {
        flags |= CanFlags::REMOTE;
    }
    // The 8 bytes are always there; some recorders write no more than are used.
    let used = if flags.has(CanFlags::REMOTE) { 0 } else { usize::from(dlc.min(8)) };
    let data = body.get(8..8 + used)?;
    Some(Told::Frame(channel, classic_frame(id, flags, dlc, data), dlc))
}

/// CAN_FD_MESSAGE: channel, flags, DLC, identifier, frame length (4), bits (1), FD flags, bytes
/// that are valid, 5 reserved, data.
fn fd(body: &[u8]) -> Option<Result<Told, String>> {
    let (channel, raw, dlc) = (u16_at(body, 0)?, *body.get(2)?, *body.get(3)?);
    let (id, mut flags) = identifier(u32_at(body, 4)?);
    let (fd_flags, valid) = (*body.get(13)?, *body.get(14)?);
    flags |= direction(raw);
    let bits = [(0x1, CanFlags::FD), (0x2, CanFlags::BRS), (0x4, CanFlags::ESI)];
    flags = bits.iter().filter(|(bit, _)| fd_flags & bit != 0).fold(flags, |all, (_, f)| all | *f);
    let data = &body.get(20..)?;
    Some(
        fd_frame(id, flags, raw & 0x80 != 0, dlc, valid, data)
            .map(|f| Told::Frame(channel, f, dlc)),
    )
}

/// CAN_FD_MESSAGE_64: channel, DLC, bytes that are valid, transmissions, identifier, frame length,
/// flags, 16 bytes of timing, bits (2), direction, where more data begin in the object, CRC, data.
fn fd_64(object: Object) -> Option<Result<Told, String>> {
    const DATA: usize = 40;
    let body = object.body;
    let (channel, dlc, valid) = (*body.first()?, *body.get(1)?, *body.get(2)?);
    let (id, mut flags) = identifier(u32_at(body, 4)?);
    let raw = u32_at(body, 12)?;
    let (sent, more_at) = (*body.get(34)?, usize::from(*body.get(35)?));
    flags |= direction(sent);
    let bits = [(0x1000, CanFlags::FD), (0x2000, CanFlags::BRS), (0x4000, CanFlags::ESI)];
    flags = bits.iter().filter(|(bit, _)| raw & bit != 0).fold(flags, |all, (_, f)| all | *f);
    // Fewer bytes than are called valid may be there; the rest is zero.
    let data = body.get(DATA..)?;
    let until_more = more_at.checked_sub(object.body_at + DATA).filter(|_| more_at != 0);
    let data = &data[..until_more.unwrap_or(data.len()).min(data.len())];
    let frame = fd_frame(id, flags, raw & 0x10 != 0, dlc, valid, data);
    Some(frame.map(|frame| Told::Frame(channel.into(), frame, dlc)))
}

/// A frame of an FD channel, classic unless its flags say FD. Data that are valid but not there are
/// zero.
fn fd_frame(
    id: u32,
    mut flags: CanFlags,
    remote: bool,
    dlc: u8,
    valid: u8,
    data: &[u8],
) -> Result<CanFrame, String> {
    let valid = usize::from(valid);
    if valid > CAN_MAX_DATA {
        return Err(format!("its DLC is {dlc} and its length {valid}"));
    }
    if valid > 8 {
        flags |= CanFlags::FD;
    }
    // CAN FD has no remote frames: what is called both is one without data, or else none.
    if remote && (!flags.has(CanFlags::FD) || valid == 0) {
        let of_fd = CanFlags::FD | CanFlags::BRS | CanFlags::ESI;
        flags = CanFlags(flags.0 & !of_fd.0);
        return Ok(classic_frame(id, flags | CanFlags::REMOTE, dlc, &[]));
    }
    let mut bytes = [0; CAN_MAX_DATA];
    let there = valid.min(data.len());
    bytes[..there].copy_from_slice(&data[..there]);
    let frame = CanFrame::new(id, flags, &bytes[..valid]);
    let more = !flags.has(CanFlags::FD) && (9..=15).contains(&dlc) && valid == 8;
    Ok(if more { frame.with_dlc(dlc) } else { frame })
}

/// CAN_ERROR: channel, length. That there was an error is all it says.
fn error(body: &[u8]) -> Option<Told> {
    let frame = CanFrame::new(error_code::BUS_ERROR, CanFlags::ERROR, &[0; 8]);
    Some(Told::Frame(u16_at(body, 0)?, frame, 8))
}

/// CAN_ERROR_EXT: channel, length, flags (what is valid), error code, position, DLC, reserved, frame
/// length, identifier, extended flags, reserved, 8 bytes.
fn error_ext(body: &[u8]) -> Option<Told> {
    let channel = u16_at(body, 0)?;
    let (valid, code, dlc) = (u32_at(body, 4)?, *body.get(8)?, *body.get(10)? & 0x0F);
    let id = u32_at(body, 16)? & 0x1FFF_FFFF;
    let data = body.get(24..32)?;
    // Recorders of SocketCAN put the kernel's error class where others have the identifier, and
    // its details where others have the data.
    let frame = if error_code::is_class(id) && valid == 0 && code == 0 {
        CanFrame::new(id, CanFlags::ERROR, &data[..usize::from(dlc.min(8))])
    } else {
        error_code::frame(valid & 1 != 0, code)
    };
    Some(Told::Frame(channel, frame, dlc))
}

/// CAN_FD_ERROR_64: channel, DLC, valid bytes, error code, flags (what is valid), ...
fn fd_error_64(body: &[u8]) -> Option<Told> {
    let (channel, code, valid) = (*body.first()?, *body.get(3)?, u16_at(body, 4)?);
    Some(Told::Frame(channel.into(), error_code::frame(valid & 1 != 0, code), 8))
}

/// OVERRUN_ERROR: kind of bus, channel, reserved.
fn overrun(body: &[u8]) -> Option<Told> {
    let (bus, channel) = (u32_at(body, 0)?, u16_at(body, 4)?);
    Some(if bus == BUS_CAN { Told::Overrun(channel) } else { Told::Nothing })
}
