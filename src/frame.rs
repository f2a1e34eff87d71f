//! What moves through bustape: one thing that happened on one bus at one time.
//!
//! Loss is a variant of [`Frame`], not a log line: a [`Gap`] travels the same way as the frames
//! around it and ends up in the file between them.

use std::fmt;

/// Nanoseconds since 1970-01-01T00:00:00Z on the recording's steady timeline.
///
/// The timeline starts at the wall clock's time and then advances with the steady clock, so a step
/// of the wall clock neither bends an interval nor moves a later stamp before an earlier one
/// (see [`crate::clock`]).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Timestamp(pub u64);

impl Timestamp {
    /// Nanoseconds since the epoch.
    pub fn nanos(self) -> u64 {
        self.0
    }

    /// This time plus `nanos`, staying at the end of the range instead of overflowing.
    #[must_use]
    pub fn plus(self, nanos: u64) -> Self {
        Self(self.0.saturating_add(nanos))
    }

    /// Nanoseconds from `earlier` to `self`, 0 if `self` is not later.
    pub fn since(self, earlier: Self) -> u64 {
        self.0.saturating_sub(earlier.0)
    }
}

/// A value and the time it happened.
#[derive(Clone, Debug, PartialEq)]
pub struct Stamped<T> {
    /// When it happened.
    pub time: Timestamp,
    /// What happened.
    pub value: T,
}

/// Everything that can happen on a bus.
#[derive(Clone, Debug, PartialEq)]
pub enum Frame {
    /// A CAN frame: data, remote or error.
    Can(CanFrame),
    /// Bytes of a serial line, as one read or write carried them.
    Serial(SerialBytes),
    /// Something existed on the bus that we do not have.
    Gap(Gap),
    /// Something a person should know; ends up on `/bustape/log`.
    Notice(Notice),
}

impl Frame {
    /// What it counts for in its bus's [`Unit`].
    pub fn weight(&self) -> u64 {
        match self {
            Self::Can(_) => 1,
            Self::Serial(bytes) => bytes.data.len() as u64,
            Self::Gap(_) | Self::Notice(_) => 0,
        }
    }
}

/// Longest CAN payload: 64 bytes of a CAN FD frame.
pub const CAN_MAX_DATA: usize = 64;

/// Properties of a CAN frame, one bit each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct CanFlags(pub u8);

impl CanFlags {
    /// 29-bit identifier.
    pub const EXTENDED: Self = Self(0x01);
    /// Remote request (classic CAN only): carries a length but no data.
    pub const REMOTE: Self = Self(0x02);
    /// Error frame: `id` holds the error class bits of `linux/can/error.h`, data the details.
    pub const ERROR: Self = Self(0x04);
    /// CAN FD frame.
    pub const FD: Self = Self(0x08);
    /// CAN FD bit rate switch.
    pub const BRS: Self = Self(0x10);
    /// CAN FD error state indicator: the sender is error passive.
    pub const ESI: Self = Self(0x20);
    /// Sent by this host, seen on the bus.
    pub const TX: Self = Self(0x40);

    /// True if every bit of `other` is set.
    pub fn has(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }
}

impl std::ops::BitOr for CanFlags {
    type Output = Self;
    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

impl std::ops::BitOrAssign for CanFlags {
    fn bitor_assign(&mut self, other: Self) {
        self.0 |= other.0;
    }
}

/// One CAN frame: classic or FD; data, remote or error.
#[derive(Clone, Copy)]
pub struct CanFrame {
    /// Identifier: 11 or 29 bits; the error class of an error frame.
    pub id: u32,
    /// What kind of frame it is.
    pub flags: CanFlags,
    /// Where the frame's length says something that `data` does not: the requested length of a
    /// remote frame, or the raw DLC 9..=15 of a classic frame with 8 bytes. 0 otherwise.
    pub dlc: u8,
    len: u8,
    data: [u8; CAN_MAX_DATA],
}

impl CanFrame {
    /// A frame with `data` cut at 64 bytes (no CAN frame is longer).
    pub fn new(id: u32, flags: CanFlags, data: &[u8]) -> Self {
        let len = data.len().min(CAN_MAX_DATA);
        let mut bytes = [0; CAN_MAX_DATA];
        bytes[..len].copy_from_slice(&data[..len]);
        #[allow(clippy::cast_possible_truncation, reason = "len <= 64")]
        Self { id, flags, dlc: 0, len: len as u8, data: bytes }
    }

    /// The same frame with a DLC that its data do not show.
    #[must_use]
    pub fn with_dlc(mut self, dlc: u8) -> Self {
        self.dlc = dlc;
        self
    }

    /// The payload, 0 to 64 bytes.
    pub fn data(&self) -> &[u8] {
        &self.data[..usize::from(self.len)]
    }
}

// Bytes behind `len` are not part of the frame.
impl PartialEq for CanFrame {
    fn eq(&self, other: &Self) -> bool {
        (self.id, self.flags, self.dlc, self.data())
            == (other.id, other.flags, other.dlc, other.data())
    }
}

impl fmt::Debug for CanFrame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "CanFrame({:X} flags {:02X} dlc {}", self.id, self.flags.0, self.dlc)?;
        write!(f, " data {:02X?})", self.data())
    }
}

/// Which way bytes went on a serial line, seen from the host (the controlling computer).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Direction {
    /// From the device to the host.
    Rx,
    /// From the host to the device.
    Tx,
}

/// What a serial line did wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum LineErrorKind {
    /// Parity bit wrong.
    Parity,
    /// Stop bit missing.
    Framing,
    /// The kernel says only that parity or framing was wrong.
    ParityOrFraming,
    /// Break: the line was held low for longer than a character.
    Break,
    /// The UART or its driver lost bytes before the kernel could take them.
    Overrun,
}

/// A line error and the byte it belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LineError {
    /// Index into the data of the same [`SerialBytes`]; its length if no byte is concerned.
    pub offset: u32,
    /// What went wrong.
    pub kind: LineErrorKind,
}

/// Bytes exactly as one read returned them (or one write sent them), never joined or split.
#[derive(Clone, Debug, PartialEq)]
pub struct SerialBytes {
    /// Which way they went.
    pub direction: Direction,
    /// The bytes.
    pub data: Vec<u8>,
    /// What the kernel said was wrong with them.
    pub errors: Vec<LineError>,
}

/// What a [`Gap`] counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Unit {
    /// CAN frames.
    Frames,
    /// Serial bytes.
    Bytes,
}

impl Unit {
    /// The unit in words.
    pub fn name(self) -> &'static str {
        match self {
            Self::Frames => "frames",
            Self::Bytes => "bytes",
        }
    }
}

/// Why something was lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum GapReason {
    /// The socket's receive queue in the kernel was full.
    KernelQueue,
    /// The recorder's own queue was full: the disk was too slow for too long.
    RecorderQueue,
    /// The link was down or the device gone; how much passed meanwhile is unknown (count 0).
    LinkDown,
    /// The UART or its driver ran over.
    Overrun,
    /// The adapter (slcan) said that its own buffer ran over.
    Adapter,
    /// Writing to the disk failed.
    Disk,
}

impl GapReason {
    /// Every reason for which something can be counted as dropped.
    pub const ALL: [Self; 6] = [
        Self::KernelQueue,
        Self::RecorderQueue,
        Self::LinkDown,
        Self::Overrun,
        Self::Adapter,
        Self::Disk,
    ];

    /// The reason as it is called in metadata and tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::KernelQueue => "kernel_queue",
            Self::RecorderQueue => "recorder_queue",
            Self::LinkDown => "link_down",
            Self::Overrun => "overrun",
            Self::Adapter => "adapter",
            Self::Disk => "disk",
        }
    }
}

/// Something that existed on the bus but is not in the recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gap {
    /// How many; 0 when nobody can know.
    pub count: u64,
    /// Of what.
    pub unit: Unit,
    /// Why.
    pub reason: GapReason,
    /// Not earlier than this.
    pub from: Timestamp,
    /// Not later than this.
    pub to: Timestamp,
}

/// How much a [`Notice`] matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// Good to know.
    Info,
    /// Something was lost or is not as asked.
    Warning,
    /// Something does not work.
    Error,
}

/// A sentence for a person, written to `/bustape/log`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Notice {
    /// How much it matters.
    pub level: Level,
    /// The whole sentence: operation, object, number, next step.
    pub text: String,
}
