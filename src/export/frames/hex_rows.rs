//! Serial bytes as hex and ASCII.

use crate::frame::{Direction, LineErrorKind, SerialBytes};

/// Bytes on a line.
const ROW: usize = 16;

/// Appends one read: `(time) rect rx  7E 00 01 ...   |~..|`. Longer reads go on below, without a
/// time.
pub fn put(out: &mut Vec<u8>, time: &[u8], bus: &str, bytes: &SerialBytes) {
    let direction = match bytes.direction {
        Direction::Rx => " rx  ",
        Direction::Tx => " tx  ",
    };
    let indent = time.len() + bus.len() + direction.len();
    for (row, data) in bytes.data.chunks(ROW).enumerate() {
        if row == 0 {
            out.extend_from_slice(time);
            out.extend_from_slice(bus.as_bytes());
            out.extend_from_slice(direction.as_bytes());
        } else {
            out.resize(out.len() + indent, b' ');
        }
        put_row(out, data);
    }
    for error in &bytes.errors {
        let line = format!("# {bus}: {} at byte {}\n", name(error.kind), error.offset);
        out.extend_from_slice(line.as_bytes());
    }
}

fn put_row(out: &mut Vec<u8>, data: &[u8]) {
    let start = out.len();
    for byte in data {
        out.extend_from_slice(format!("{byte:02X} ").as_bytes());
    }
    out.resize(start + ROW * 3, b' ');
    out.extend_from_slice(b" |");
    let shown = |byte: &u8| if (0x20..0x7F).contains(byte) { *byte } else { b'.' };
    out.extend(data.iter().map(shown));
    out.extend_from_slice(b"|\n");
}

/// What went wrong, in words.
pub fn name(kind: LineErrorKind) -> &'static str {
    match kind {
        LineErrorKind::Parity => "parity error",
        LineErrorKind::Framing => "framing error",
        LineErrorKind::ParityOrFraming => "parity or framing error",
        LineErrorKind::Break => "break",
        LineErrorKind::Overrun => "overrun",
    }
}
