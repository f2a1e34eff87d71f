//! Records: one frame each, in the fields that ASAM's bus logging gives to CAN events.

use crate::frame::{CanFlags, CanFrame, fd_dlc};

/// What a group of records holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Kind {
    /// Classic data frames.
    Classic,
    /// FD frames.
    Fd,
    /// Error frames: the class of `linux/can/error.h` as ID, its details as data.
    Error,
    /// Remote frames.
    Remote,
}

/// A field of a record.
pub(super) struct Field {
    pub name: &'static str,
    /// Where it begins in the record, bytes.
    pub at: u32,
    /// Its size, bytes.
    pub size: u32,
}

const fn field(name: &'static str, at: u32, size: u32) -> Field {
    Field { name, at, size }
}

/// Time in nanoseconds since the start of the file: the first field of all records.
pub(super) const TIME: u32 = 8;

const FIELDS: [Field; 10] = [
    field("ID", 8, 4),
    field("IDE", 12, 1),
    field("BusChannel", 13, 1),
    field("DLC", 14, 1),
    field("DataLength", 15, 1),
    field("Dir", 16, 1),
    field("DataBytes", 17, 8),
    field("EDL", 17, 1),
    field("BRS", 18, 1),
    field("ESI", 19, 1),
];
const FD_DATA: Field = field("DataBytes", 20, 64);

impl Kind {
    pub fn of(frame: &CanFrame) -> Self {
        let has = |flag| frame.flags.has(flag);
        if has(CanFlags::ERROR) {
            Self::Error
        } else if has(CanFlags::FD) {
            Self::Fd
        } else if has(CanFlags::REMOTE) {
            Self::Remote
        } else {
            Self::Classic
        }
    }

    /// The event's name.
    pub fn event(self) -> &'static str {
        match self {
            Self::Classic | Self::Fd => "CAN_DataFrame",
            Self::Error => "CAN_ErrorFrame",
            Self::Remote => "CAN_RemoteFrame",
        }
    }

    /// Its fields behind the time, without gaps.
    pub fn fields(self) -> Vec<&'static Field> {
        match self {
            Self::Classic | Self::Error => FIELDS[..7].iter().collect(),
            Self::Remote => FIELDS[..6].iter().collect(),
            Self::Fd => FIELDS[..6].iter().chain(&FIELDS[7..]).chain([&FD_DATA]).collect(),
        }
    }

    /// Bytes of a record.
    pub fn size(self) -> usize {
        match self {
            Self::Classic | Self::Error => 25,
            Self::Remote => 17,
            Self::Fd => 84,
        }
    }

    /// Appends a record.
    pub fn record(self, into: &mut Vec<u8>, time: u64, channel: u8, frame: &CanFrame) {
        let end = into.len() + self.size();
        let flag = |flag| u8::from(frame.flags.has(flag));
        let data = match self {
            Self::Fd => frame.data(),
            Self::Classic | Self::Error => &frame.data()[..frame.data().len().min(8)],
            Self::Remote => &[],
        };
        #[allow(clippy::cast_possible_truncation, reason = "a frame has at most 64 bytes")]
        let length = data.len() as u8;
        let dlc = if self == Self::Fd { fd_dlc(data.len()) } else { frame.dlc.max(length) };
        into.extend(time.to_le_bytes());
        into.extend(frame.id.to_le_bytes());
        into.extend([flag(CanFlags::EXTENDED), channel, dlc, length, flag(CanFlags::TX)]);
        if self == Self::Fd {
            into.extend([1, flag(CanFlags::BRS), flag(CanFlags::ESI)]);
        }
        into.extend(data);
        into.resize(end, 0);
    }
}
