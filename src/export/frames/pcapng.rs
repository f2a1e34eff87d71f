//! pcapng (draft-ietf-opsawg-pcapng): an interface for each bus that has frames, nanoseconds, the
//! direction. What kind of bus it is, its first frame tells: of a log nobody knows it before.
//!
//! CAN as LINKTYPE_CAN_SOCKETCAN (227), serial lines as LINKTYPE_RTAC_SERIAL (250), the link type
//! that tcpdump.org registers for them and Wireshark shows.

use std::collections::BTreeMap;
use std::io::{self, Write};

use super::super::{BusHead, FrameWriter};
use super::kept::Unkept;
use crate::frame::{CanFlags, CanFrame, Direction, Frame, SerialBytes, Stamped};

const SOCKETCAN: u16 = 227;
const RTAC_SERIAL: u16 = 250;
const SECTION: u32 = 0x0A0D_0D0A;
const INTERFACE: u32 = 1;
const ENHANCED_PACKET: u32 = 6;
const FDF: u8 = 0x04;

/// Starts a capture.
pub fn create<W: Write>(out: W, buses: &[BusHead]) -> io::Result<impl FrameWriter + use<W>> {
    let mut capture = Pcapng {
        out,
        buses: Vec::new(),
        interfaces: 0,
        block: Vec::new(),
        packet: Vec::new(),
        unkept: Unkept::default(),
    };
    // Byte order, version 1.0, a length that is not known; who wrote it.
    let mut section = [0x1A2B_3C4D, 1].map(u32::to_le_bytes).concat();
    section.extend_from_slice(&[0xFF; 8]);
    option(&mut section, 4, concat!("bustape ", env!("CARGO_PKG_VERSION")).as_bytes());
    section.extend_from_slice(&[0; 4]);
    capture.put(SECTION, &section)?;
    for bus in buses {
        capture.add_bus(bus)?;
    }
    Ok(capture)
}

struct Pcapng<W> {
    out: W,
    buses: Vec<Bus>,
    interfaces: u32,
    block: Vec<u8>,
    packet: Vec<u8>,
    unkept: Unkept,
}

/// A bus and the numbers of its interfaces. Logs that give one name to a CAN bus and to a serial line
/// make two of one name.
struct Bus {
    head: BusHead,
    can: Option<u32>,
    serial: Option<u32>,
}

impl<W: Write> FrameWriter for Pcapng<W> {
    fn add_bus(&mut self, bus: &BusHead) -> io::Result<()> {
        self.buses.push(Bus { head: bus.clone(), can: None, serial: None });
        Ok(())
    }

    fn write(&mut self, bus: u16, frame: &Stamped<Frame>) -> io::Result<()> {
        self.packet.clear();
        let (link, sent) = match &frame.value {
            Frame::Can(can) => {
                socketcan(&mut self.packet, can);
                (SOCKETCAN, can.flags.has(CanFlags::TX))
            }
            Frame::Serial(bytes) => {
                if !bytes.errors.is_empty() {
                    self.unkept.add("line errors");
                }
                rtac(&mut self.packet, bytes, frame.time.nanos());
                (RTAC_SERIAL, bytes.direction == Direction::Tx)
            }
            _ => {
                self.unkept.frame(&frame.value);
                return Ok(());
            }
        };
        let Some(interface) = self.interface(bus, link)? else { return Ok(()) };
        let nanos = frame.time.nanos();
        #[allow(clippy::cast_possible_truncation, reason = "halves; a read is far below 4 GiB")]
        let words = [
            interface,
            (nanos >> 32) as u32,
            nanos as u32,
            self.packet.len() as u32,
            self.packet.len() as u32,
        ];
        let mut block = std::mem::take(&mut self.block);
        block.clear();
        for word in words {
            block.extend_from_slice(&word.to_le_bytes());
        }
        block.extend_from_slice(&self.packet);
        block.resize(block.len().next_multiple_of(4), 0);
        // Inbound or outbound.
        option(&mut block, 2, &(if sent { 2u32 } else { 1 }).to_le_bytes());
        block.extend_from_slice(&[0; 4]);
        let put = self.put(ENHANCED_PACKET, &block);
        self.block = block;
        put
    }

    fn finish(&mut self) -> io::Result<()> {
        self.out.flush()
    }

    fn unkept(&self) -> &BTreeMap<&'static str, u64> {
        self.unkept.list()
    }
}

impl<W: Write> Pcapng<W> {
    /// The number of a bus's interface of this link type, which is described before its first packet.
    fn interface(&mut self, bus: u16, link: u16) -> io::Result<Option<u32>> {
        let Some(Bus { head, can, serial }) = self.buses.get_mut(usize::from(bus)) else {
            return Ok(None);
        };
        let number = if link == RTAC_SERIAL { serial } else { can };
        if number.is_some() {
            return Ok(*number);
        }
        *number = Some(self.interfaces);
        let given = *number;
        self.interfaces += 1;
        let mut body = [link, 0, 0, 0].map(u16::to_le_bytes).concat();
        option(&mut body, 2, head.name.as_bytes());
        if let Some(rate) = head.bitrate {
            option(&mut body, 8, &u64::from(rate).to_le_bytes());
        }
        // Times are nanoseconds.
        option(&mut body, 9, &[9]);
        body.extend_from_slice(&[0; 4]);
        self.put(INTERFACE, &body)?;
        Ok(given)
    }

    fn put(&mut self, kind: u32, body: &[u8]) -> io::Result<()> {
        #[allow(clippy::cast_possible_truncation, reason = "far below 4 GiB")]
        let length = (12 + body.len() as u32).to_le_bytes();
        self.out.write_all(&kind.to_le_bytes())?;
        self.out.write_all(&length)?;
        self.out.write_all(body)?;
        self.out.write_all(&length)
    }
}

/// An option, filled up to whole words.
fn option(out: &mut Vec<u8>, code: u16, value: &[u8]) {
    let value = &value[..value.len().min(usize::from(u16::MAX))];
    #[allow(clippy::cast_possible_truncation, reason = "cut above")]
    let length = value.len() as u16;
    out.extend_from_slice(&code.to_le_bytes());
    out.extend_from_slice(&length.to_le_bytes());
    out.extend_from_slice(value);
    out.resize(out.len().next_multiple_of(4), 0);
}

/// `struct can_frame` or `struct canfd_frame` of `linux/can.h`, the identifier big endian.
fn socketcan(out: &mut Vec<u8>, frame: &CanFrame) {
    let has = |flag| frame.flags.has(flag);
    let flag = |set, bit: u32| if set { bit } else { 0 };
    let word = frame.id
        | flag(has(CanFlags::EXTENDED), 0x8000_0000)
        | flag(has(CanFlags::REMOTE), 0x4000_0000)
        | flag(has(CanFlags::ERROR), 0x2000_0000);
    out.extend_from_slice(&word.to_be_bytes());
    let fd = has(CanFlags::FD);
    #[allow(clippy::cast_possible_truncation, reason = "at most 64")]
    let length = if has(CanFlags::REMOTE) { frame.dlc.min(8) } else { frame.data().len() as u8 };
    let fd_flags =
        if fd { FDF | u8::from(has(CanFlags::BRS)) | u8::from(has(CanFlags::ESI)) << 1 } else { 0 };
    let raw_dlc = if !fd && frame.dlc > 8 { frame.dlc } else { 0 };
    out.extend_from_slice(&[length, fd_flags, 0, raw_dlc]);
    out.extend_from_slice(frame.data());
}

/// The head of LINKTYPE_RTAC_SERIAL: time, event (1 sent, 2 received), state of the control lines
/// (not known), a reserved footer.
fn rtac(out: &mut Vec<u8>, bytes: &SerialBytes, nanos: u64) {
    let seconds = u32::try_from(nanos / 1_000_000_000).unwrap_or(u32::MAX);
    #[allow(clippy::cast_possible_truncation, reason = "below a million")]
    let micros = (nanos % 1_000_000_000 / 1000) as u32;
    out.extend_from_slice(&seconds.to_be_bytes());
    out.extend_from_slice(&micros.to_be_bytes());
    out.extend_from_slice(&[if bytes.direction == Direction::Tx { 1 } else { 2 }, 0, 0, 0]);
    out.extend_from_slice(&bytes.data);
}
