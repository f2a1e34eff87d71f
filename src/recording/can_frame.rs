//! Layout `frame`: one `bustape.CanFrame` message for each CAN frame (`schemas/bustape`).

use super::wire::{Field, Fields, put_bytes, put_uint};
use crate::frame::{CanFlags, CanFrame};

/// The flag fields of the message, by field number.
const FLAGS: [(u32, CanFlags); 7] = [
    (2, CanFlags::EXTENDED),
    (3, CanFlags::REMOTE),
    (4, CanFlags::ERROR),
    (5, CanFlags::FD),
    (6, CanFlags::BRS),
    (7, CanFlags::ESI),
    (8, CanFlags::TX),
];

/// Appends the message to `out`.
pub fn encode(frame: &CanFrame, out: &mut Vec<u8>) {
    put_uint(out, 1, u64::from(frame.id));
    if frame.flags != CanFlags::default() {
        for (field, flag) in FLAGS {
            put_uint(out, field, u64::from(frame.flags.has(flag)));
        }
    }
    put_uint(out, 9, u64::from(frame.dlc));
    put_bytes(out, 10, frame.data());
}

/// Reads a message back; `None` if the bytes are not one.
pub fn decode(bytes: &[u8]) -> Option<CanFrame> {
    let (mut id, mut flags, mut dlc, mut data) = (0, CanFlags::default(), 0, &[][..]);
    let mut fields = Fields::of(bytes);
    for (number, field) in fields.by_ref() {
        match (number, field) {
            (1, Field::Uint(value)) => id = u32::try_from(value).ok()?,
            (9, Field::Uint(value)) => dlc = u8::try_from(value).ok()?,
            (10, Field::Bytes(bytes)) => data = bytes,
            (number, Field::Uint(1)) => {
                if let Some((_, flag)) = FLAGS.iter().find(|(field, _)| *field == number) {
                    flags |= *flag;
                }
            }
            _ => {}
        }
    }
    (fields.sound() && data.len() <= crate::frame::CAN_MAX_DATA)
        .then(|| CanFrame::new(id, flags, data).with_dlc(dlc))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use prost::Message as _;

    use super::*;
    use crate::recording::schema::bustape;

    fn any_frame() -> impl Strategy<Value = CanFrame> {
        let data = prop::collection::vec(any::<u8>(), 0..=64);
        (any::<u32>(), 0u8..0x80, 0u8..16, data).prop_map(|(id, flags, dlc, data)| {
            CanFrame::new(id, CanFlags(flags), &data).with_dlc(dlc)
        })
    }

    proptest! {
        #[test]
        fn a_frame_comes_back_as_it_was(frame in any_frame()) {
            let mut bytes = Vec::new();
            encode(&frame, &mut bytes);
            prop_assert_eq!(decode(&bytes), Some(frame));
        }

        #[test]
        fn the_generated_type_reads_the_same(frame in any_frame()) {
            let mut bytes = Vec::new();
            encode(&frame, &mut bytes);
            let read = bustape::CanFrame::decode(&bytes[..]).unwrap();
            prop_assert_eq!(read.id, frame.id);
            prop_assert_eq!(read.extended, frame.flags.has(CanFlags::EXTENDED));
            prop_assert_eq!(read.remote, frame.flags.has(CanFlags::REMOTE));
            prop_assert_eq!(read.error, frame.flags.has(CanFlags::ERROR));
            prop_assert_eq!(read.fd, frame.flags.has(CanFlags::FD));
            prop_assert_eq!(read.brs, frame.flags.has(CanFlags::BRS));
            prop_assert_eq!(read.esi, frame.flags.has(CanFlags::ESI));
            prop_assert_eq!(read.tx, frame.flags.has(CanFlags::TX));
            prop_assert_eq!(read.dlc, u32::from(frame.dlc));
            prop_assert_eq!(&read.data[..], frame.data());
        }
    }
}
