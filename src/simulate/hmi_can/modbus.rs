//! MODBUS over CAN: one structure cut into packets of 8 bytes (HMI CAN protocol, section 6).

use super::{device, frame};
use crate::frame::CanFrame;
use crate::simulate::station::Station;

/// Registers that fit into one structure, since one byte holds its length.
pub const MOST_REGISTERS: u16 = 123;
/// Bytes in front of the registers.
const HEADER: usize = 8;

/// Result codes of an answer (section 9, MBERR).
pub mod result {
    #![allow(missing_docs, reason = "the names are the document's")]
    pub const FUNCTION: u8 = 1;
    pub const VALUE: u8 = 3;
    pub const PARAMETERS: u8 = 9;
    pub const TIMEOUT: u8 = 11;
}

/// A request or an answer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Dialogue {
    /// MODBUS address of the device.
    pub address: u8,
    /// Function: 3 read holding registers, 4 read input registers, 16 write registers.
    pub function: u8,
    /// First register.
    pub register: u16,
    /// Number of registers.
    pub count: u16,
}

impl Dialogue {
    /// The request's packets; `data` are the registers to write.
    pub fn request(&self, data: &[u16]) -> Vec<CanFrame> {
        self.packets(device::MODBUS_REQ, 0, data)
    }

    /// The answer's packets: `result` 0 with the registers, or an error code (section 9, MBERR).
    pub fn answer(&self, result: u8, data: &[u16]) -> Vec<CanFrame> {
        self.packets(device::MODBUS_ANS, result, data)
    }

    /// What a good answer to a write carries: the register and the count.
    pub fn confirmation(&self) -> [u16; 2] {
        [self.register, self.count]
    }

    fn packets(&self, device: u8, result: u8, data: &[u16]) -> Vec<CanFrame> {
        let mut bytes = vec![0, result, self.address, self.function];
        for word in [self.register, self.count].iter().chain(data) {
            bytes.extend(word.to_le_bytes());
        }
        // One byte holds the length.
        bytes.truncate(HEADER + 2 * usize::from(MOST_REGISTERS));
        bytes[0] = u8::try_from(bytes.len()).unwrap_or(u8::MAX);
        (0..).zip(bytes.chunks(8)).map(|(number, part)| frame(device, 0, number, part)).collect()
    }
}

/// Puts a structure together from its packets.
#[derive(Clone, Debug, Default)]
pub struct Assembly {
    bytes: Vec<u8>,
    /// Number of the packet that comes next.
    next: u8,
}

impl Assembly {
    /// Takes packet `number`; the request and its registers when it is complete. Packet 0 begins a
    /// new structure; one that is missing or out of order makes the structure worth nothing.
    pub fn push(&mut self, number: u8, data: &[u8]) -> Option<(Dialogue, Vec<u16>)> {
        if number == 0 {
            self.bytes.clear();
        } else if number != self.next || self.bytes.is_empty() {
            *self = Self::default();
            return None;
        }
        self.bytes.extend(data);
        self.next = number.saturating_add(1);
        let (head, rest) = self.bytes.split_first_chunk::<HEADER>()?;
        let [length, _, address, function, ..] = *head;
        if usize::from(length) > self.bytes.len() {
            return None;
        }
        let whole = usize::from(length) == self.bytes.len();
        let word =
            |pair: &[u8]| pair.iter().rev().fold(0, |word, byte| word << 8 | u16::from(*byte));
        let dialogue =
            Dialogue { address, function, register: word(&head[4..6]), count: word(&head[6..8]) };
        let registers = rest.chunks(2).map(word).collect();
        *self = Self::default();
        whole.then_some((dialogue, registers))
    }
}

/// Holding registers of an inverter (address 1 or 2) from register 0 on: input voltage 0.01 V,
/// output voltage 0.1 V, power W, temperature 0.1 °C, mode, then zeros.
pub fn inverter_registers(station: &Station, address: u8, count: u16) -> Vec<u16> {
    let inverter = &station.inverters()[usize::from(address == 2)];
    let values = [
        station.battery().voltage() * 100.0,
        inverter.ac_voltage() * 10.0,
        inverter.watts(),
        inverter.temperature() * 10.0,
        f64::from(inverter.mode() as u8),
    ];
    let registers = values.into_iter().map(|x| x.round() as u16).chain(std::iter::repeat(0));
    registers.take(usize::from(count)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_answer_of_three_registers_is_cut_as_in_the_sample_vectors() {
        let dialogue = Dialogue { address: 3, function: 3, register: 32, count: 3 };
        let packets = dialogue.answer(0, &[20_053, 10_033, 39_609]);
        assert_eq!(packets[0].id, 0x0012_0000);
        assert_eq!(packets[0].data(), [0x0e, 0x00, 0x03, 0x03, 0x20, 0x00, 0x03, 0x00]);
        assert_eq!(packets[1].id, 0x0012_0001);
        assert_eq!(packets[1].data(), [0x55, 0x4e, 0x31, 0x27, 0xb9, 0x9a]);
        assert_eq!(packets.len(), 2);
    }

    #[test]
    fn a_request_is_a_header_only() {
        let dialogue = Dialogue { address: 1, function: 3, register: 0, count: 5 };
        let packets = dialogue.request(&[]);
        assert_eq!(packets.len(), 1);
        assert_eq!(packets[0].data(), [8, 0, 1, 3, 0, 0, 5, 0]);
    }
}
