//! What CAN error frames say, by class.
//!
//! Source: `linux/can/error.h`: the identifier holds the classes, the 8 data bytes their details.

use std::fmt;

use super::{CanFlags, CanFrame};

/// A class of errors, one bit of an error frame's identifier.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Class {
    /// The driver's transmission timed out.
    TxTimeout,
    /// Arbitration was lost.
    LostArbitration,
    /// The controller's state or buffers.
    Controller,
    /// A violation of the protocol.
    Protocol,
    /// The transceiver, or the wires.
    Transceiver,
    /// A transmission was not acknowledged.
    NoAck,
    /// The controller has left the bus.
    BusOff,
    /// An error on the bus, of which there may be very many.
    BusError,
    /// The controller takes part again.
    Restarted,
}

/// Every class, its bit and its name.
pub const CLASSES: [(Class, u32, &str); 9] = [
    (Class::TxTimeout, 0x001, "tx-timeout"),
    (Class::LostArbitration, 0x002, "lost-arbitration"),
    (Class::Controller, 0x004, "controller"),
    (Class::Protocol, 0x008, "protocol"),
    (Class::Transceiver, 0x010, "transceiver"),
    (Class::NoAck, 0x020, "no-ack"),
    (Class::BusOff, 0x040, "bus-off"),
    (Class::BusError, 0x080, "bus-error"),
    (Class::Restarted, 0x100, "restarted"),
];

/// The counters in data bytes 6 and 7 are set.
const COUNTERS: u32 = 0x200;

/// What [`Class::Controller`] is about, one bit of data byte 1 each.
pub const CONTROLLER: [(u8, &str); 7] = [
    (0x01, "rx-overflow"),
    (0x02, "tx-overflow"),
    (0x04, "rx-warning"),
    (0x08, "tx-warning"),
    (0x10, "rx-passive"),
    (0x20, "tx-passive"),
    (0x40, "active"),
];

/// What [`Class::Protocol`] is about, one bit of data byte 2 each.
pub const PROTOCOL: [(u8, &str); 8] = [
    (0x01, "bit"),
    (0x02, "form"),
    (0x04, "stuff"),
    (0x08, "bit0"),
    (0x10, "bit1"),
    (0x20, "overload"),
    (0x40, "active-error"),
    (0x80, "on-transmission"),
];

/// Where in a frame a violation was, data byte 3.
const LOCATIONS: [(u8, &str); 19] = [
    (0x02, "identifier bits 28 to 21"),
    (0x03, "start of frame"),
    (0x04, "substitute RTR"),
    (0x05, "identifier extension"),
    (0x06, "identifier bits 20 to 18"),
    (0x07, "identifier bits 17 to 13"),
    (0x08, "CRC sequence"),
    (0x09, "reserved bit 0"),
    (0x0A, "data"),
    (0x0B, "data length code"),
    (0x0C, "RTR"),
    (0x0D, "reserved bit 1"),
    (0x0E, "identifier bits 4 to 0"),
    (0x0F, "identifier bits 12 to 5"),
    (0x12, "intermission"),
    (0x18, "CRC delimiter"),
    (0x19, "ACK slot"),
    (0x1A, "end of frame"),
    (0x1B, "ACK delimiter"),
];

/// What data byte 4 says of the wires.
const WIRES: [(u8, &str); 9] = [
    (0x04, "CANH has no wire"),
    (0x05, "CANH is shorted to the battery"),
    (0x06, "CANH is shorted to the supply"),
    (0x07, "CANH is shorted to ground"),
    (0x40, "CANL has no wire"),
    (0x50, "CANL is shorted to the battery"),
    (0x60, "CANL is shorted to the supply"),
    (0x70, "CANL is shorted to ground"),
    (0x80, "CANL is shorted to CANH"),
];

/// What a controller may do on its bus, by its error counters (ISO 11898-1, fault confinement).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum BusState {
    /// It takes part; counters below 96.
    Active,
    /// A counter has reached 96.
    Warning,
    /// A counter has reached 128: it may not interrupt others any more.
    Passive,
    /// The transmit counter has passed 255: it neither sends nor hears.
    BusOff,
}

impl fmt::Display for BusState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Active => "error active",
            Self::Warning => "error active, with an error counter at the warning level",
            Self::Passive => "error passive",
            Self::BusOff => "bus-off",
        })
    }
}

/// An error frame, taken apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CanError {
    /// The classes as bits.
    pub classes: u32,
    data: [u8; 8],
}

impl CanError {
    /// Takes an error frame apart; `None` of any other frame.
    pub fn of(frame: &CanFrame) -> Option<Self> {
        if !frame.flags.has(CanFlags::ERROR) {
            return None;
        }
        let mut data = [0; 8];
        for (to, from) in data.iter_mut().zip(frame.data()) {
            *to = *from;
        }
        Some(Self { classes: frame.id, data })
    }

    /// True if it is of this class.
    pub fn is(&self, class: Class) -> bool {
        CLASSES.iter().any(|(known, bit, _)| *known == class && self.classes & bit != 0)
    }

    /// The names of its classes.
    pub fn class_names(&self) -> impl Iterator<Item = &'static str> + use<> {
        let classes = self.classes;
        CLASSES.iter().filter(move |(_, bit, _)| classes & bit != 0).map(|(_, _, name)| *name)
    }

    /// At which bit arbitration was lost, if it was and that is known.
    pub fn arbitration_bit(&self) -> Option<u8> {
        Some(self.data[0]).filter(|bit| *bit != 0 && self.is(Class::LostArbitration))
    }

    /// The bits of [`CONTROLLER`]; 0 for other classes.
    pub fn controller(&self) -> u8 {
        if self.is(Class::Controller) { self.data[1] } else { 0 }
    }

    /// The bits of [`PROTOCOL`]; 0 for other classes.
    pub fn protocol(&self) -> u8 {
        if self.is(Class::Protocol) { self.data[2] } else { 0 }
    }

    /// Where in a frame a violation was, if that is known: the number of `linux/can/error.h`.
    pub fn location(&self) -> Option<u8> {
        Some(self.data[3]).filter(|place| *place != 0 && self.is(Class::Protocol))
    }

    /// What the transceiver says of the wires, if it does: the number of `linux/can/error.h`.
    pub fn transceiver(&self) -> Option<u8> {
        Some(self.data[4]).filter(|wires| *wires != 0 && self.is(Class::Transceiver))
    }

    /// The counters of errors in transmitting and receiving, if the frame has them.
    pub fn counters(&self) -> Option<(u8, u8)> {
        (self.classes & COUNTERS != 0).then_some((self.data[6], self.data[7]))
    }

    /// The state that the controller is in now, if the frame is about that.
    pub fn state(&self) -> Option<BusState> {
        let controller = self.controller();
        if self.is(Class::BusOff) {
            Some(BusState::BusOff)
        } else if controller & 0x30 != 0 {
            Some(BusState::Passive)
        } else if controller & 0x0C != 0 {
            Some(BusState::Warning)
        } else if controller & 0x40 != 0 || self.is(Class::Restarted) {
            Some(BusState::Active)
        } else {
            None
        }
    }

    /// True if `name` is one of its classes, or one of the details that have a name.
    pub fn is_called(&self, name: &str) -> bool {
        self.class_names().any(|class| class == name)
            || CONTROLLER.iter().any(|(bit, known)| self.controller() & bit != 0 && *known == name)
            || PROTOCOL.iter().any(|(bit, known)| self.protocol() & bit != 0 && *known == name)
    }
}

/// Every name that [`CanError::is_called`] knows.
pub fn names() -> impl Iterator<Item = &'static str> {
    let classes = CLASSES.iter().map(|(_, _, name)| *name);
    let details = CONTROLLER.iter().chain(&PROTOCOL).map(|(_, name)| *name);
    classes.chain(details)
}

impl fmt::Display for CanError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut parts = Vec::new();
        for name in self.class_names() {
            let details = match name {
                "lost-arbitration" => self.arbitration_bit().map(|bit| format!("at bit {bit}")),
                "controller" => listed(self.controller(), &CONTROLLER),
                "protocol" => {
                    let kinds = listed(self.protocol(), &PROTOCOL);
                    let place = self.location().map(|place| match named(place, &LOCATIONS) {
                        Some(name) => format!("in {name}"),
                        None => format!("at location {place:02X}"),
                    });
                    let all: Vec<String> = kinds.into_iter().chain(place).collect();
                    Some(all.join(" ")).filter(|text| !text.is_empty())
                }
                "transceiver" => self.transceiver().map(|wires| match named(wires, &WIRES) {
                    Some(name) => name.to_owned(),
                    None => format!("status {wires:02X}"),
                }),
                _ => None,
            };
            parts.push(match details {
                Some(details) => format!("{name} ({details})"),
                None => name.to_owned(),
            });
        }
        if let Some((tx, rx)) = self.counters() {
            parts.push(format!("error counters tx {tx}, rx {rx}"));
        }
        if parts.is_empty() {
            return write!(f, "error of an unknown class, {:08X}", self.classes);
        }
        f.write_str(&parts.join("; "))
    }
}

fn listed(bits: u8, known: &[(u8, &str)]) -> Option<String> {
    let names: Vec<&str> =
        known.iter().filter(|(bit, _)| bits & bit != 0).map(|(_, name)| *name).collect();
    (!names.is_empty()).then(|| names.join(", "))
}

fn named(number: u8, known: &[(u8, &'static str)]) -> Option<&'static str> {
    known.iter().find(|(of, _)| *of == number).map(|(_, name)| *name)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(classes: u32, data: [u8; 8]) -> CanError {
        CanError::of(&CanFrame::new(classes, CanFlags::ERROR, &data)).unwrap()
    }

    #[test]
    fn the_bits_are_those_of_the_kernel() {
        let kernel = [
            libc::CAN_ERR_TX_TIMEOUT,
            libc::CAN_ERR_LOSTARB,
            libc::CAN_ERR_CRTL,
            libc::CAN_ERR_PROT,
            libc::CAN_ERR_TRX,
            libc::CAN_ERR_ACK,
            libc::CAN_ERR_BUSOFF,
            libc::CAN_ERR_BUSERROR,
            libc::CAN_ERR_RESTARTED,
        ];
        assert_eq!(CLASSES.map(|(_, bit, _)| i64::from(bit)), kernel.map(i64::from));
    }

    #[test]
    fn an_error_frame_is_a_sentence() {
        let text = |classes, data| error(classes, data).to_string();
        assert_eq!(text(0x2, [7, 0, 0, 0, 0, 0, 0, 0]), "lost-arbitration (at bit 7)");
        assert_eq!(
            text(0x204, [0, 0x30, 0, 0, 0, 0, 128, 130]),
            "controller (rx-passive, tx-passive); error counters tx 128, rx 130"
        );
        assert_eq!(
            text(0x88, [0, 0, 0x84, 0x0A, 0, 0, 0, 0]),
            "protocol (stuff, on-transmission in data); bus-error"
        );
        assert_eq!(
            text(0x10, [0, 0, 0, 0, 5, 0, 0, 0]),
            "transceiver (CANH is shorted to the battery)"
        );
        assert_eq!(text(0x40, [0; 8]), "bus-off");
        assert_eq!(text(0x400, [0; 8]), "error of an unknown class, 00000400");
    }

    #[test]
    fn the_state_follows_from_what_the_controller_says() {
        let state = |classes, byte| error(classes, [0, byte, 0, 0, 0, 0, 0, 0]).state();
        assert_eq!(state(0x4, 0x08), Some(BusState::Warning));
        assert_eq!(state(0x4, 0x28), Some(BusState::Passive));
        assert_eq!(state(0x4, 0x40), Some(BusState::Active));
        assert_eq!(state(0x40, 0), Some(BusState::BusOff));
        assert_eq!(state(0x100, 0), Some(BusState::Active));
        // An overflow, or a bus error, says nothing about that; nor does a byte of another class.
        assert_eq!(state(0x4, 0x01), None);
        assert_eq!(state(0x80, 0x20), None);
    }
}
