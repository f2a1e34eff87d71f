//! What the controller reports at once: identifier `0x0014pp00` with the device in `pp`, one byte
//! with the number of the message (HMI CAN protocol, sections 4.4 and 9, EVENT).

use super::device;
use crate::frame::CanFrame;
use crate::simulate::station::Event;

/// The frame that reports `event`.
pub fn frame(event: Event) -> CanFrame {
    let (device, message) = place(event);
    match message {
        Some(number) => super::frame(device::LOG, device, 0, &[number]),
        // The event of the generator has no data.
        None => super::frame(device::LOG, device, 0, &[]),
    }
}

/// Device and number of the message.
fn place(event: Event) -> (u8, Option<u8>) {
    let (device, message) = match event {
        Event::LoadOnMains => (device::ALT, 0),
        Event::LoadOnInverters => (device::ALT, 1),
        Event::MainsRestored => (device::ALT, 2),
        Event::MainsLost => (device::ALT, 3),
        Event::BatteryLowMains => (device::ALT, 4),
        Event::BatteryLowGeneratorStarts => (device::ALT, 6),
        Event::ChargingFromMains => (device::CHARGER, 7),
        Event::ChargingFromGenerator => (device::CHARGER, 8),
        Event::PanelsConnected => (device::PV, 9),
        Event::PanelsDisconnected => (device::PV, 10),
        Event::ActuatorsOn => (device::TRACKER, 15),
        Event::ActuatorsOff => (device::TRACKER, 16),
        Event::ChargeOn => (device::CHARGER, 19),
        Event::ChargeOff => (device::CHARGER, 20),
        Event::ChargeFinished => (device::CHARGER, 23),
        Event::Small(step) => (device::INV1, [28, 32, 29, 38][usize::from(step & 3)]),
        Event::Large(step) => (device::INV2, [30, 33, 31, 39][usize::from(step & 3)]),
        Event::Generator => return (device::GEN, None),
    };
    (device, Some(message))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn events_carry_their_device_and_number() {
        let lost = frame(Event::MainsLost);
        assert_eq!((lost.id, lost.data()), (0x0014_0900, &[3][..]));
        let off = frame(Event::Large(3));
        assert_eq!((off.id, off.data()), (0x0014_0800, &[39][..]));
        let generator = frame(Event::Generator);
        assert_eq!((generator.id, generator.data()), (0x0014_0A00, &[][..]));
    }
}
