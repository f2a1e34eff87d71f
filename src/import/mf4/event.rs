//! Bus events as frames.

use super::field::Field;
use crate::frame::{CAN_MAX_DATA, CanFlags, CanFrame, FD_LENGTHS};

/// What an event is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Data,
    Error,
    Remote,
}

/// Where the bytes of a frame are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Payload {
    None,
    /// In the record.
    Inline(Field),
    /// In signal data that begin with this block, at the place the field says.
    Signal(Field, u64),
    /// In the records of the group at this address, counted as if they were signal data.
    Group(Field, u64),
}

/// The fields of a group of bus events. The names are those of ASAM's bus logging.
#[derive(Debug)]
pub(super) struct Event {
    pub kind: Kind,
    pub id: Option<Field>,
    pub ide: Option<Field>,
    pub channel: Option<Field>,
    pub dlc: Option<Field>,
    pub length: Option<Field>,
    pub sent: Option<Field>,
    pub edl: Option<Field>,
    pub brs: Option<Field>,
    pub esi: Option<Field>,
    pub remote: Option<Field>,
    pub error: Option<Field>,
    pub payload: Payload,
    /// The bus where records do not say it.
    pub bus: String,
}

impl Event {
    /// The frame that a record tells of, whose bytes are `data` or more. The error says what is
    /// wrong with it.
    pub fn frame(&self, record: &[u8], data: &[u8]) -> Result<CanFrame, String> {
        let number = |field: &Option<Field>| field.as_ref().map(|field| field.number(record));
        let set = |field: &Option<Field>| number(field).is_some_and(|number| number != 0);
        let raw = number(&self.id).unwrap_or(0);
        #[allow(clippy::cast_possible_truncation, reason = "29 bits")]
        let id = (raw & 0x1FFF_FFFF) as u32;
        let mut flags = CanFlags::default();
        let long = self.ide.map_or(raw >> 31 & 1 != 0, |_| set(&self.ide));
        if long || id > 0x7FF {
            flags |= CanFlags::EXTENDED;
        }
        if self.sent.as_ref().is_some_and(|field| field.is_sent(record)) {
            flags |= CanFlags::TX;
        }
        let dlc = number(&self.dlc);
        let dlc = dlc.map(|dlc| u8::try_from(dlc).unwrap_or(u8::MAX));
        if self.kind == Kind::Remote || self.kind == Kind::Data && set(&self.remote) {
            let dlc = dlc.unwrap_or(0);
            if dlc > 15 {
                return Err(format!("its DLC is {dlc}"));
            }
            return Ok(CanFrame::new(id, flags | CanFlags::REMOTE, &[]).with_dlc(dlc));
        }
        let edl = set(&self.edl);
        let length = match (number(&self.length), dlc) {
            (Some(length), _) => usize::try_from(length).unwrap_or(usize::MAX),
            (None, Some(dlc)) => length_of(dlc, edl),
            (None, None) => data.len(),
        };
        if length > CAN_MAX_DATA {
            return Err(format!("it has {length} bytes"));
        }
        let data = &data[..length.min(data.len())];
        if self.kind == Kind::Error {
            return Ok(error(number(&self.error), id, data));
        }
        if data.len() < length {
            return Err(format!("{} of its {length} bytes are missing", length - data.len()));
        }
        if edl || length > 8 {
            flags |= CanFlags::FD;
            for (field, flag) in [(&self.brs, CanFlags::BRS), (&self.esi, CanFlags::ESI)] {
                if set(field) {
                    flags |= flag;
                }
            }
        }
        let frame = CanFrame::new(id, flags, data);
        let dlc = dlc.filter(|dlc| (9..=15).contains(dlc) && length == 8);
        Ok(match dlc {
            Some(dlc) if !flags.has(CanFlags::FD) => frame.with_dlc(dlc),
            _ => frame,
        })
    }
}

/// An error frame: as the kernel's error class where the ID is one, which is what recorders of
/// SocketCAN write; by ASAM's types of errors otherwise (1 bit, 2 form, 3 stuff, 4 CRC, 5 ACK),
/// in the words of `linux/can/error.h`.
fn error(kind: Option<u64>, id: u32, data: &[u8]) -> CanFrame {
    if kind.is_none() && id <= 0x3FF {
        return CanFrame::new(id, CanFlags::ERROR, data);
    }
    let mut details = [0; 8];
    let class = match kind {
        Some(kind @ 1..=3) => {
            details[2] = [1, 2, 4][usize::try_from(kind - 1).unwrap_or(0)];
            0x88
        }
        Some(4) => {
            // CAN_ERR_PROT_LOC_CRC_SEQ
            details[3] = 0x08;
            0x88
        }
        // CAN_ERR_ACK and CAN_ERR_BUSERROR
        Some(5) => 0xA0,
        _ => 0x80,
    };
    CanFrame::new(class, CanFlags::ERROR, &details)
}

/// The data length of a DLC.
fn length_of(dlc: u8, fd: bool) -> usize {
    if fd { FD_LENGTHS[usize::from(dlc.min(15))].into() } else { dlc.min(8).into() }
}
