//! What can go wrong with the frames of the station.

use super::device;
use crate::frame::{CanFlags, CanFrame};
use crate::simulate::faults::Rates;
use crate::simulate::random::Random;

/// A fault of one frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// The frame is not sent.
    Missing,
    /// One data byte less than declared.
    Short,
    /// One data byte more than declared; frames of 8 bytes stay as they are.
    Long,
    /// An identifier that the protocol does not know, in front of the frame.
    UnknownId,
    /// The frame twice.
    Duplicate,
    /// A packet of a MODBUS structure is sent after the next one; other frames stay as they are.
    OutOfOrder,
    /// An error frame of the kernel (`linux/can/error.h`) in front of the frame. It never was on a
    /// wire, so nothing but a virtual interface and a recording inside this process can carry it.
    BusError,
}

/// All faults by name.
pub const FAULTS: &[(&str, Fault)] = &[
    ("missing", Fault::Missing),
    ("short", Fault::Short),
    ("long", Fault::Long),
    ("unknown-id", Fault::UnknownId),
    ("duplicate", Fault::Duplicate),
    ("out-of-order", Fault::OutOfOrder),
    ("bus-error", Fault::BusError),
];

/// How often each happens.
pub type BusFaults = Rates<Fault>;

/// `CAN_ERR_PROT | CAN_ERR_BUSERROR`: a protocol violation, of which the data tell more.
const BUS_ERROR: u32 = 0x08 | 0x80;
/// Devices that the protocol numbers (section 3) end with this.
const LAST_DEVICE: u32 = 0x14;

/// Damages frames as they are sent.
#[derive(Clone, Debug)]
pub struct Damage {
    rates: BusFaults,
    random: Random,
    /// Waits for the next packet of its structure.
    held: Option<CanFrame>,
}

impl Damage {
    /// Faults as `rates` says, always the same ones for a seed.
    pub fn new(seed: u64, rates: BusFaults) -> Self {
        Self { rates, random: Random::new(seed, 0xFA17), held: None }
    }

    /// The frames that are sent in place of `frame`.
    pub fn apply(&mut self, frame: CanFrame) -> Vec<CanFrame> {
        if let Some(held) = self.held.take() {
            // Lost packets end a structure too, so whatever comes next lets the held one go.
            return vec![frame, held];
        }
        let data = frame.data();
        match self.rates.pick(&mut self.random) {
            Some(Fault::Missing) => Vec::new(),
            Some(Fault::Short) if !data.is_empty() => {
                vec![CanFrame::new(frame.id, frame.flags, &data[..data.len() - 1])]
            }
            Some(Fault::Long) if data.len() < 8 && !frame.flags.has(CanFlags::REMOTE) => {
                let byte = [self.random.index(256) as u8];
                vec![CanFrame::new(frame.id, frame.flags, &[data, &byte].concat())]
            }
            Some(Fault::UnknownId) => {
                let device = LAST_DEVICE + 1 + self.random.index(200) as u32;
                let packet = self.random.index(256) as u32;
                vec![CanFrame::new(device << 16 | packet, CanFlags::EXTENDED, data), frame]
            }
            Some(Fault::Duplicate) => vec![frame, frame],
            Some(Fault::OutOfOrder) if is_modbus(&frame) => {
                self.held = Some(frame);
                Vec::new()
            }
            Some(Fault::BusError) => vec![self.bus_error(), frame],
            _ => vec![frame],
        }
    }

    /// Byte 2 is the kind of violation, byte 3 where in the frame (`linux/can/error.h`).
    fn bus_error(&mut self) -> CanFrame {
        // CAN_ERR_PROT_BIT, _FORM, _STUFF; _LOC_DATA, _LOC_CRC_SEQ.
        let kind = [0x01, 0x02, 0x04][self.random.index(3)];
        let place = [0x0A, 0x08][self.random.index(2)];
        CanFrame::new(BUS_ERROR, CanFlags::ERROR, &[0, 0, kind, place, 0, 0, 0, 0])
    }
}

fn is_modbus(frame: &CanFrame) -> bool {
    let [_, _, device, _] = frame.id.to_le_bytes();
    matches!(device, device::MODBUS_REQ | device::MODBUS_ANS)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::hmi_can::HmiCan;

    /// What is sent with one fault always, and what would have been sent.
    fn damaged(fault: &str) -> Vec<(CanFrame, Vec<CanFrame>)> {
        let mut damage = Damage::new(1, Rates::parse(FAULTS, &format!("{fault}=1")).unwrap());
        let frames = HmiCan::new(1, 1440.0).take(3000);
        frames.map(|(_, frame)| (frame, damage.apply(frame))).collect()
    }

    #[test]
    fn each_fault_does_what_it_is_called() {
        assert!(damaged("missing").iter().all(|(_, sent)| sent.is_empty()));
        assert!(damaged("duplicate").iter().all(|(frame, sent)| sent == &[*frame, *frame]));
        for (frame, sent) in damaged("short") {
            assert_eq!(sent[0].data().len(), frame.data().len().saturating_sub(1));
        }
        for (frame, sent) in damaged("long") {
            let more = usize::from(frame.data().len() < 8 && !frame.flags.has(CanFlags::REMOTE));
            assert_eq!(sent[0].data().len(), frame.data().len() + more);
        }
        for (frame, sent) in damaged("unknown-id") {
            assert!(sent.len() == 2 && sent[0].id >> 16 > 0x14 && sent[1] == frame);
        }
        for (frame, sent) in damaged("bus-error") {
            assert!(sent[0].flags.has(CanFlags::ERROR) && sent[1] == frame);
        }
    }

    #[test]
    fn a_held_modbus_packet_follows_the_next_frame() {
        let all = damaged("out-of-order");
        let held = all.iter().position(|(_, sent)| sent.is_empty()).expect("no MODBUS");
        assert!(is_modbus(&all[held].0));
        assert_eq!(all[held + 1].1, [all[held + 1].0, all[held].0]);
        let sent: usize = all.iter().map(|(_, sent)| sent.len()).sum();
        assert!(all.len() - sent <= 1, "none is lost");
    }
}
