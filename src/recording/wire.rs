//! The protobuf wire format, as far as the hot paths need it.
//!
//! Frames are encoded straight into the open chunk and decoded straight from it; going through
//! generated types would allocate for every frame. Everything else uses the generated types of
//! [`super::schema`], and tests hold the two against each other.
//! Source: Protocol Buffers documentation, "Encoding".

/// Wire type of a varint field.
pub const VARINT: u32 = 0;
/// Wire type of 8 bytes, the lowest first.
pub const FIXED64: u32 = 1;
/// Wire type of a length-delimited field.
pub const BYTES: u32 = 2;
/// Wire type of 4 bytes, the lowest first.
pub const FIXED32: u32 = 5;

/// Appends `value` as a varint, 1 to 10 bytes.
pub fn put_varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(low_byte(value) | 0x80);
        value >>= 7;
    }
    out.push(low_byte(value));
}

/// Appends a varint field, or nothing for 0, which is what an absent field means in proto3.
pub fn put_uint(out: &mut Vec<u8>, field: u32, value: u64) {
    if value != 0 {
        put_varint(out, u64::from(field << 3 | VARINT));
        put_varint(out, value);
    }
}

/// Appends a bytes field, or nothing when empty.
pub fn put_bytes(out: &mut Vec<u8>, field: u32, bytes: &[u8]) {
    if !bytes.is_empty() {
        put_varint(out, u64::from(field << 3 | BYTES));
        put_varint(out, bytes.len() as u64);
        out.extend_from_slice(bytes);
    }
}

/// Appends a nested message.
pub fn put_message(out: &mut Vec<u8>, field: u32, message: &impl prost::Message) {
    put_varint(out, u64::from(field << 3 | BYTES));
    put_varint(out, message.encoded_len() as u64);
    append(out, message);
}

/// Appends a message as it is.
pub fn append(out: &mut Vec<u8>, message: &impl prost::Message) {
    message.encode_raw(out);
}

/// How many bytes [`put_varint`] writes.
pub fn varint_len(value: u64) -> usize {
    (70 - (value | 1).leading_zeros() as usize) / 7
}

fn low_byte(value: u64) -> u8 {
    value.to_le_bytes()[0]
}

/// One field of a message.
#[derive(Debug, PartialEq, Eq)]
pub enum Field<'a> {
    /// A varint.
    Uint(u64),
    /// Bytes, a text, a nested message or packed numbers.
    Bytes(&'a [u8]),
    /// A fixed 32 or 64 bit number.
    Fixed(u64),
}

/// Walks the fields of a message. Ends early, with [`Fields::sound`] false, where bytes are not a
/// message.
pub struct Fields<'a> {
    rest: &'a [u8],
    sound: bool,
}

impl<'a> Fields<'a> {
    /// The fields of the message in `bytes`.
    pub fn of(bytes: &'a [u8]) -> Self {
        Self { rest: bytes, sound: true }
    }

    /// True when all bytes so far made sense.
    pub fn sound(&self) -> bool {
        self.sound
    }

    fn field(&mut self) -> Option<(u32, Field<'a>)> {
        let tag = take_varint(&mut self.rest)?;
        let number = u32::try_from(tag >> 3).ok()?;
        let field = match tag & 7 {
            0 => Field::Uint(take_varint(&mut self.rest)?),
            1 => Field::Fixed(u64::from_le_bytes(take(&mut self.rest, 8)?.try_into().ok()?)),
            2 => {
                let len = usize::try_from(take_varint(&mut self.rest)?).ok()?;
                Field::Bytes(take(&mut self.rest, len)?)
            }
            5 => {
                let bytes: [u8; 4] = take(&mut self.rest, 4)?.try_into().ok()?;
                Field::Fixed(u64::from(u32::from_le_bytes(bytes)))
            }
            _ => return None,
        };
        Some((number, field))
    }
}

impl<'a> Iterator for Fields<'a> {
    type Item = (u32, Field<'a>);

    fn next(&mut self) -> Option<Self::Item> {
        if self.rest.is_empty() || !self.sound {
            return None;
        }
        let field = self.field();
        self.sound = field.is_some();
        field
    }
}

/// Takes a varint off the front; `None` when the bytes end inside it or it is longer than 64 bits.
pub fn take_varint(rest: &mut &[u8]) -> Option<u64> {
    let mut value = 0;
    for shift in (0..64).step_by(7) {
        let (&byte, tail) = rest.split_first()?;
        *rest = tail;
        value |= u64::from(byte & 0x7F) << shift;
        if byte < 0x80 {
            return Some(value);
        }
    }
    None
}

fn take<'a>(rest: &mut &'a [u8], len: usize) -> Option<&'a [u8]> {
    let (head, tail) = rest.split_at_checked(len)?;
    *rest = tail;
    Some(head)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn varints_of_every_length_come_back() {
        for shift in 0..64 {
            for value in [1u64 << shift, (1u64 << shift) - 1, u64::MAX >> shift] {
                let mut bytes = Vec::new();
                put_varint(&mut bytes, value);
                assert_eq!(bytes.len(), varint_len(value), "{value:#x}");
                assert_eq!(take_varint(&mut &bytes[..]), Some(value));
            }
        }
    }

    #[test]
    fn bytes_that_are_no_message_end_without_harm() {
        for bytes in [&[0x80][..], &[0x0A, 5, 1], &[0x0B], &[0xFF; 20], &[0x09, 1, 2]] {
            let mut fields = Fields::of(bytes);
            while fields.next().is_some() {}
            assert!(!fields.sound(), "{bytes:X?}");
        }
    }
}
