//! What a DBC file says, as the decoder needs it.

use std::sync::Arc;

/// So many signals of a file are loaded; the others are counted.
pub const MAX_SIGNALS: usize = 1 << 18;

/// So many signals of a message are loaded: what one frame may cost to decode is bounded.
pub const MAX_SIGNALS_PER_MESSAGE: usize = 1 << 13;

/// So many texts of value tables, and as many ranges of multiplexed signals, are loaded.
pub const MAX_LIST: usize = 1 << 20;

/// The messages of one bus.
#[derive(Debug, Default)]
pub struct Database {
    /// `VERSION`, often empty.
    pub version: String,
    /// `BU_`: who is on the bus.
    pub nodes: Vec<String>,
    /// Network attribute `ProtocolType`, e.g. "J1939".
    pub protocol: Option<String>,
    /// Comment of the file as a whole.
    pub comment: String,
    /// In the order of the file.
    pub messages: Vec<Message>,
}

/// How a message's frames look (attribute `VFrameFormat`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Format {
    /// The file does not say.
    #[default]
    Unsaid,
    /// Classic or FD, recognised by its whole identifier.
    Plain,
    /// SAE J1939: recognised by its parameter group number.
    J1939,
}

/// `BO_`: a message.
#[derive(Clone, Debug, Default)]
pub struct Message {
    /// 11 or 29 bits.
    pub id: u32,
    /// 29-bit identifier (bit 31 in the file).
    pub extended: bool,
    /// Its name; unique in the database.
    pub name: String,
    /// Declared length, bytes. J1939 messages may have up to 1785, more than a frame carries.
    pub length: u16,
    /// Who sends it (`BO_` and `BO_TX_BU_`).
    pub senders: Vec<String>,
    /// In the order of the file.
    pub signals: Vec<Signal>,
    /// `CM_ BO_`.
    pub comment: String,
    /// Attribute `GenMsgCycleTime`, ms; 0 when not said.
    pub cycle_time: u32,
    /// Attribute `VFrameFormat`.
    pub format: Format,
    /// Line of its definition.
    pub line: u32,
}

/// Which bit of a signal stands first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ByteOrder {
    /// Little-endian, `@1`: the start bit is the least significant one.
    Intel,
    /// Big-endian, `@0`: the start bit is the most significant one.
    Motorola,
}

/// What the bits of a signal are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Number {
    /// Integer without sign.
    Unsigned,
    /// Integer, two's complement.
    Signed,
    /// IEEE 754, 32 bits.
    Float32,
    /// IEEE 754, 64 bits.
    Float64,
}

/// When a multiplexed signal is in the frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Gate {
    /// Index of the switch (multiplexor) among the message's signals.
    pub switch: usize,
    /// Raw values of the switch, both ends included; sorted, not overlapping.
    pub ranges: Vec<(u64, u64)>,
}

/// A value table: raw values and their texts, sorted.
pub type Labels = Arc<[(i128, Box<str>)]>;

/// `SG_`: a signal.
#[derive(Clone, Debug)]
pub struct Signal {
    /// Its name; unique in the message.
    pub name: String,
    /// Start bit as in the file: byte × 8 + bit, bit 0 the least significant of its byte.
    pub start: u16,
    /// Bits, 1 to 64.
    pub length: u16,
    /// Byte order.
    pub order: ByteOrder,
    /// What the bits are.
    pub number: Number,
    /// value = raw × factor + offset.
    pub factor: f64,
    /// See `factor`.
    pub offset: f64,
    /// Least value; informative, 0 and 0 with `max` when not said.
    pub min: f64,
    /// Largest value.
    pub max: f64,
    /// Unit of the value.
    pub unit: String,
    /// It selects other signals (`M`, `m0M`).
    pub switch: bool,
    /// When it is in the frame; `None`: always.
    pub gate: Option<Gate>,
    /// Texts of raw values.
    pub labels: Option<Labels>,
    /// `CM_ SG_`.
    pub comment: String,
    /// Line of its definition.
    pub line: u32,
}

impl Signal {
    /// Bytes a frame must have so that the whole signal is in it.
    pub fn bytes(&self) -> usize {
        let (start, length) = (usize::from(self.start), usize::from(self.length));
        let last = match self.order {
            ByteOrder::Intel => start + length - 1,
            // Counted in the order of transmission, where a byte's bit 7 comes first.
            ByteOrder::Motorola => (start / 8) * 8 + (7 - start % 8) + length - 1,
        };
        last / 8 + 1
    }

    /// The text of a raw value (its bits, sign not extended).
    pub fn label(&self, raw: u64) -> Option<&str> {
        let labels = self.labels.as_ref()?;
        let key = match self.number {
            Number::Unsigned => i128::from(raw),
            Number::Signed => {
                let unused = 64 - u32::from(self.length);
                i128::from(((raw << unused) as i64) >> unused)
            }
            Number::Float32 => whole(f64::from(f32::from_bits(u32::try_from(raw).ok()?)))?,
            Number::Float64 => whole(f64::from_bits(raw))?,
        };
        let index = labels.binary_search_by_key(&key, |(value, _)| *value).ok()?;
        labels.get(index).map(|(_, text)| &**text)
    }
}

impl Message {
    /// Which way its frames go, `SENDER-to-RECEIVER`, when the database has just two nodes.
    pub fn direction(&self, nodes: &[String]) -> Option<String> {
        let ([a, b], [sender]) = (nodes, self.senders.as_slice()) else { return None };
        match sender {
            sender if sender == a => Some(format!("{a}-to-{b}")),
            sender if sender == b => Some(format!("{b}-to-{a}")),
            _ => None,
        }
    }
}

/// The integer that a float is, if it is one.
#[allow(clippy::cast_possible_truncation, reason = "the range is checked")]
pub fn whole(value: f64) -> Option<i128> {
    (value.fract() == 0.0 && value.abs() < 1e19).then_some(value as i128)
}
