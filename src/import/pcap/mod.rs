//! pcap and pcapng with CAN frames of SocketCAN or bytes of serial lines (IETF drafts
//! draft-ietf-opsawg-pcap and draft-ietf-opsawg-pcapng; link types at tcpdump.org/linktypes).

mod block;
mod interface;
mod packet;

use std::collections::BTreeMap;
use std::io::{ErrorKind, Read};

use super::names::Names;
use super::{ImportError, LogFrame, LogReader, Skipped};
use crate::frame::{Stamped, Timestamp};
use block::{Blocks, Packet};
use interface::Interface;

/// Most packets given at once, and bytes of packets.
const BATCH: usize = 4096;
const BATCH_BYTES: usize = 8 << 20;

pub use block::recognises;

/// Reads a log.
pub struct Reader {
    blocks: Blocks,
    names: Names,
    skipped: Skipped,
    notes: Vec<String>,
    /// Packets of link types that are not taken, by number.
    foreign: BTreeMap<u32, u64>,
    /// Frames of blocks that say no time.
    timeless: u64,
    data: Vec<u8>,
}

/// A log.
pub fn open(input: Box<dyn Read>) -> Result<Reader, ImportError> {
    Ok(Reader {
        blocks: Blocks::open(input)?,
        names: Names::default(),
        skipped: Skipped::default(),
        notes: Vec::new(),
        foreign: BTreeMap::new(),
        timeless: 0,
        data: Vec::new(),
    })
}

impl LogReader for Reader {
    fn read(&mut self, into: &mut Vec<LogFrame>) -> Result<bool, ImportError> {
        let enough = into.len() + BATCH;
        let mut bytes = 0;
        while into.len() < enough && bytes < BATCH_BYTES {
            let at = self.blocks.position();
            match self.blocks.next(&mut self.data) {
                Ok(Some(packet)) => {
                    self.take(&packet, into);
                    bytes += self.data.len();
                }
                Ok(None) => return Ok(self.finish()),
                Err(error) if error.kind() == ErrorKind::UnexpectedEof => {
                    self.skipped.add(
                        || format!("byte {at}"),
                        || "the file ends inside a packet".to_owned(),
                    );
                    return Ok(self.finish());
                }
                Err(error) if error.kind() == ErrorKind::InvalidData => {
                    self.skipped.add(
                        || format!("byte {at}"),
                        || format!("{error}; what follows cannot be read"),
                    );
                    return Ok(self.finish());
                }
                Err(error) => return Err(error.into()),
            }
        }
        Ok(true)
    }

    fn buses(&self) -> &[String] {
        self.names.list()
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }
}

impl Reader {
    fn take(&mut self, packet: &Packet, into: &mut Vec<LogFrame>) {
        let Some(interface) = self.blocks.interface(packet.interface) else {
            let number = packet.interface;
            let why = || format!("it is of interface {number}, which is not described");
            self.skipped.add(|| format!("byte {}", packet.at), why);
            return;
        };
        let found = packet::frames(&self.data, interface.link, packet, self.blocks.big_endian());
        let found = match found {
            Ok(Some(found)) => found,
            Ok(None) => {
                *self.foreign.entry(interface.link).or_default() += 1;
                return;
            }
            Err(why) => {
                self.skipped.add(|| format!("byte {}", packet.at), || why);
                return;
            }
        };
        let index = match (&interface.name, found.interface) {
            // Captured on all interfaces at once: their numbers are all that is known of them.
            (_, Some(number)) => self.names.index(&format!("if{number}")),
            (Some(name), None) => self.names.index(name),
            (None, None) => self.names.index(&unnamed(packet.interface, interface)),
        };
        match index {
            Ok(bus) => {
                let time = Timestamp(packet.nanos);
                let value = found.frame;
                self.timeless += u64::from(packet.timeless);
                into.push(LogFrame { bus, frame: Stamped { time, value } });
            }
            Err(why) => self.skipped.add(|| format!("byte {}", packet.at), || why),
        }
    }

    fn finish(&mut self) -> bool {
        for (link, count) in std::mem::take(&mut self.foreign) {
            self.notes.push(format!(
                "{count} packet(s) of link type {link} are neither CAN frames nor serial bytes and \
                 are not taken"
            ));
        }
        if self.timeless > 0 {
            self.notes.push(format!(
                "{} packet(s) have no time (Simple Packet Blocks) and stand in 1970",
                self.timeless
            ));
        }
        false
    }
}

fn unnamed(number: u32, interface: &Interface) -> String {
    let kind = if interface.link == packet::RTAC_SERIAL { "serial" } else { "can" };
    format!("{kind}{number}")
}

#[cfg(test)]
mod tests;
