//! Packets out of the blocks of pcapng, or the records of pcap.

use std::io::{self, BufReader, ErrorKind, Read};

use super::interface::{self, Interface};
use crate::import::ImportError;

/// Larger than any packet with a CAN frame, or than what a serial line gives at once.
const MAX_BLOCK: u32 = 16 << 20;
/// Interfaces of one section: more are no capture of field buses.
const MAX_INTERFACES: usize = 4096;

const SECTION: u32 = 0x0A0D_0D0A;
const INTERFACE: u32 = 1;
const OLD_PACKET: u32 = 2;
const SIMPLE_PACKET: u32 = 3;
const ENHANCED_PACKET: u32 = 6;
const BYTE_ORDER: u32 = 0x1A2B_3C4D;

/// A packet; its bytes are given apart.
#[derive(Clone, Copy, Debug)]
pub struct Packet {
    /// Number of its interface in its section.
    pub interface: u32,
    /// Nanoseconds since 1970.
    pub nanos: u64,
    /// It went out from the machine that captured it, as far as the file says.
    pub sent: bool,
    /// Where it begins in the file.
    pub at: u64,
    /// Fewer bytes were captured than there were.
    pub cut: bool,
    /// Its block says no time.
    pub timeless: bool,
}

/// True for the first bytes of either format.
pub fn recognises(head: &[u8]) -> bool {
    Form::of(head).is_some()
}

/// Which of the formats.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Form {
    /// Its records have 16 bytes of head; nanoseconds instead of microseconds.
    Pcap {
        nanos: bool,
    },
    Pcapng,
}

impl Form {
    /// The form and whether numbers are big endian.
    fn of(head: &[u8]) -> Option<(Self, bool)> {
        let magic = [*head.first()?, *head.get(1)?, *head.get(2)?, *head.get(3)?];
        match magic {
            [0xA1, 0xB2, 0xC3, 0xD4] => Some((Self::Pcap { nanos: false }, true)),
            [0xD4, 0xC3, 0xB2, 0xA1] => Some((Self::Pcap { nanos: false }, false)),
            [0xA1, 0xB2, 0x3C, 0x4D] => Some((Self::Pcap { nanos: true }, true)),
            [0x4D, 0x3C, 0xB2, 0xA1] => Some((Self::Pcap { nanos: true }, false)),
            [0x0A, 0x0D, 0x0D, 0x0A] => Some((Self::Pcapng, false)),
            _ => None,
        }
    }
}

/// Gives one packet after another.
pub struct Blocks {
    input: BufReader<Box<dyn Read>>,
    form: Form,
    big: bool,
    at: u64,
    interfaces: Vec<Interface>,
}

impl Blocks {
    /// Reads the head of the file.
    pub fn open(input: Box<dyn Read>) -> Result<Self, ImportError> {
        let mut input = BufReader::with_capacity(256 << 10, input);
        let head = {
            use io::BufRead as _;
            input.fill_buf()?
        };
        let no = || ImportError::Format("it is neither pcap nor pcapng".to_owned());
        let (form, big) = Form::of(head).ok_or_else(no)?;
        let mut blocks = Self { input, form, big, at: 0, interfaces: Vec::new() };
        if let Form::Pcap { nanos } = form {
            let mut head = [0; 24];
            blocks.read(&mut head).map_err(|_| no())?;
            // The upper bits tell of a frame check sequence.
            let link = blocks.u32(&head, 20) & 0x0FFF_FFFF;
            blocks.interfaces.push(Interface::plain(link, nanos));
        }
        Ok(blocks)
    }

    /// Bytes read so far.
    pub fn position(&self) -> u64 {
        self.at
    }

    /// Numbers are written with the highest byte first.
    pub fn big_endian(&self) -> bool {
        self.big
    }

    /// An interface of the current section.
    pub fn interface(&self, number: u32) -> Option<&Interface> {
        self.interfaces.get(usize::try_from(number).ok()?)
    }

    /// The next packet; its bytes are put into `data`.
    pub fn next(&mut self, data: &mut Vec<u8>) -> io::Result<Option<Packet>> {
        match self.form {
            Form::Pcap { .. } => self.next_record(data),
            Form::Pcapng => self.next_block(data),
        }
    }

    fn next_record(&mut self, data: &mut Vec<u8>) -> io::Result<Option<Packet>> {
        let at = self.at;
        let mut head = [0; 16];
        if !self.read_or_end(&mut head)? {
            return Ok(None);
        }
        let length = self.u32(&head, 8);
        check_length(length)?;
        self.read_into(data, length as usize)?;
        let fraction = u64::from(self.u32(&head, 4));
        let scale = if self.form == (Form::Pcap { nanos: true }) { 1 } else { 1000 };
        let nanos = u64::from(self.u32(&head, 0)) * 1_000_000_000 + fraction * scale;
        let cut = length < self.u32(&head, 12);
        Ok(Some(Packet { interface: 0, nanos, sent: false, at, cut, timeless: false }))
    }

    fn next_block(&mut self, data: &mut Vec<u8>) -> io::Result<Option<Packet>> {
        loop {
            let at = self.at;
            let mut head = [0; 8];
            if !self.read_or_end(&mut head)? {
                return Ok(None);
            }
            let kind = self.u32(&head, 0);
            let mut taken = 8;
            if kind == SECTION {
                let mut order = [0; 4];
                self.read(&mut order)?;
                taken += 4;
                self.big = match (u32::from_be_bytes(order), u32::from_le_bytes(order)) {
                    (BYTE_ORDER, _) => true,
                    (_, BYTE_ORDER) => false,
                    _ => return Err(damaged("a section without its byte order")),
                };
                self.interfaces.clear();
            }
            let length = self.u32(&head, 4);
            check_length(length)?;
            let Some(rest) = (length as usize).checked_sub(taken + 4) else {
                return Err(damaged("a block that is shorter than its head"));
            };
            self.read_into(data, rest.next_multiple_of(4))?;
            let mut trailer = [0; 4];
            self.read(&mut trailer)?;
            if self.u32(&trailer, 0) != length {
                return Err(damaged("a block whose two lengths differ"));
            }
            match kind {
                INTERFACE => self.take_interface(data)?,
                ENHANCED_PACKET | OLD_PACKET => return self.enhanced(data, kind, at).map(Some),
                SIMPLE_PACKET => {
                    let length = self.field(data, 0)? as usize;
                    let captured = length.min(data.len() - 4);
                    data.truncate(4 + captured);
                    data.drain(..4);
                    let cut = captured < length;
                    let (interface, nanos, sent, timeless) = (0, 0, false, true);
                    return Ok(Some(Packet { interface, nanos, sent, at, cut, timeless }));
                }
                _ => {}
            }
        }
    }

    /// An enhanced packet block, or the packet block it has replaced.
    fn enhanced(&self, data: &mut Vec<u8>, kind: u32, at: u64) -> io::Result<Packet> {
        let number = self.field(data, 0)?;
        let number = match kind {
            // 16 bits, then a count of drops.
            OLD_PACKET if self.big => number >> 16,
            OLD_PACKET => number & 0xFFFF,
            _ => number,
        };
        let units = u64::from(self.field(data, 4)?) << 32 | u64::from(self.field(data, 8)?);
        let (captured, length) = (self.field(data, 12)? as usize, self.field(data, 16)?);
        let Some(options) = data.get(20 + captured..) else {
            return Err(damaged("a packet that is longer than its block"));
        };
        let options = options.get(captured.next_multiple_of(4) - captured..).unwrap_or_default();
        let mut sent = false;
        interface::options(options, self.big, |code, value| {
            if let (2, [_, _, _, _]) = (code, value) {
                sent = self.u32(value, 0) & 3 == 2;
            }
        });
        let nanos = self.interface(number).map_or(0, |interface| interface.nanos(units));
        data.truncate(20 + captured);
        data.drain(..20);
        Ok(Packet {
            interface: number,
            nanos,
            sent,
            at,
            cut: (captured as u64) < u64::from(length),
            timeless: false,
        })
    }

    fn take_interface(&mut self, data: &[u8]) -> io::Result<()> {
        if self.interfaces.len() == MAX_INTERFACES {
            return Err(damaged("more interfaces than a capture has"));
        }
        let link = self.field(data, 0)?;
        let link = if self.big { link >> 16 } else { link & 0xFFFF };
        self.interfaces.push(Interface::of(link, data.get(8..).unwrap_or_default(), self.big));
        Ok(())
    }

    /// A number inside a block.
    fn field(&self, data: &[u8], at: usize) -> io::Result<u32> {
        if data.len() < at + 4 {
            return Err(damaged("a block that is shorter than its fields"));
        }
        Ok(self.u32(data, at))
    }

    fn u32(&self, bytes: &[u8], at: usize) -> u32 {
        interface::u32_at(bytes, at, self.big)
    }

    fn read(&mut self, into: &mut [u8]) -> io::Result<()> {
        self.input.read_exact(into)?;
        self.at += into.len() as u64;
        Ok(())
    }

    /// `false` where the file ends as it should.
    fn read_or_end(&mut self, into: &mut [u8]) -> io::Result<bool> {
        use io::BufRead as _;
        if self.input.fill_buf()?.is_empty() {
            return Ok(false);
        }
        self.read(into).map(|()| true)
    }

    fn read_into(&mut self, data: &mut Vec<u8>, length: usize) -> io::Result<()> {
        data.clear();
        // As the bytes come: a length may lie.
        let read = self.input.by_ref().take(length as u64).read_to_end(data)?;
        self.at += read as u64;
        if read < length {
            return Err(ErrorKind::UnexpectedEof.into());
        }
        Ok(())
    }
}

fn check_length(length: u32) -> io::Result<()> {
    if length > MAX_BLOCK {
        return Err(damaged(&format!("a length of {length} bytes")));
    }
    Ok(())
}

fn damaged(what: &str) -> io::Error {
    io::Error::new(ErrorKind::InvalidData, format!("the file is damaged: {what}"))
}
