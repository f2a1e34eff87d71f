//! One object: `LOBJ`, sizes, kind, time, and what follows from the kind.

use crate::import::little_endian::{u16_at, u32_at, u64_at};

/// What each object begins with.
pub(super) const SIGNATURE: &[u8; 4] = b"LOBJ";
/// Signature, header size, header version, object size, object kind.
pub(super) const BASE: usize = 16;
/// An object may begin this much later than the one before ends; writers round up in various ways.
pub(super) const PADDING: usize = 7;

pub(super) const CAN_MESSAGE: u32 = 1;
pub(super) const CAN_ERROR: u32 = 2;
pub(super) const LOG_CONTAINER: u32 = 10;
pub(super) const CAN_ERROR_EXT: u32 = 73;
pub(super) const CAN_MESSAGE2: u32 = 86;
pub(super) const OVERRUN_ERROR: u32 = 91;
pub(super) const CAN_FD_MESSAGE: u32 = 100;
pub(super) const CAN_FD_MESSAGE_64: u32 = 101;
pub(super) const CAN_FD_ERROR_64: u32 = 104;

/// The first 16 bytes of an object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Base {
    pub header_size: u16,
    pub version: u16,
    /// Bytes of the whole object, from its signature on, without padding.
    pub size: u32,
    pub kind: u32,
}

impl Base {
    /// Reads it, if these bytes can be the beginning of an object.
    pub fn parse(bytes: &[u8]) -> Option<Self> {
        if !bytes.starts_with(SIGNATURE) {
            return None;
        }
        let base = Self {
            header_size: u16_at(bytes, 4)?,
            version: u16_at(bytes, 6)?,
            size: u32_at(bytes, 8)?,
            kind: u32_at(bytes, 12)?,
        };
        (base.size as usize >= BASE && base.kind < 0x1_0000).then_some(base)
    }

    /// True for a kind that tells of a frame, or of frames that were lost.
    pub fn is_traffic(self) -> bool {
        matches!(
            self.kind,
            CAN_MESSAGE
                | CAN_ERROR
                | CAN_ERROR_EXT
                | CAN_MESSAGE2
                | OVERRUN_ERROR
                | CAN_FD_MESSAGE
                | CAN_FD_MESSAGE_64
                | CAN_FD_ERROR_64
        )
    }

    /// The longest such object that is believed.
    pub fn longest(self) -> usize {
        if self.is_traffic() { 1 << 10 } else { 16 << 20 }
    }
}

/// A whole object with its time.
#[derive(Clone, Copy, Debug)]
pub(super) struct Object<'a> {
    pub kind: u32,
    /// Nanoseconds since the start of the measurement.
    pub time: u64,
    /// What stands behind the header.
    pub body: &'a [u8],
    /// Where the body begins in the object.
    pub body_at: usize,
}

impl<'a> Object<'a> {
    /// Reads the rest of the header. The error says what is odd about it.
    ///
    /// Versions 1 and 3 have flags, two numbers of 16 bits and the time; version 2 has another time
    /// behind, the original one.
    pub fn parse(base: Base, bytes: &'a [u8]) -> Result<Self, String> {
        let body_at = match base.version {
            1 | 3 => 32,
            2 => 40,
            other => return Err(format!("its header has the unknown version {other}")),
        };
        let (Some(flags), Some(time), Some(body)) =
            (u32_at(bytes, 16), u64_at(bytes, 24), bytes.get(body_at..))
        else {
            return Err(format!("it has only {} bytes", bytes.len()));
        };
        // 1: steps of 10 us; 2, and whatever else there may be: 1 ns.
        let time = if flags == 1 { time.saturating_mul(10_000) } else { time };
        Ok(Self { kind: base.kind, time, body, body_at })
    }
}

/// Where in an object another one begins: its size is wrong then, and would swallow the other.
pub(super) fn begins_inside(object: &[u8]) -> Option<usize> {
    let behind = object.get(BASE..)?;
    let found = memchr::memmem::find_iter(behind, SIGNATURE);
    found.map(|at| BASE + at).find(|&at| Base::parse(&object[at..]).is_some())
}

/// What the format calls a kind of object, for those that are met beside frames.
pub(super) fn name(kind: u32) -> Option<&'static str> {
    let name = match kind {
        CAN_MESSAGE => "CAN_MESSAGE",
        CAN_ERROR => "CAN_ERROR",
        3 => "CAN_OVERLOAD",
        4 => "CAN_STATISTIC",
        5 => "APP_TRIGGER",
        6 => "ENV_INTEGER",
        7 => "ENV_DOUBLE",
        8 => "ENV_STRING",
        9 => "ENV_DATA",
        LOG_CONTAINER => "LOG_CONTAINER",
        11 => "LIN_MESSAGE",
        31 => "CAN_DRIVER_ERROR",
        44 => "CAN_DRIVER_SYNC",
        46 => "GPS_EVENT",
        50 => "FLEXRAY_RCVMESSAGE",
        51 => "REALTIMECLOCK",
        57 => "LIN_MESSAGE2",
        65 => "APP_TEXT",
        66 => "FLEXRAY_RCVMESSAGE_EX",
        71 => "ETHERNET_FRAME",
        72 => "SYS_VARIABLE",
        CAN_ERROR_EXT => "CAN_ERROR_EXT",
        74 => "CAN_DRIVER_ERROR_EXT",
        CAN_MESSAGE2 => "CAN_MESSAGE2",
        90 => "SERIAL_EVENT",
        OVERRUN_ERROR => "OVERRUN_ERROR",
        92 => "EVENT_COMMENT",
        96 => "GLOBAL_MARKER",
        CAN_FD_MESSAGE => "CAN_FD_MESSAGE",
        CAN_FD_MESSAGE_64 => "CAN_FD_MESSAGE_64",
        CAN_FD_ERROR_64 => "CAN_FD_ERROR_64",
        115 => "RESTORE_POINT_CONTAINER",
        118 => "TEST_STRUCTURE",
        120 => "ETHERNET_FRAME_EX",
        125 => "DATA_LOST_BEGIN",
        126 => "DATA_LOST_END",
        127 => "WATER_MARK_EVENT",
        128 => "TRIGGER_CONDITION",
        _ => return None,
    };
    Some(name)
}
