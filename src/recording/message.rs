//! Messages that are not CAN frames: serial bytes, gaps, statistics, clock, log; both ways.

use prost::Message as _;

use super::schema::{bustape, foxglove};
use crate::frame::error::{CanError, Class};
use crate::frame::{
    Direction, Gap, GapReason, Level, LineError, LineErrorKind, Notice, SerialBytes, Timestamp,
    Unit,
};

/// Appends a `bustape.SerialBytes` message.
pub fn encode_serial(bytes: &SerialBytes, out: &mut Vec<u8>) {
    use bustape::serial_bytes::Direction as D;
    // Straight into the chunk: serial traffic can be as fast as CAN.
    let direction = match bytes.direction {
        Direction::Rx => D::Rx,
        Direction::Tx => D::Tx,
    };
    super::wire::put_uint(out, 1, u64::from(direction as u8));
    super::wire::put_bytes(out, 2, &bytes.data);
    for error in &bytes.errors {
        let error = bustape::serial_bytes::LineError {
            offset: error.offset,
            kind: line_error_kind(error.kind) as i32,
        };
        super::wire::put_message(out, 3, &error);
    }
}

/// Reads a `bustape.SerialBytes` message.
pub fn decode_serial(message: &[u8]) -> Option<SerialBytes> {
    use bustape::serial_bytes::Direction as D;
    let message = bustape::SerialBytes::decode(message).ok()?;
    let direction = match message.direction() {
        D::Tx => Direction::Tx,
        D::Rx | D::Unknown => Direction::Rx,
    };
    let errors = message.errors.iter().filter_map(|error| {
        let kind = line_error_of(error.kind())?;
        Some(LineError { offset: error.offset, kind })
    });
    Some(SerialBytes { direction, errors: errors.collect(), data: message.data })
}

fn line_error_kind(kind: LineErrorKind) -> bustape::serial_bytes::line_error::Kind {
    use bustape::serial_bytes::line_error::Kind as K;
    match kind {
        LineErrorKind::Parity => K::Parity,
        LineErrorKind::Framing => K::Framing,
        LineErrorKind::ParityOrFraming => K::ParityOrFraming,
        LineErrorKind::Break => K::Break,
        LineErrorKind::Overrun => K::Overrun,
    }
}

fn line_error_of(kind: bustape::serial_bytes::line_error::Kind) -> Option<LineErrorKind> {
    use bustape::serial_bytes::line_error::Kind as K;
    Some(match kind {
        K::Unknown => return None,
        K::Parity => LineErrorKind::Parity,
        K::Framing => LineErrorKind::Framing,
        K::ParityOrFraming => LineErrorKind::ParityOrFraming,
        K::Break => LineErrorKind::Break,
        K::Overrun => LineErrorKind::Overrun,
    })
}

/// A `bustape.CanError` message.
pub fn can_error(error: &CanError) -> bustape::CanError {
    let (controller, protocol) = (error.controller(), error.protocol());
    let counters = error.counters();
    bustape::CanError {
        text: error.to_string(),
        classes: error.classes,
        tx_timeout: error.is(Class::TxTimeout),
        lost_arbitration: error.is(Class::LostArbitration),
        controller: error.is(Class::Controller),
        protocol: error.is(Class::Protocol),
        transceiver: error.is(Class::Transceiver),
        no_ack: error.is(Class::NoAck),
        bus_off: error.is(Class::BusOff),
        bus_error: error.is(Class::BusError),
        restarted: error.is(Class::Restarted),
        arbitration_bit: error.arbitration_bit().map(u32::from),
        rx_overflow: controller & 0x01 != 0,
        tx_overflow: controller & 0x02 != 0,
        rx_warning: controller & 0x04 != 0,
        tx_warning: controller & 0x08 != 0,
        rx_passive: controller & 0x10 != 0,
        tx_passive: controller & 0x20 != 0,
        active: controller & 0x40 != 0,
        bit: protocol & 0x01 != 0,
        form: protocol & 0x02 != 0,
        stuff: protocol & 0x04 != 0,
        bit0: protocol & 0x08 != 0,
        bit1: protocol & 0x10 != 0,
        overload: protocol & 0x20 != 0,
        active_error: protocol & 0x40 != 0,
        on_transmission: protocol & 0x80 != 0,
        location: error.location().map(i32::from),
        wires: error.transceiver().map(u32::from),
        tx_errors: counters.map(|(tx, _)| tx.into()),
        rx_errors: counters.map(|(_, rx)| rx.into()),
    }
}

/// The classes of a `bustape.CanError` message, as bits.
pub fn decode_can_error(message: &[u8]) -> Option<u32> {
    bustape::CanError::decode(message).ok().map(|error| error.classes)
}

/// A `bustape.Gap` message.
pub fn gap(gap: &Gap) -> bustape::Gap {
    use bustape::gap as g;
    let unit = match gap.unit {
        Unit::Frames => g::Unit::Frames,
        Unit::Bytes => g::Unit::Bytes,
    };
    let reason = match gap.reason {
        GapReason::KernelQueue => g::Reason::KernelQueue,
        GapReason::RecorderQueue => g::Reason::RecorderQueue,
        GapReason::LinkDown => g::Reason::LinkDown,
        GapReason::Overrun => g::Reason::Overrun,
        GapReason::Adapter => g::Reason::Adapter,
        GapReason::Disk => g::Reason::Disk,
        GapReason::WindowMemory => g::Reason::WindowMemory,
    };
    bustape::Gap {
        count: gap.count,
        unit: unit as i32,
        reason: reason as i32,
        from_ns: gap.from.nanos(),
        to_ns: gap.to.nanos(),
    }
}

/// Reads a `bustape.Gap` message. A reason or unit from a later version is not understood.
pub fn decode_gap(message: &[u8]) -> Option<Gap> {
    use bustape::gap as g;
    let message = bustape::Gap::decode(message).ok()?;
    let unit = match message.unit() {
        g::Unit::Unknown => return None,
        g::Unit::Frames => Unit::Frames,
        g::Unit::Bytes => Unit::Bytes,
    };
    let reason = match message.reason() {
        g::Reason::Unknown => return None,
        g::Reason::KernelQueue => GapReason::KernelQueue,
        g::Reason::RecorderQueue => GapReason::RecorderQueue,
        g::Reason::LinkDown => GapReason::LinkDown,
        g::Reason::Overrun => GapReason::Overrun,
        g::Reason::Adapter => GapReason::Adapter,
        g::Reason::Disk => GapReason::Disk,
        g::Reason::WindowMemory => GapReason::WindowMemory,
    };
    let (from, to) = (Timestamp(message.from_ns), Timestamp(message.to_ns));
    Some(Gap { count: message.count, unit, reason, from, to })
}

/// A `foxglove.Log` message about `bus`.
pub fn log(time: Timestamp, bus: &str, notice: &Notice) -> foxglove::Log {
    use foxglove::log::Level as L;
    let level = match notice.level {
        Level::Info => L::Info,
        Level::Warning => L::Warning,
        Level::Error => L::Error,
    };
    let seconds = i64::try_from(time.nanos() / 1_000_000_000).unwrap_or(i64::MAX);
    let nanos = i32::try_from(time.nanos() % 1_000_000_000).unwrap_or(0);
    foxglove::Log {
        timestamp: Some(prost_types::Timestamp { seconds, nanos }),
        level: level as i32,
        message: notice.text.clone(),
        name: bus.to_owned(),
        file: String::new(),
        line: 0,
    }
}

/// Reads a `foxglove.Log` message: the bus it is about, and the notice.
pub fn decode_log(message: &[u8]) -> Option<(String, Notice)> {
    use foxglove::log::Level as L;
    let message = foxglove::Log::decode(message).ok()?;
    let level = match message.level() {
        L::Unknown | L::Debug | L::Info => Level::Info,
        L::Warning => Level::Warning,
        L::Error | L::Fatal => Level::Error,
    };
    Some((message.name, Notice { level, text: message.message }))
}
