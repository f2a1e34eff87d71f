//! One line of a PEAK trace.

use crate::frame::{CAN_MAX_DATA, CanFlags, CanFrame, FD_LENGTHS};
use crate::import::digits::{Words, decimal, fixed, hex, shown};

/// `CAN_ERR_PROT` and `CAN_ERR_BUSERROR` of `linux/can/error.h`.
const PROTOCOL_ERROR: u32 = 0x08 | 0x80;
/// Bits of the type of an error (1 bit, 2 form, 4 stuff) as `linux/can/error.h` has them in byte 2.
const ERROR_TYPES: [(u32, u8); 3] = [(1, 0x01), (2, 0x02), (4, 0x04)];
/// `CAN_ERR_PROT_TX`: the error happened when sending.
const ERROR_TX: u8 = 0x80;
/// More columns than this are in no version.
const MOST_COLUMNS: usize = 16;

/// What stands where in a line.
#[derive(Clone, Debug, PartialEq)]
pub enum Layout {
    /// `N) O I L D`.
    V1_0,
    /// `N) O T I L D`.
    V1_1,
    /// `N) O B T I L D`.
    V1_2,
    /// `N) O B T I R L D`.
    V1_3,
    /// As `$COLUMNS` says.
    Columns(Vec<u8>),
}

impl Layout {
    /// By the file's version.
    pub fn of(version: &[u8]) -> Self {
        match version {
            b"1.1" => Self::V1_1,
            b"1.2" => Self::V1_2,
            b"1.3" => Self::V1_3,
            [b'2'..=b'9', ..] => Self::Columns(b"NOTBIdRLD".to_vec()),
            _ => Self::V1_0,
        }
    }

    /// With the letters of `$COLUMNS`, which only versions from 2.0 on have.
    pub fn with_columns(&self, text: &[u8]) -> Self {
        match self {
            Self::Columns(_) => {
                let letters = text.split(|&byte| byte == b',').map(<[u8]>::trim_ascii);
                let letters = letters.filter_map(|letter| letter.first().copied());
                Self::Columns(letters.take(MOST_COLUMNS).collect())
            }
            other => other.clone(),
        }
    }
}

/// What a line is.
pub enum Row {
    /// A CAN frame.
    Frame(Taken),
    /// Something else.
    Other,
    /// Should be a CAN frame, but cannot be taken.
    Broken(String),
}

/// A frame, its bus and its time since the start.
pub struct Taken {
    /// From 1.
    pub bus: u64,
    /// Nanoseconds.
    pub nanos: u64,
    /// The frame.
    pub frame: CanFrame,
}

/// Reads a line.
pub fn read(text: &[u8], layout: &Layout) -> Row {
    let found = match layout {
        Layout::Columns(letters) => by_columns(text, letters),
        layout => first_versions(text, layout),
    };
    match found {
        Ok(Some(taken)) => Row::Frame(taken),
        Ok(None) => Row::Other,
        Err(why) => Row::Broken(why),
    }
}

fn first_versions(text: &[u8], layout: &Layout) -> Result<Option<Taken>, String> {
    let mut words = Words(text);
    let number = words.next().unwrap_or_default();
    if decimal(number.strip_suffix(b")").unwrap_or(number)).is_none() {
        return Err("it does not begin with the number of a message".to_owned());
    }
    let nanos = words.next().and_then(|word| fixed(word, 6)).ok_or("it has no time")?;
    let mut bus = 1;
    if matches!(layout, Layout::V1_2 | Layout::V1_3) {
        bus = words.next().and_then(decimal).ok_or("it has no number of a bus")?;
    }
    let mut flags = CanFlags::default();
    let mut kind: &[u8] = b"Rx";
    if *layout != Layout::V1_0 {
        kind = words.next().ok_or("it ends behind its time")?;
    }
    match kind {
        b"Rx" | b"Error" => {}
        b"Tx" => flags |= CanFlags::TX,
        _ => return Ok(None),
    }
    let id = words.next().ok_or("it has no identifier")?;
    // Warnings of version 1.0; later ones have a type.
    if id == b"FFFFFFFF" {
        return Ok(None);
    }
    if *layout == Layout::V1_3 {
        words.next();
    }
    let length = words.next().and_then(decimal).ok_or("it has no length")?;
    if kind == b"Error" || *layout == Layout::V1_0 && words.accept(b"ERROR") {
        let mut data = [0; 4];
        let given = bytes(words, &mut data[..usize::try_from(length.min(4)).unwrap_or(4)])?;
        let kind = hex(id).ok_or_else(|| format!("\"{}\" is no kind of error", shown(id)))?;
        return Ok(Some(Taken { bus, nanos, frame: error_frame(kind, &data[..given]) }));
    }
    let (id, extended) = identifier(id)?;
    flags |= extended;
    if length > 8 {
        return Err(format!("its {length} bytes are no CAN frame (but of a protocol above)"));
    }
    #[allow(clippy::cast_possible_truncation, reason = "at most 8")]
    let dlc = length as u8;
    if words.accept(b"RTR") {
        let frame = CanFrame::new(id, flags | CanFlags::REMOTE, &[]).with_dlc(dlc);
        return Ok(Some(Taken { bus, nanos, frame }));
    }
    let mut data = [0; 8];
    exactly(words, &mut data[..usize::from(dlc)])?;
    let frame = CanFrame::new(id, flags, &data[..usize::from(dlc)]);
    Ok(Some(Taken { bus, nanos, frame }))
}

/// Versions 2.0 and 2.1: the columns are named in the head.
fn by_columns(text: &[u8], letters: &[u8]) -> Result<Option<Taken>, String> {
    let mut words = Words(text);
    let (mut nanos, mut kind, mut bus) = (None, &b""[..], 1);
    let (mut id, mut sent, mut length, mut dlc) = (None, false, None, None);
    for &letter in letters {
        if letter == b'D' {
            break;
        }
        // Lines that are no messages leave columns out, so what they are is needed first.
        if matches!(letter, b'I' | b'd' | b'R' | b'l' | b'L') && !has_message(kind) {
            break;
        }
        let word = words.next().ok_or("it ends before its data")?;
        match letter {
            b'O' => nanos = fixed(word, 6),
            b'T' => kind = word,
            b'B' => bus = decimal(word).unwrap_or(1),
            b'I' => id = Some(word),
            b'd' => sent = word == b"Tx",
            b'l' => length = decimal(word),
            b'L' => dlc = decimal(word),
            _ => {}
        }
    }
    let nanos = nanos.ok_or("it has no time")?;
    let flag = |set, flag| if set { flag } else { CanFlags::default() };
    let tx = flag(sent, CanFlags::TX);
    let flags = tx
        | match kind {
            b"DT" | b"RR" => CanFlags::default(),
            b"FD" => CanFlags::FD,
            b"FB" => CanFlags::FD | CanFlags::BRS,
            b"FE" => CanFlags::FD | CanFlags::BRS | CanFlags::ESI,
            b"BI" => CanFlags::FD | CanFlags::ESI,
            b"ER" => return v2_error(words).map(|frame| Some(Taken { bus, nanos, frame })),
            b"" => return Err("it has no type".to_owned()),
            // Hardware status, error counters, events of users.
            _ => return Ok(None),
        };
    let (id, extended) = identifier(id.unwrap_or_default())?;
    let flags = flags | extended;
    let fd = flags.has(CanFlags::FD);
    if let Some(dlc) = dlc.filter(|dlc| *dlc > 15) {
        return Err(format!("its DLC {dlc} is above 15"));
    }
    #[allow(clippy::cast_possible_truncation, reason = "checked above, or at most 64")]
    let (dlc, length) = match (dlc, length) {
        (Some(dlc), _) if fd => (dlc as u8, FD_LENGTHS[dlc as usize]),
        (Some(dlc), _) => (dlc as u8, dlc.min(8) as u8),
        (None, Some(length)) if length <= if fd { 64 } else { 8 } => (length as u8, length as u8),
        _ => return Err("it has no length that a frame can have".to_owned()),
    };
    if kind == b"RR" {
        let frame = CanFrame::new(id, flags | CanFlags::REMOTE, &[]).with_dlc(dlc);
        return Ok(Some(Taken { bus, nanos, frame }));
    }
    let mut data = [0; CAN_MAX_DATA];
    exactly(words, &mut data[..usize::from(length)])?;
    let frame = CanFrame::new(id, flags, &data[..usize::from(length)]);
    let raw = if !fd && dlc > 8 { dlc } else { 0 };
    Ok(Some(Taken { bus, nanos, frame: frame.with_dlc(raw) }))
}

fn has_message(kind: &[u8]) -> bool {
    matches!(kind, b"DT" | b"RR" | b"FD" | b"FB" | b"FE" | b"BI")
}

/// `[-] Rx [-  5]  04 00 02 00 00`: type, direction, position, both counters.
fn v2_error(mut words: Words<'_>) -> Result<CanFrame, String> {
    words.accept(b"-");
    if words.next().is_none() {
        return Err("it ends before its data".to_owned());
    }
    if words.accept(b"-") {
        words.next();
    }
    let mut data = [0; 5];
    let given = bytes(words, &mut data)?;
    Ok(error_frame(data[0].into(), &data[1..given.max(1)]))
}

/// What SocketCAN would have made of an error: its kind, whether sending, where, the counters.
fn error_frame(kind: u32, details: &[u8]) -> CanFrame {
    let detail = |index: usize| details.get(index).copied().unwrap_or(0);
    let found = ERROR_TYPES.iter().find(|(number, _)| *number == kind);
    let mut data = [0; 8];
    data[2] = found.map_or(0, |(_, bit)| *bit);
    if detail(0) == 0 && !details.is_empty() {
        data[2] |= ERROR_TX;
    }
    // Both count positions as the SJA1000 does.
    data[3] = detail(1);
    (data[7], data[6]) = (detail(2), detail(3));
    CanFrame::new(PROTOCOL_ERROR, CanFlags::ERROR, &data)
}

fn identifier(text: &[u8]) -> Result<(u32, CanFlags), String> {
    let wrong = || format!("\"{}\" is no identifier", shown(text));
    let id = hex(text).ok_or_else(wrong)?;
    // Four digits are 11 bits, eight are 29; python-can pads the latter to seven.
    if text.len() > 4 {
        return if id <= 0x1FFF_FFFF { Ok((id, CanFlags::EXTENDED)) } else { Err(wrong()) };
    }
    if id <= 0x7FF { Ok((id, CanFlags::default())) } else { Err(wrong()) }
}

/// Takes as many bytes as there are, at most as many as fit. Returns how many.
fn bytes(words: Words<'_>, data: &mut [u8]) -> Result<usize, String> {
    let mut count = 0;
    for (byte, word) in data.iter_mut().zip(words) {
        let value =
            hex(word).filter(|_| word.len() <= 2).and_then(|value| u8::try_from(value).ok());
        *byte = value.ok_or_else(|| format!("\"{}\" is no byte", shown(word)))?;
        count += 1;
    }
    Ok(count)
}

fn exactly(words: Words<'_>, data: &mut [u8]) -> Result<(), String> {
    let wanted = data.len();
    match bytes(words, data)? {
        found if found == wanted => Ok(()),
        found => Err(format!("it has {found} of its {wanted} bytes")),
    }
}
